"""The pace of a vehicle along its path: how far it has come, at each time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from istc_replay.datatypes import FloatArray


@dataclass(frozen=True, slots=True)
class Pace:
    """Speed over time: constant, and where `stop_m` is given braked to stand exactly there."""

    speed_mps: float
    stop_m: float | None = None
    deceleration_mps2: float = 2.0

    @property
    def arrival_s(self) -> float:
        """When the vehicle comes to stand; infinite where it drives on."""
        if self.stop_m is None:
            return math.inf
        return self._braking_from_s + self.speed_mps / self.deceleration_mps2

    @property
    def _braking_from_s(self) -> float:
        if self.stop_m is None:
            return math.inf
        return self.stop_m / self.speed_mps - self.speed_mps / (2.0 * self.deceleration_mps2)

    def at(self, times_s: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distance [m], speed [m/s] and acceleration [m/s^2] at times (S,), each (S,)."""
        t = np.asarray(times_s, dtype=np.float64)
        braking = np.clip(t - self._braking_from_s, 0.0, self.speed_mps / self.deceleration_mps2)
        cruising = np.minimum(t, self._braking_from_s)
        speed = self.speed_mps - self.deceleration_mps2 * braking
        distance = self.speed_mps * (cruising + braking) - self.deceleration_mps2 * braking**2 / 2
        slowing = (t >= self._braking_from_s) & (t < self.arrival_s)
        return distance, speed, np.where(slowing, -self.deceleration_mps2, 0.0)
