"""The walls of a corridor around a car-box, eq. (19): at instants, and in continuous time.

Walls are the columns x_min, x_max, y_min, y_max. Each cube holds on its closed unit, so that at
a unit boundary the car-box lies in both cubes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from istc_replay.bicycle import dense_motion
from istc_replay.config import TrajectoriesConfig
from istc_replay.datatypes import Dimensions, FloatArray
from istc_replay.errors import SolveError
from istc_replay.geometry import box_corners, shift_along

#: +1 for a wall that bounds from above, -1 for one that bounds from below.
SIDES = np.array([-1.0, 1.0, -1.0, 1.0])
#: Spacing of the samples that the continuous-time check bounds the motion between: everywhere, and
#: in intervals that this cannot decide.
_DENSE_S, _FINEST_S = 0.02, 2e-4
#: Room that no margin is taken from, as it is all that IPOPT has to move in; but for the
#: micrometres by which the integrator may miss the true motion.
_SLIVER_M, _DRIFT_M = 2e-3, 5e-6
#: Every wall is this much further out, well below the rounding that certificates allow.
_GIVE_M = 2e-7
#: Time units from this on have two control intervals or more [s].
_TWO_S = 0.25
#: An NLP of more control intervals would take minutes and gigabytes.
_MOST_INTERVALS = 1000


@dataclass(frozen=True, slots=True)
class Grid:
    """The instants of one NLP: `units` of `per_unit` control intervals, walls at the end of each."""

    units: int
    per_unit: int
    step_s: float

    @classmethod
    def cut(cls, units: int, unit_s: float, config: TrajectoriesConfig) -> Grid:
        """Cut units into control intervals as near to `config.step_s` as divides them.

        A unit of `_TWO_S` or more has two at least, so that walls are held in its middle too.

        Raises
        ------
        SolveError
            If that makes more than `_MOST_INTERVALS`.
        """
        least = 2 if unit_s >= _TWO_S else 1
        per_unit = max(least, math.ceil(unit_s / config.step_s - 0.5 - 1e-9))
        if units * per_unit > _MOST_INTERVALS:
            raise SolveError(
                f"{units} units of {unit_s:g} s at trajectories.step_s = {config.step_s:g} make "
                f"{units * per_unit} control intervals, at most {_MOST_INTERVALS}: raise step_s"
            )
        return cls(units, per_unit, unit_s / per_unit)

    @property
    def intervals(self) -> int:
        """Control intervals."""
        return self.units * self.per_unit

    @property
    def unit_s(self) -> float:
        """Length of a time unit [s]."""
        return float(self.per_unit * self.step_s)

    @property
    def knots_s(self) -> FloatArray:
        """(S,) ends of the control intervals [s], the first 0."""
        return np.asarray(np.arange(self.intervals + 1) * self.step_s, dtype=np.float64)

    @property
    def wall_units(self) -> FloatArray:
        """(S-1,) instants at which walls are held, in time units, without the fixed start."""
        return np.asarray(np.arange(1, self.intervals + 1) / self.per_unit)


def box_extents(centres_m: FloatArray, headings_rad: FloatArray, dimensions: Dimensions) -> FloatArray:
    """Axis-aligned extents (..., 4) of car-boxes at centres (..., 2)."""
    corners = box_corners(
        centres_m[..., 0], centres_m[..., 1], headings_rad, dimensions.length_m, dimensions.width_m
    )
    return _extents(corners)


def base_margins(
    cubes_m: FloatArray,
    pivots_m: FloatArray,
    headings_rad: FloatArray,
    dimensions: Dimensions,
    margin_m: float,
) -> FloatArray:
    """Margins (K, 4) that leave the car-boxes at the pivotal points inside.

    Half of what these boxes have left to each wall beyond `_SLIVER_M`, at most `margin_m`: a least
    cube around a standing car, or a start box that touches a wall, must not make the NLP
    infeasible. Walls that touch give way by less than rounding, so that it keeps an interior.
    """
    boxes = box_extents(pivots_m, headings_rad, dimensions)
    room = SIDES * (cubes_m[:, None, :] - np.stack([boxes[:-1], boxes[1:]], axis=1))  # (K, 2, 4)
    room = np.maximum(room.min(axis=1), 0.0)
    drift = np.minimum(room / 4, _DRIFT_M)
    return np.asarray(np.clip((room - _SLIVER_M) / 2, drift, margin_m) - _GIVE_M)


def walls_at(grid: Grid, cubes_m: FloatArray, margins_m: FloatArray, extra_m: FloatArray) -> FloatArray:
    """Walls (S-1, 4) at the grid's wall instants: the tighter of both cubes at a unit boundary.

    `margins_m` (K, 4) and `extra_m` (S-1, 4) are taken off the cubes.
    """
    inset = SIDES * (cubes_m - SIDES * margins_m)  # (K, 4), smaller is tighter
    later = np.minimum(np.floor(grid.wall_units + 1e-9).astype(int), grid.units - 1)
    earlier = np.ceil(grid.wall_units - 1e-9).astype(int) - 1
    return np.asarray(SIDES * (np.minimum(inset[earlier], inset[later]) - extra_m))


def excess(
    grid: Grid, start: FloatArray, controls: FloatArray, dimensions: Dimensions, cubes_m: FloatArray
) -> FloatArray:
    """How far the car-box can stick out of its cubes, in continuous time.

    Between two samples a corner leaves its chord by at most M s (h - s) / 2, with
    M = |a| + |v w| + r (|w'| + w^2) bounding its acceleration.

    Parameters
    ----------
    grid : Grid
    start : ndarray
        (6,) first state of the rear axle.
    controls : ndarray
        (S-1, 2) held controls.
    dimensions : Dimensions
    cubes_m : ndarray
        (K, 4).

    Returns
    -------
    ndarray
        (S-1, 4) an upper bound for each control interval and wall [m], negative inside.
    """
    cubes = np.repeat(cubes_m, grid.per_unit, axis=0)
    states, rates, h = dense_motion(start, controls, grid.step_s, dimensions.wheelbase_m, _DENSE_S)
    out = _furthest(states, rates, h, dimensions) - SIDES * cubes
    for i in np.flatnonzero(out.max(axis=1) > 0.0):
        # Near a wall that is touched, only finer samples tell rounding from leaving.
        piece = dense_motion(
            states[i, 0], controls[i : i + 1], grid.step_s, dimensions.wheelbase_m, _FINEST_S
        )
        out[i] = (_furthest(*piece, dimensions) - SIDES * cubes[i])[0]
    return np.asarray(out)


def _furthest(states: FloatArray, rates: FloatArray, h: float, dimensions: Dimensions) -> FloatArray:
    """How far outward the corners get in each control interval, (n, 4)."""
    centres = shift_along(states[..., 0], states[..., 1], states[..., 2], dimensions.rear_axle_to_centre_m)
    corners = box_corners(
        centres[..., 0], centres[..., 1], states[..., 2], dimensions.length_m, dimensions.width_m
    )  # (n, m+1, 4, 2)
    reach = math.hypot(
        abs(dimensions.rear_axle_to_centre_m) + dimensions.length_m / 2, dimensions.width_m / 2
    )
    v, a, w, slope = states[..., 4], states[..., 5], rates[..., 0], rates[..., 1]
    bend = np.abs(a) + np.abs(v * w) + reach * (np.abs(slope) + w**2)
    bend = np.maximum(bend[:, :-1], bend[:, 1:])[..., None, None]  # (n, m, 1, 1)
    out = np.repeat(corners, 2, axis=-1) * SIDES  # (n, m+1, 4, 4), outward is positive
    return np.asarray(_arc_top(out[:, :-1], out[:, 1:], bend, h).max(axis=(1, 2)))


def raised(extra_m: FloatArray, excess_m: FloatArray) -> FloatArray:
    """Extra margins (S-1, 4) at both ends of the intervals whose excess asks for them."""
    need = np.where(excess_m > 0.0, 1.5 * excess_m + 1e-6, 0.0)
    following = np.vstack([need[1:], np.zeros((1, 4))])
    return np.asarray(extra_m + np.maximum(need, following))


def _extents(corners_m: FloatArray) -> FloatArray:
    low, high = corners_m.min(axis=-2), corners_m.max(axis=-2)
    return np.stack([low[..., 0], high[..., 0], low[..., 1], high[..., 1]], axis=-1)


def _arc_top(c0: FloatArray, c1: FloatArray, bend: FloatArray, h: float) -> FloatArray:
    """Highest value of a chord from c0 to c1 plus bend s (h - s) / 2 over s in [0, h]."""
    rise = np.abs(c1 - c0)
    sag = bend * (h * h / 2)
    safe = np.where(rise < sag, sag, 1.0)
    arc = (c0 + c1) / 2 + sag / 4 + rise**2 / (4 * safe)
    return np.where(rise < sag, arc, np.maximum(c0, c1))
