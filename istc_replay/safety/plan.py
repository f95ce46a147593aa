"""A window's plan as it stands written in a result, and what is missing from it.

Times are int64 nanoseconds from the window's start, positions in the window's corridor frame.
Nothing here trusts the writer: a corridor or a trajectory with a fault is left out and named, and
the checks then cannot pass.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import ArrayLike, NDArray

from istc_replay.datatypes import FloatArray, Frame, Result
from istc_replay.geometry import to_frame
from istc_replay.units import NS_PER_S

IntArray = NDArray[np.int64]

#: Rounding allowed in times: knots this near to a boundary are on it.
_TIME_TOLERANCE_NS = 1_000
#: No window is longer than this (11 days); it keeps differences of times exact.
_LONGEST_NS = 1_000_000_000_000_000

_WALLS = ["x_min_m", "x_max_m", "y_min_m", "y_max_m"]
_FRAME = ["frame_x_m", "frame_y_m", "frame_yaw_rad"]
_STATES = ["x_m", "y_m", "heading_rad", "steering_rad", "speed_mps", "acceleration_mps2"]
_CONTROLS = ["steering_rate_radps", "jerk_mps3"]
_DIMENSIONS = ["length_m", "width_m", "wheelbase_m", "rear_axle_to_centre_m"]
#: Why vehicles that are not planned are obstacles.
_AS_RECORDED = ("not_a_vehicle", "uncooperative", "parked")
#: Window statuses that say that no plan was made.
_WITHOUT_PLAN = ("conflict_left", "no_corridors", "not_drivable", "nothing_to_plan")


@dataclass(frozen=True, slots=True)
class Fault:
    """Something missing or malformed: whose, when [s from the window's start], and what."""

    vehicle_id: str
    time_s: float | None
    detail: str


@dataclass(frozen=True, slots=True, eq=False)
class Boxes:
    """Axis-aligned boxes that hold on closed spans of time.

    `spans_ns` (K, 2) starts and ends, `walls_m` (K, 4) x_min, x_max, y_min, y_max, `units` (K,) k.
    """

    units: IntArray
    spans_ns: IntArray
    walls_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class VehiclePlan:
    """A written trajectory: `knots_ns` (S,), `states` (S, 6): x, y of the box centre, heading,
    steering, speed, acceleration, `controls` (S-1, 2): steering rate and jerk, each held to the
    next knot, `dimensions` (4,): length, width, wheelbase, rear axle to centre [m].
    """

    knots_ns: IntArray
    states: FloatArray
    controls: FloatArray
    dimensions: FloatArray


@dataclass(slots=True, eq=False)
class WrittenPlan:
    """What one window's plan says: sound cubes and trajectories by vehicle, obstacles, faults.

    `as_recorded` names the road users that should be among the obstacles. `traffic` says by which rules
    it was planned.

    The gaps are those that it promises [m], None where it is silent. `handed_over` vehicles promise
    to start where the plan of the window before, `before`, has led them.
    """

    index: int
    start_ns: int
    end_ns: int
    frame: Frame
    vehicles: tuple[str, ...]
    as_recorded: tuple[str, ...] = ()
    traffic: bool = False
    vehicle_gap_m: float | None = None
    obstacle_gap_m: float | None = None
    handed_over: frozenset[str] = frozenset()
    before: WrittenPlan | None = None
    cubes: dict[str, Boxes] = field(default_factory=dict)
    plans: dict[str, VehiclePlan] = field(default_factory=dict)
    obstacles: dict[str, Boxes] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)
    obstacle_faults: list[Fault] = field(default_factory=list)


class _UnsoundError(Exception):
    """A fault of one vehicle's rows, and its time [ns from the window's start]."""

    def __init__(self, detail: str, time_ns: int | None = None) -> None:
        super().__init__(detail)
        self.time_s = None if time_ns is None else time_ns / NS_PER_S


def written_plans(parts: Iterable[Result]) -> Iterator[WrittenPlan]:
    """Read the plans of all windows that have one, by index; parts have other windows each, in order."""
    before: WrittenPlan | None = None
    for part in parts:
        for plan in _plans_of(part):
            plan.before = before if before is not None and before.index == plan.index - 1 else None
            before = replace(plan, before=None)
            yield plan


def _plans_of(result: Result) -> Iterator[WrittenPlan]:
    entries = _window_entries(result.summary)
    planned = _by_window(result.states.filter(pl.col("source") == "planned"))
    corridors, obstacles = _by_window(result.corridors), _by_window(result.obstacles)
    for index in sorted({*entries, *planned, *corridors}):
        entry = entries.get(index, {})
        without = entry.get("status") in _WITHOUT_PLAN or index not in corridors
        if index in planned or not without:
            cubes, states = corridors.get(index), planned.get(index)
            yield _written_plan(
                index,
                entry,
                result.corridors.clear() if cubes is None else cubes,
                result.states.clear() if states is None else states,
                obstacles.get(index, result.obstacles.clear()),
            )


def _as_recorded(entry: dict[str, Any]) -> tuple[str, ...]:
    """Road users that the plan has to keep clear of as they were recorded."""
    left_out = [*_dicts(entry.get("exclusions")), *_dicts(entry.get("frozen"))]
    kept = [e for e in left_out if e.get("reason") in _AS_RECORDED or e in _dicts(entry.get("frozen"))]
    return tuple(sorted({str(e.get("vehicle_id")) for e in kept}))


def _gap(value: object) -> float | None:
    """A promised gap [m]; one that is negative or no number promises nothing."""
    if isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value < np.inf:
        return float(value)
    return None


def _written_plan(
    index: int, entry: dict[str, Any], corridors: pl.DataFrame, states: pl.DataFrame, obstacles: pl.DataFrame
) -> WrittenPlan:
    first_ns, last_ns = _span(corridors, states)
    start_ns = _integer(entry.get("start_ns"), first_ns)
    listed = {str(vehicle.get("id")): vehicle for vehicle in _dicts(entry.get("vehicles"))}
    frame, frame_fault = _frame(corridors)
    cube_rows, state_rows = _by_vehicle(corridors, "vehicle_id"), _by_vehicle(states, "vehicle_id")
    plan = WrittenPlan(
        index=index,
        start_ns=start_ns,
        end_ns=_integer(entry.get("end_ns"), last_ns),
        frame=frame,
        vehicles=tuple(sorted({*cube_rows, *state_rows, *listed})),
        as_recorded=_as_recorded(entry),
        traffic=entry.get("rules") == "traffic",
        vehicle_gap_m=_gap(entry.get("vehicle_gap_m")),
        obstacle_gap_m=_gap(entry.get("obstacle_gap_m")),
        handed_over=frozenset(name for name, told in listed.items() if told.get("start") == "handed_over"),
    )
    for vehicle_id in plan.vehicles:
        try:
            if frame_fault:
                raise _UnsoundError(frame_fault)
            cubes = _cubes(cube_rows.get(vehicle_id, corridors.clear()), start_ns)
            _check_units(cubes, listed.get(vehicle_id, {}))
            plan.cubes[vehicle_id] = cubes
            rows = state_rows.get(vehicle_id, states.clear())
            plan.plans[vehicle_id] = _vehicle_plan(rows, cubes, start_ns, frame)
        except _UnsoundError as fault:
            plan.faults.append(Fault(vehicle_id, fault.time_s, str(fault)))
    for obstacle_id, rows in _by_vehicle(obstacles, "obstacle_id").items():
        try:
            if _frame(rows) != (frame, ""):
                raise _UnsoundError("its frame is not the corridors' frame")
            plan.obstacles[obstacle_id] = _obstacle(rows, start_ns)
        except _UnsoundError as fault:
            plan.obstacle_faults.append(Fault(obstacle_id, fault.time_s, str(fault)))
    return plan


def _cubes(rows: pl.DataFrame, start_ns: int) -> Boxes:
    """Read a corridor: cubes of consecutive units that follow each other without a gap."""
    if rows.is_empty():
        raise _UnsoundError("no corridor")
    boxes = _boxes(rows, start_ns)
    sides = boxes.walls_m[:, 1::2] - boxes.walls_m[:, 0::2]
    sound = np.isfinite(boxes.walls_m).all(axis=1) & (sides > 0.0).all(axis=1)
    _refuse(~sound, boxes.spans_ns[:, 0], "cube is not finite or has no area")
    _refuse_overlap(boxes)
    follows = (np.diff(boxes.units) == 1) & (boxes.spans_ns[1:, 0] == boxes.spans_ns[:-1, 1])
    _refuse(~follows, boxes.spans_ns[:-1, 1], "the next cube does not follow this time unit")
    return boxes


def _obstacle(rows: pl.DataFrame, start_ns: int) -> Boxes:
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
        raise _UnsoundError("a time unit has no number")
    order = np.argsort(times[:, 0], kind="stable")
    return Boxes(rows["k"].to_numpy().astype(np.int64)[order], times[order], _values(rows, _WALLS)[order])


def _refuse_overlap(boxes: Boxes) -> None:
    starts, ends = boxes.spans_ns.T
    _refuse(starts >= ends, starts, "a time unit has no duration")
    _refuse(starts[1:] < ends[:-1], starts[1:], "two time units overlap")


def _check_units(cubes: Boxes, listed: dict[str, Any]) -> None:
    """The units must be those that the summary promises, where it does."""
    first, count = listed.get("first_unit"), listed.get("units")
    if isinstance(first, int) and int(cubes.units[0]) != first:
        raise _UnsoundError(f"corridor starts in unit {cubes.units[0]}, the summary says {first}")
    if isinstance(count, int) and cubes.units.size != count:
        raise _UnsoundError(f"corridor has {cubes.units.size} units, the summary says {count}")


def _vehicle_plan(rows: pl.DataFrame, cubes: Boxes, start_ns: int, frame: Frame) -> VehiclePlan:
    """Read a trajectory: uniform knots from the corridor's first instant to its last."""
    if rows.is_empty():
        raise _UnsoundError("no planned trajectory", int(cubes.spans_ns[0, 0]))
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
        raise _UnsoundError("length, width and wheelbase must be above 0")
    # Knots a rounding away from a unit boundary are on it: the pieces of the motion meet there.
    nearest = boundaries[np.searchsorted(boundaries[1:] - np.diff(boundaries) // 2, knots)]
    knots = np.where(np.abs(knots - nearest) <= _TIME_TOLERANCE_NS, nearest, knots)
    states[:, :2] = to_frame(states[:, :2], frame)
    states[:, 2] -= frame.yaw_rad
    return VehiclePlan(knots, states, controls[:-1], dimensions[0])


def _check_knots(knots: IntArray, first: int, last: int) -> None:
    if knots.size < 2:
        raise _UnsoundError("a single planned state", first)
    steps = np.diff(knots)
    step = int(np.median(steps))
    if abs(int(knots[0]) - first) > _TIME_TOLERANCE_NS:
        raise _UnsoundError("planned states do not start with the corridor", first)
    uneven = np.abs(steps - step) > _TIME_TOLERANCE_NS
    _refuse(
        uneven | (steps <= 0), knots[:-1] + step, "planned states unevenly spaced: one is missing or moved"
    )
    if abs(int(knots[-1]) - last) > _TIME_TOLERANCE_NS:
        raise _UnsoundError("planned states do not end with the corridor", int(knots[-1]) + step)


def _refuse(wrong: ArrayLike, times_ns: IntArray, detail: str) -> None:
    """Raise at the first wrong row."""
    if np.any(wrong):
        raise _UnsoundError(detail, int(times_ns[int(np.argmax(wrong))]))


def _times(rows: pl.DataFrame, name: str, start_ns: int) -> IntArray:
    """A column of times, from the window's start."""
    if rows[name].null_count():
        raise _UnsoundError(f"{name} is missing")
    times = rows[name].to_numpy().astype(np.int64)
    if (np.abs(times.astype(np.float64) - float(start_ns)) > _LONGEST_NS).any():
        raise _UnsoundError(f"{name} is more than 11 days from the window's start")
    return times - start_ns


def _values(rows: pl.DataFrame, names: list[str]) -> FloatArray:
    """(n, len(names)) float64; null becomes NaN."""
    return np.column_stack([_floats(rows[name]) for name in names])


def _floats(column: pl.Series) -> FloatArray:
    """Values (n,) of a column; null becomes NaN."""
    # Polars' own way to NaN costs a query a column, and there are many small ones.
    wide = column if column.dtype == pl.Float64 else column.cast(pl.Float64)
    return np.asarray(wide.to_numpy(), dtype=np.float64)


def _span(corridors: pl.DataFrame, states: pl.DataFrame) -> tuple[int, int]:
    """First and last instant of the rows [ns]."""
    times = pl.concat([corridors["start_ns"], corridors["end_ns"], states["time_ns"]]).drop_nulls().to_numpy()
    return (int(times.min()), int(times.max())) if times.size else (0, 0)


def _frame(rows: pl.DataFrame) -> tuple[Frame, str]:
    """The one frame of the rows, or what is wrong with it."""
    if rows.is_empty():
        return Frame(), "no corridor"
    frames = np.unique(_values(rows, _FRAME), axis=0)
    if frames.shape[0] == 1 and np.isfinite(frames).all():
        return Frame(*(float(value) for value in frames[0])), ""
    return Frame(), "the corridors have no single finite frame"


def _by_window(table: pl.DataFrame) -> dict[int, pl.DataFrame]:
    known = table.filter(pl.col("window").is_not_null())
    return {int(index): rows for (index,), rows in known.partition_by("window", as_dict=True).items()}


def _by_vehicle(table: pl.DataFrame, key: str) -> dict[str, pl.DataFrame]:
    named = {str(name): rows for (name,), rows in table.partition_by(key, as_dict=True).items()}
    return dict(sorted(named.items()))


def _window_entries(summary: dict[str, Any]) -> dict[int, dict[str, Any]]:
    entries = _dicts(summary.get("windows"))
    return {entry["index"]: entry for entry in entries if isinstance(entry.get("index"), int)}


def _dicts(value: Any) -> list[dict[str, Any]]:
    return [item for item in value if isinstance(item, dict)] if isinstance(value, list) else []


def _integer(value: Any, default: int) -> int:
    return value if isinstance(value, int) and abs(value) < 2**63 else default
