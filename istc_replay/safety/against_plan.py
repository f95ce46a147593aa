"""What was recorded against what was planned: a counterfactual estimate, as nobody drove the plan.

The planned motion is the one that its first state and controls cause, at the instants of the
recording; both sides of every comfort figure then pass the same filter at the same rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from istc_replay.config import AuditConfig, Config
from istc_replay.datatypes import FloatArray, Result, StaticScene
from istc_replay.geometry import to_frame, to_map
from istc_replay.safety.bodies import Body, recorded_bodies
from istc_replay.safety.case import Case, build_case
from istc_replay.safety.findings import Finding, make_finding
from istc_replay.safety.plan import WrittenPlan
from istc_replay.safety.recorded import Track, recorded_tracks
from istc_replay.safety.rules import CORRIDOR_RULE
from istc_replay.safety.vehicle_samples import smoothed_motion
from istc_replay.safety.walls import wall_margin
from istc_replay.safety.written_plans import written_plans
from istc_replay.states import AGAINST_PLAN_SCHEMA, conform
from istc_replay.units import NS_PER_S, wrap_angle

IntArray = NDArray[np.int64]

#: What every row is.
ESTIMATE = "counterfactual estimate"


def against_plan(result: Result, config: Config) -> pl.DataFrame:
    """Compare each vehicle's recording with its plan, window by window.

    Parameters
    ----------
    result : Result
        As read back; trajectories that are not certified are no plan.
    config : Config
        The audit's filter, and how far out of its corridor a vehicle may be.

    Returns
    -------
    DataFrame
        The table of AGAINST_PLAN_SCHEMA, a row a window and vehicle with a plan. Where nothing
        was recorded in the plan's span, the figures are null.
    """
    recorded = {body.name: body for body in recorded_bodies(recorded_rows(result), config.vehicles)}
    tracks, rows = recorded_tracks(result.states), list[dict[str, Any]]()
    for plan in written_plans([result]):
        rows += compared_rows(plan, tracks, recorded, result.scene, config)
    return against_plan_table(rows)


@np.errstate(all="ignore")
def compared_rows(
    plan: WrittenPlan,
    tracks: Mapping[str, Track],
    recorded: Mapping[str, Body],
    scene: StaticScene,
    config: Config,
) -> list[dict[str, Any]]:
    """Rows of AGAINST_PLAN_SCHEMA of one window's plan; `tracks` and `recorded` are those of all vehicles."""
    case = build_case(plan, tracks, scene, config) if plan.plans else None
    if case is None:
        return []
    return [
        _row(case, row, recorded.get(name), config.audit)
        for row, name in enumerate(case.driven)
        if case.motion.judged[row]
    ]


def against_plan_table(rows: Sequence[dict[str, Any]]) -> pl.DataFrame:
    """The table of such rows."""
    table = pl.DataFrame(rows, schema=AGAINST_PLAN_SCHEMA) if rows else AGAINST_PLAN_SCHEMA.to_frame()
    return conform(table.with_columns(pl.col(pl.Float64).fill_nan(None)), AGAINST_PLAN_SCHEMA)


def recorded_rows(result: Result) -> pl.DataFrame:
    """The recorded states of a result."""
    return result.states.filter(pl.col("source") == "recorded")


def corridor_findings(
    against: pl.DataFrame, bodies: list[Body], spans: list[IntArray], audit: AuditConfig
) -> list[Finding]:
    """Findings of vehicles that were recorded outside their planned corridors."""
    rows = {body.name: row for row, body in enumerate(bodies)}
    levels = [level for _, level, _ in CORRIDOR_RULE.thresholds(audit)]
    found = []
    for told in against.filter(pl.col("first_exit_ns").is_not_null()).iter_rows(named=True):
        row = rows.get(told["vehicle_id"])
        if row is None:
            continue
        depth = told["deepest_m"]
        times = (told["first_exit_ns"], told["deepest_ns"], told["last_out_ns"])
        level = sum(depth > level for level in levels) - 1
        x, y = bodies[row].track.at(np.array([told["deepest_ns"]]))[0, :2].tolist()
        where = f"out of the corridor planned in window {told['window']} for {told['outside_s']:.3g} s"
        how = (depth, f"{where}; {ESTIMATE}", bodies, spans)
        found.append(make_finding(CORRIDOR_RULE, audit, level, (row,), times, (x, y), *how))
    return found


def _row(case: Case, row: int, body: Body | None, audit: AuditConfig) -> dict[str, Any]:
    knots = case.plan.plans[case.driven[row]].knots_ns + case.plan.start_ns
    told: dict[str, Any] = {
        "window": case.plan.index,
        "vehicle_id": case.driven[row],
        "start_ns": int(knots[0]),
        "end_ns": int(knots[-1]),
        "samples": 0,
        "estimate": ESTIMATE,
    }
    if body is None:
        return told
    times = body.track.times_ns
    inside = np.flatnonzero((times >= knots[0]) & (times <= knots[-1]))
    if not inside.size:
        return told
    times = times[inside]
    driven = _part(body, times, body.track.states[inside])
    planned = _part(body, times, _planned(case, row, times - case.plan.start_ns))
    told |= {"samples": int(inside.size)}
    told |= _outside(case, row, driven, audit) | _deviation(driven, planned) | _delay(driven, planned)
    for side, part in (("recorded", driven), ("planned", planned)):
        told |= {f"{side}_{name}": value for name, value in _comfort(part, audit).items()}
    return told


def _part(body: Body, times_ns: IntArray, states: FloatArray) -> Body:
    return replace(body, track=Track.of(times_ns, states, body.track.length_m, body.track.width_m))


def _planned(case: Case, row: int, times_ns: IntArray) -> FloatArray:
    """(n, 4) planned box centre, heading and speed in the map frame, times from the window's start."""
    piece = np.clip(np.searchsorted(case.edges_ns, times_ns, side="right") - 1, 0, case.edges_ns.size - 2)
    held = np.nonzero(case.motion.present[row])[0]
    piece = np.clip(piece, held[0], held[-1])  # the plan's last instant is in its last piece
    vehicle = np.full(times_ns.size, row)
    offset = (times_ns - case.edges_ns[piece]) / NS_PER_S
    boxes, _ = case.motion.sample(vehicle, piece, offset)
    speeds = case.motion.at(vehicle, piece, offset)[:, 4]
    points = to_map(boxes[:, :2], case.plan.frame)
    return np.column_stack([points, wrap_angle(boxes[:, 2] + case.plan.frame.yaw_rad), speeds])


def _outside(case: Case, row: int, driven: Body, audit: AuditConfig) -> dict[str, Any]:
    """When the recorded box first left its corridor, for how long, and how deep it was out."""
    track, frame = driven.track, case.plan.frame
    times = track.times_ns - case.plan.start_ns
    centres = to_frame(track.states[:, :2], frame)
    size = np.broadcast_to([track.length_m, track.width_m], (times.size, 2))
    boxes = np.column_stack([centres, track.states[:, 2] - frame.yaw_rad, size])
    walls = case.walls_m[case.walled_row[row]]
    last = case.edges_ns.size - 2
    # Units are closed: at a boundary either cube will do.
    either = [np.clip(np.searchsorted(case.edges_ns, times, side=s) - 1, 0, last) for s in ("left", "right")]
    depth = -np.fmax(wall_margin(boxes, walls[either[0]]), wall_margin(boxes, walls[either[1]]))
    known = np.flatnonzero(np.isfinite(depth))
    if not known.size:
        return {}
    out = depth > audit.off_corridor_minor_m
    step = np.minimum(np.diff(track.times_ns, append=track.times_ns[-1:]), track.period_ns) / NS_PER_S
    deepest = int(known[np.argmax(depth[known])])
    gone = np.flatnonzero(out)
    return {
        "first_exit_ns": int(track.times_ns[gone[0]]) if gone.size else None,
        "last_out_ns": int(track.times_ns[gone[-1]]) if gone.size else None,
        "deepest_m": float(depth[deepest]),
        "deepest_ns": int(track.times_ns[deepest]),
        "outside_s": float(step[out].sum()),
    }


def _deviation(driven: Body, planned: Body) -> dict[str, Any]:
    apart = np.hypot(*(driven.track.states[:, :2] - planned.track.states[:, :2]).T)
    most = int(np.argmax(apart))
    return {
        "deviation_mean_m": float(apart.mean()),
        "deviation_most_m": float(apart[most]),
        "deviation_most_ns": int(driven.track.times_ns[most]),
        "deviation_end_m": float(apart[-1]),
    }


def _delay(driven: Body, planned: Body) -> dict[str, Any]:
    """Planned less recorded time at equal arc length: the most of either sign, and the last."""
    (way, when), (other, then) = _first_passages(driven), _first_passages(planned)
    reach = min(way[-1], other[-1])
    if reach <= 0.0:
        return {}
    at = np.append(way[way < reach], reach)
    delay = np.interp(at, other, then) - np.interp(at, way, when)
    return {
        "delay_end_s": float(delay[-1]),
        "delay_most_s": float(delay[np.argmax(np.abs(delay))]),
        "compared_m": float(reach),
    }


def _first_passages(body: Body) -> tuple[FloatArray, FloatArray]:
    """Arc lengths, strictly increasing, and when each was first reached."""
    steps = np.hypot(*np.diff(body.track.states[:, :2], axis=0).T)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    times = (body.track.times_ns - body.track.times_ns[0]) / NS_PER_S
    new = np.concatenate([[True], np.diff(way) > 0.0])
    return way[new], times[new]


def _comfort(body: Body, audit: AuditConfig) -> dict[str, float]:
    motion = smoothed_motion(body, audit)
    found = {
        "braking_mps2": np.maximum(-motion.acceleration_mps2, 0.0),
        "lateral_mps2": np.abs(motion.lateral_mps2),
        "jerk_mps3": np.abs(motion.jerk_mps3),
    }
    return {name: float(np.nanmax(values)) for name, values in found.items() if not np.isnan(values).all()}
