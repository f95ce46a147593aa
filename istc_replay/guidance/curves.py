"""Paths of the rear axle: sharp ones made of arcs, smooth ones of linear curvature."""

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

    def as_array(self) -> FloatArray:
        """The pose as (3,): x, y, heading."""
        return np.array([self.x_m, self.y_m, self.heading_rad])


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
        left = np.clip(np.searchsorted(breaks, s, side="right") - 1, 0, len(breaks) - 1)
        # The mean of the curvatures at both ends of the remaining piece is exact: it is linear there.
        rest = s - breaks[left]
        last_turn = rest * (kappa[left] + self.curvature(s)) / 2
        return np.asarray(self.start.heading_rad + self._turned[left] + last_turn)

    def points(self, s_m: ArrayLike) -> FloatArray:
        """Points at arc lengths (S,), as (S, 2) [m]."""
        s = np.asarray(s_m, dtype=np.float64)
        knots_s, knots = self._knots
        index = np.clip(np.searchsorted(knots_s, s, side="right") - 1, 0, len(knots_s) - 1)
        return np.asarray(knots[index] + self._moved(knots_s[index], s - knots_s[index]))

    def poses(self, s_m: ArrayLike) -> FloatArray:
        """Poses at arc lengths (S,), as (S, 3): x, y, unwrapped heading [m, rad]."""
        return np.column_stack([self.points(s_m), self.heading(s_m)])

    def spaced_poses(self, step_m: float) -> FloatArray:
        """Poses (S, 3) from end to end, at most a step apart [m, rad]."""
        return self.poses(np.linspace(0.0, self.length_m, math.ceil(self.length_m / step_m) + 1))

    @cached_property
    def end(self) -> FloatArray:
        """The pose (3,) at the last break, its heading unwrapped [m, rad]."""
        return np.array([*self._knots[1][-1], self.heading(self.length_m)])

    @cached_property
    def _turned(self) -> FloatArray:
        """Change of heading (B,) from the start to each break."""
        kappa = self.curvatures_1pm
        return np.concatenate([[0.0], np.cumsum(np.diff(self.breaks_m) * (kappa[1:] + kappa[:-1]) / 2)])

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


def arc_poses(
    starts: FloatArray, lengths_m: FloatArray, curvatures_1pm: FloatArray, s_m: FloatArray
) -> FloatArray:
    """Poses along many sharp paths at once.

    Parameters
    ----------
    starts : ndarray
        (N, 3) poses [m, rad].
    lengths_m, curvatures_1pm : ndarray
        (N, A) arcs of each path [m, 1/m].
    s_m : ndarray
        (N, S) arc lengths within the paths [m].

    Returns
    -------
    ndarray
        (N, S, 3) x, y, unwrapped heading [m, rad].
    """
    ends = np.cumsum(lengths_m, axis=1)
    turned = np.cumsum(lengths_m * curvatures_1pm, axis=1)
    begun = ends - lengths_m
    headings = starts[:, 2:3] + turned - lengths_m * curvatures_1pm  # (N, A) at the start of each arc
    driven = np.clip(s_m[:, :, None] - begun[:, None, :], 0.0, lengths_m[:, None, :])  # (N, S, A)
    half_turn = driven * curvatures_1pm[:, None, :] / 2.0
    # The chord of an arc: its length times sinc of half the turn, along the heading at half the turn.
    small = np.abs(half_turn) < 1e-9
    chord = driven * np.where(small, 1.0, np.sin(half_turn) / np.where(small, 1.0, half_turn))
    along = headings[:, None, :] + half_turn
    return np.stack(
        [
            starts[:, 0:1] + (chord * np.cos(along)).sum(axis=2),
            starts[:, 1:2] + (chord * np.sin(along)).sum(axis=2),
            starts[:, 2:3] + 2.0 * half_turn.sum(axis=2),
        ],
        axis=-1,
    )


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
