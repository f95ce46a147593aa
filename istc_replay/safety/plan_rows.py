"""A window's cubes, obstacles and trajectories from the rows of a result's tables.

Times are taken from the window's start, and places to its corridor frame. Rows that are not sound
raise UnsoundError.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import polars as pl
from numpy.typing import ArrayLike

from istc_replay.datatypes import FloatArray, Frame
from istc_replay.geometry import to_frame
from istc_replay.safety.plan import Boxes, IntArray, VehiclePlan
from istc_replay.units import NS_PER_S

#: Rounding allowed in times: knots this near to a boundary are on it.
_TIME_TOLERANCE_NS = 1_000
#: No window is longer than this (11 days); it keeps differences of times exact.
_LONGEST_NS = 1_000_000_000_000_000
_WALLS = ["x_min_m", "x_max_m", "y_min_m", "y_max_m"]
_FRAME = ["frame_x_m", "frame_y_m", "frame_yaw_rad"]
_STATES = ["x_m", "y_m", "heading_rad", "steering_rad", "speed_mps", "acceleration_mps2"]
_CONTROLS = ["steering_rate_radps", "jerk_mps3"]
_DIMENSIONS = ["length_m", "width_m", "wheelbase_m", "rear_axle_to_centre_m"]


class UnsoundError(Exception):
    """A fault of one vehicle's rows, and its time [ns from the window's start]."""

    def __init__(self, detail: str, time_ns: int | None = None) -> None:
        super().__init__(detail)
        self.time_s = None if time_ns is None else time_ns / NS_PER_S


def read_cubes(rows: pl.DataFrame, start_ns: int) -> Boxes:
    """Read a corridor: cubes of consecutive units that follow each other without a gap."""
    if rows.is_empty():
        raise UnsoundError("no corridor")
    boxes = _boxes(rows, start_ns)
    sides = boxes.walls_m[:, 1::2] - boxes.walls_m[:, 0::2]
    sound = np.isfinite(boxes.walls_m).all(axis=1) & (sides > 0.0).all(axis=1)
    _refuse(~sound, boxes.spans_ns[:, 0], "cube is not finite or has no area")
    _refuse_overlap(boxes)
    follows = (np.diff(boxes.units) == 1) & (boxes.spans_ns[1:, 0] == boxes.spans_ns[:-1, 1])
    _refuse(~follows, boxes.spans_ns[:-1, 1], "the next cube does not follow this time unit")
    return boxes


def check_units(cubes: Boxes, listed: dict[str, Any]) -> None:
    """The units must be those that the summary promises, where it does."""
    first, count = listed.get("first_unit"), listed.get("units")
    if isinstance(first, int) and int(cubes.units[0]) != first:
        raise UnsoundError(f"corridor starts in unit {cubes.units[0]}, the summary says {first}")
    if isinstance(count, int) and cubes.units.size != count:
        raise UnsoundError(f"corridor has {cubes.units.size} units, the summary says {count}")


def read_obstacle(rows: pl.DataFrame, start_ns: int) -> Boxes:
    """Read an obstacle's boxes; units in which it is absent are left out."""
    boxes = _boxes(rows, start_ns)
    present = ~np.isnan(boxes.walls_m).all(axis=1)
    boxes = Boxes(boxes.units[present], boxes.spans_ns[present], boxes.walls_m[present])
    sides = boxes.walls_m[:, 1::2] - boxes.walls_m[:, 0::2]
    sound = np.isfinite(boxes.walls_m).all(axis=1) & (sides >= 0.0).all(axis=1)
    _refuse(~sound, boxes.spans_ns[:, 0], "box is not finite or inverted")
    _refuse_overlap(boxes)
    return boxes


def _boxes(rows: pl.DataFrame, start_ns: int) -> Boxes:
    times = np.column_stack([_times(rows, name, start_ns) for name in ("start_ns", "end_ns")])
    if rows["k"].null_count():
        raise UnsoundError("a time unit has no number")
    order = np.argsort(times[:, 0], kind="stable")
    return Boxes(rows["k"].to_numpy().astype(np.int64)[order], times[order], _values(rows, _WALLS)[order])


def _refuse_overlap(boxes: Boxes) -> None:
    starts, ends = boxes.spans_ns.T
    _refuse(starts >= ends, starts, "a time unit has no duration")
    _refuse(starts[1:] < ends[:-1], starts[1:], "two time units overlap")


def read_vehicle_plan(rows: pl.DataFrame, cubes: Boxes, start_ns: int, frame: Frame) -> VehiclePlan:
    """Read a trajectory: uniform knots from the corridor's first instant to its last."""
    if rows.is_empty():
        raise UnsoundError("no planned trajectory", int(cubes.spans_ns[0, 0]))
    rows = rows.sort("time_ns")
    knots, states = _times(rows, "time_ns", start_ns), _values(rows, _STATES)
    controls, dimensions = _values(rows, _CONTROLS), _values(rows, _DIMENSIONS)
    boundaries = np.append(cubes.spans_ns[:, 0], cubes.spans_ns[-1, 1])
    _check_knots(knots, int(boundaries[0]), int(boundaries[-1]))
    _refuse(~np.isfinite(states).all(axis=1), knots, "planned state is not finite")
    _refuse(~np.isfinite(controls[:-1]).all(axis=1), knots, "planned controls are not finite")
    _refuse(~np.isfinite(dimensions).all(axis=1), knots, "dimensions are not finite")
    _refuse((dimensions != dimensions[0]).any(axis=1), knots, "dimensions change")
    if not (dimensions[0, :3] > 0.0).all():
        raise UnsoundError("length, width and wheelbase must be above 0")
    # Knots a rounding away from a unit boundary are on it: the pieces of the motion meet there.
    nearest = boundaries[np.searchsorted(boundaries[1:] - np.diff(boundaries) // 2, knots)]
    knots = np.where(np.abs(knots - nearest) <= _TIME_TOLERANCE_NS, nearest, knots)
    states[:, :2] = to_frame(states[:, :2], frame)
    states[:, 2] -= frame.yaw_rad
    return VehiclePlan(knots, states, controls[:-1], dimensions[0])


def _check_knots(knots: IntArray, first: int, last: int) -> None:
    if knots.size < 2:
        raise UnsoundError("a single planned state", first)
    steps = np.diff(knots)
    step = int(np.median(steps))
    if abs(int(knots[0]) - first) > _TIME_TOLERANCE_NS:
        raise UnsoundError("planned states do not start with the corridor", first)
    uneven = np.abs(steps - step) > _TIME_TOLERANCE_NS
    _refuse(
        uneven | (steps <= 0), knots[:-1] + step, "planned states unevenly spaced: one is missing or moved"
    )
    if abs(int(knots[-1]) - last) > _TIME_TOLERANCE_NS:
        raise UnsoundError("planned states do not end with the corridor", int(knots[-1]) + step)


def _refuse(wrong: ArrayLike, times_ns: IntArray, detail: str) -> None:
    """Raise at the first wrong row."""
    if np.any(wrong):
        raise UnsoundError(detail, int(times_ns[int(np.argmax(wrong))]))


def read_frame(rows: pl.DataFrame) -> tuple[Frame, str]:
    """The one frame of the rows, or what is wrong with it."""
    if rows.is_empty():
        return Frame(), "no corridor"
    frames = np.unique(_values(rows, _FRAME), axis=0)
    if frames.shape[0] == 1 and np.isfinite(frames).all():
        return Frame(*(float(value) for value in frames[0])), ""
    return Frame(), "the corridors have no single finite frame"


def _times(rows: pl.DataFrame, name: str, start_ns: int) -> IntArray:
    """A column of times, from the window's start."""
    if rows[name].null_count():
        raise UnsoundError(f"{name} is missing")
    times = rows[name].to_numpy().astype(np.int64)
    if (np.abs(times.astype(np.float64) - float(start_ns)) > _LONGEST_NS).any():
        raise UnsoundError(f"{name} is more than 11 days from the window's start")
    return times - start_ns


def _values(rows: pl.DataFrame, names: list[str]) -> FloatArray:
    """(n, len(names)) float64; null becomes NaN."""
    return np.column_stack([_floats(rows[name]) for name in names])


def _floats(column: pl.Series) -> FloatArray:
    """Values (n,) of a column; null becomes NaN."""
    # Polars' own way to NaN costs a query a column, and there are many small ones.
    wide = column if column.dtype == pl.Float64 else column.cast(pl.Float64)
    return np.asarray(wide.to_numpy(), dtype=np.float64)
