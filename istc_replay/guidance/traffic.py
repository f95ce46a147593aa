"""Where other vehicles will be, as a soft cost: who routes later prefers what is not in use then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from istc_replay.datatypes import FloatArray

_STEP_S = 0.25
_REACH_M = 4.5
#: Coordination will delay vehicles: they are counted this much earlier and later too.
_SHIFTS_S = (-1.5, -0.75, 0.0, 0.75, 1.5)
_WEIGHT = 1.0


@dataclass(frozen=True, eq=False)
class Traffic:
    """Points (V, T, 2) of V vehicles every 0.25 s from the start, and the speed of who meets them."""

    points_m: FloatArray
    speed_mps: float

    @classmethod
    def of(cls, paths_m: Sequence[FloatArray], speed_mps: float) -> Traffic | None:
        """Drive paths (P, 2) of evenly spaced points, one every 0.25 s; each stands at its end."""
        if not paths_m:
            return None
        longest = max(len(path) for path in paths_m)
        return cls(
            np.stack([np.pad(path, ((0, longest - len(path)), (0, 0)), mode="edge") for path in paths_m]),
            speed_mps,
        )

    @classmethod
    def spacing_m(cls, speed_mps: float) -> float:
        """Distance of the points of a path that `of` takes [m]."""
        return speed_mps * _STEP_S

    def cost_m(self, points_m: FloatArray, step_m: float) -> float:
        """What meeting others costs a path of points (P, 2), one a step [m]."""
        times = np.arange(len(points_m)) * (step_m / self.speed_mps)
        cost = 0
        for shift in _SHIFTS_S:
            index = np.clip(np.rint((times + shift) / _STEP_S), 0, self.points_m.shape[1] - 1)
            others = self.points_m[:, index.astype(np.int64)]  # (V, P, 2)
            cost += int((((others - points_m) ** 2).sum(axis=-1) < _REACH_M**2).sum())
        return cost * step_m * _WEIGHT / len(_SHIFTS_S)
