"""Paths of continuous curvature for the rear axle, and a bicycle driven along them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from istc_replay.datatypes import FloatArray, read_only

#: Five Gauss nodes integrate a piece of this length exactly, up to rounding, where curvature is linear.
_STEP_M = 0.5
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True, slots=True)
class Pose:
    """A point and a heading [m, rad]."""

    x_m: float
    y_m: float
    heading_rad: float


@dataclass(frozen=True, eq=False)
class Curve:
    """A plane curve given by its start and a curvature that is linear between break points.

    `breaks_m` (B,) are arc lengths, the first 0, ascending; `curvatures_1pm` (B,) hold there.
    A curve whose curvature is zero at an end goes straight on there.
    """

    start: Pose
    breaks_m: FloatArray
    curvatures_1pm: FloatArray

    @property
    def length_m(self) -> float:
        """Length from the first break to the last."""
        return float(self.breaks_m[-1])

    def curvature(self, s_m: ArrayLike) -> FloatArray:
        """Curvature at arc lengths of any shape [1/m]."""
        return np.asarray(np.interp(np.asarray(s_m), self.breaks_m, self.curvatures_1pm))

    def sharpness(self, s_m: ArrayLike) -> FloatArray:
        """Change of curvature per length at arc lengths of any shape [1/m^2]; at a break, the one ahead."""
        slopes = np.diff(self.curvatures_1pm) / np.diff(self.breaks_m)
        piece = np.searchsorted(self.breaks_m, s_m, side="right") - 1
        on_curve = (piece >= 0) & (piece < len(slopes))
        return np.where(on_curve, slopes[np.clip(piece, 0, len(slopes) - 1)], 0.0)

    def heading(self, s_m: ArrayLike) -> FloatArray:
        """Unwrapped heading at arc lengths of any shape [rad]."""
        s = np.asarray(s_m, dtype=np.float64)
        breaks, kappa = self.breaks_m, self.curvatures_1pm
        turned = np.concatenate([[0.0], np.cumsum(np.diff(breaks) * (kappa[1:] + kappa[:-1]) / 2)])
        left = np.clip(np.searchsorted(breaks, s, side="right") - 1, 0, len(breaks) - 1)
        # The mean of the curvatures at both ends of the remaining piece is exact: it is linear there.
        rest = s - breaks[left]
        last_turn = rest * (kappa[left] + self.curvature(s)) / 2
        return np.asarray(self.start.heading_rad + turned[left] + last_turn)

    def points(self, s_m: ArrayLike) -> FloatArray:
        """Points at arc lengths (S,), as (S, 2) [m]."""
        s = np.asarray(s_m, dtype=np.float64)
        knots_s, knots = self._knots
        index = np.clip(np.searchsorted(knots_s, s, side="right") - 1, 0, len(knots_s) - 1)
        return np.asarray(knots[index] + self._moved(knots_s[index], s - knots_s[index]))

    def poses(self, s_m: ArrayLike) -> FloatArray:
        """Poses at arc lengths (S,), as (S, 3): x, y, unwrapped heading [m, rad]."""
        return np.column_stack([self.points(s_m), self.heading(s_m)])

    @cached_property
    def _knots(self) -> tuple[FloatArray, FloatArray]:
        """Arc lengths (N,) at the breaks and between them, and the points (N, 2) there."""
        between = np.arange(_STEP_M, self.length_m, _STEP_M)
        s = np.union1d(self.breaks_m, between)
        moved = np.cumsum(self._moved(s[:-1], np.diff(s)), axis=0)
        return s, np.vstack([np.zeros(2), moved]) + (self.start.x_m, self.start.y_m)

    def _moved(self, from_m: ArrayLike, by_m: ArrayLike) -> FloatArray:
        """Displacement (S, 2) over a piece of the curve, by Gauss-Legendre quadrature."""
        by = np.asarray(by_m, dtype=np.float64)
        nodes = np.asarray(from_m)[:, None] + by[:, None] * (_GAUSS_NODES + 1) / 2
        heading = self.heading(nodes)
        weights = _GAUSS_WEIGHTS / 2
        return np.column_stack([by * (np.cos(heading) @ weights), by * (np.sin(heading) @ weights)])


def smooth_curve(start: Pose, lengths_m: ArrayLike, curvatures_1pm: ArrayLike, ramp_m: float) -> Curve:
    """Make a curve of continuous curvature from arcs, each change spread over a ramp.

    The curvature is the arcs' own, averaged over `ramp_m`: each jump becomes a clothoid of that
    length. It starts and ends at zero, turns exactly as far as the arcs, and is `ramp_m` longer.

    Parameters
    ----------
    start : Pose
        Where the curve starts.
    lengths_m, curvatures_1pm : array_like
        (A,) lengths [m] and curvatures [1/m] of the arcs.
    ramp_m : float
        Length over which a change of curvature is spread [m].
    """
    lengths = np.asarray(lengths_m, dtype=np.float64)
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    turned = np.concatenate([[0.0], np.cumsum(lengths * np.asarray(curvatures_1pm, dtype=np.float64))])
    breaks = np.unique(np.concatenate([ends, ends + ramp_m]))
    kappa = (np.interp(breaks, ends, turned) - np.interp(breaks - ramp_m, ends, turned)) / ramp_m
    return Curve(start, read_only(breaks), read_only(kappa))


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
