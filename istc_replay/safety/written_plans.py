"""The plans of a result's windows, as they are read from what is written.

Nothing here trusts the writer: a corridor or a trajectory with a fault is left out and named, and
the checks then cannot pass.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl

from istc_replay.datatypes import Result
from istc_replay.safety.plan import Fault, WrittenPlan
from istc_replay.safety.plan_rows import (
    UnsoundError,
    check_units,
    read_cubes,
    read_frame,
    read_obstacle,
    read_vehicle_plan,
)

#: Why vehicles that are not planned are obstacles.
_AS_RECORDED = ("not_a_vehicle", "uncooperative", "parked")
#: Window statuses that say that no plan was made.
_WITHOUT_PLAN = ("conflict_left", "no_corridors", "not_drivable", "nothing_to_plan")


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
    frame, frame_fault = read_frame(corridors)
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
                raise UnsoundError(frame_fault)
            cubes = read_cubes(cube_rows.get(vehicle_id, corridors.clear()), start_ns)
            check_units(cubes, listed.get(vehicle_id, {}))
            plan.cubes[vehicle_id] = cubes
            rows = state_rows.get(vehicle_id, states.clear())
            plan.plans[vehicle_id] = read_vehicle_plan(rows, cubes, start_ns, frame)
        except UnsoundError as fault:
            plan.faults.append(Fault(vehicle_id, fault.time_s, str(fault)))
    for obstacle_id, rows in _by_vehicle(obstacles, "obstacle_id").items():
        try:
            if read_frame(rows) != (frame, ""):
                raise UnsoundError("its frame is not the corridors' frame")
            plan.obstacles[obstacle_id] = read_obstacle(rows, start_ns)
        except UnsoundError as fault:
            plan.obstacle_faults.append(Fault(obstacle_id, fault.time_s, str(fault)))
    return plan


def _span(corridors: pl.DataFrame, states: pl.DataFrame) -> tuple[int, int]:
    """First and last instant of the rows [ns]."""
    times = pl.concat([corridors["start_ns"], corridors["end_ns"], states["time_ns"]]).drop_nulls().to_numpy()
    return (int(times.min()), int(times.max())) if times.size else (0, 0)


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
