"""summary.json: the figures of every window, as one dict of plain values."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from istc_replay.datatypes import ARRIVED_M, SOUND, Verdict
from istc_replay.geometry import box_poses
from istc_replay.ingest.result import SUMMARY_SCHEMA
from istc_replay.safety.certificate import overall
from istc_replay.safety.rules import worst_first
from istc_replay.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from istc_replay.datatypes import (
        Certificate,
        Change,
        Lateral,
        Log,
        Participant,
        RecordedGap,
        Scenario,
        Trajectory,
        WindowOutcome,
        WindowPlan,
    )
    from istc_replay.safety.log_audit import Audit

#: Findings that the summary lists, worst first.
_WORST = 20
_OF_THE_WINDOW = ("window", "vehicle_id", "start_ns", "end_ns")


def summarise(
    log: Log, windows: list[dict[str, Any]], versions: Mapping[str, str], config_sha256: str
) -> dict[str, Any]:
    """Sum up a replay; wall-clock figures of the whole run and the audit are added by the caller.

    Parameters
    ----------
    log : Log
        The input.
    windows : list of dict
        The figures of each (`window_figures`).
    versions : mapping
        Version by component.
    config_sha256 : str
        Hash of the configuration in force.
    """
    return {
        "schema": SUMMARY_SCHEMA,
        "input": {
            "path": log.path,
            "sha256": log.sha256,
            "complete": log.complete,
            "problems": [{"code": p.code, "detail": p.detail, "offset": p.offset} for p in log.problems],
        },
        "versions": dict(versions),
        "config_sha256": config_sha256,
        "windows": windows,
        "totals": _totals(log, windows),
        "audit": None,
    }


def summary_text(summary: Mapping[str, Any]) -> Iterator[str]:
    """A summary as JSON, piece by piece: of what there are many, such as windows and solves, one a line.

    Raises
    ------
    TypeError, ValueError
        If it holds what is no plain finite value.
    """
    before = "{\n"
    for key, value in summary.items():
        yield f"{before} {json.dumps(key)}: "
        before = ",\n"
        if isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
            for number, item in enumerate(value):
                line = json.dumps(item, allow_nan=False, separators=(",", ":"))
                yield f",\n{line}" if number else f"[\n{line}"
            yield "\n ]"
        else:
            yield json.dumps(value, indent=1, allow_nan=False).replace("\n", "\n ")
    yield "{}\n" if before == "{\n" else "\n}\n"


def audited(audit: Audit | str) -> dict[str, Any]:
    """What the audit of the recording found, or why there is none; all of it is the topic /istc/findings."""
    if isinstance(audit, str):
        return {"verdict": str(Verdict.INCONCLUSIVE), "reason": audit}
    severe = worst_first(audit.findings.filter(pl.col("severity").is_not_null()))
    names = ("finding_id", "rule", "verdict", "severity", "vehicles", "worst_ns", "unit", "detail")
    return {
        "verdict": str(audit.verdict),
        "counts": audit.counts,
        "inconclusive": audit.in_doubt,
        "encounters": audit.encounters.height,
        "worst": [
            {name: row[name] for name in names}
            | {"value": row["value"] if math.isfinite(row["value"]) else None}
            for row in severe.head(_WORST).iter_rows(named=True)
        ],
    }


def _totals(log: Log, windows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    def total(name: str) -> int:
        return sum(int(window[name]) for window in windows)

    span = 0 if log.start_ns is None or log.end_ns is None else log.end_ns - log.start_ns
    return {
        "windows": len(windows),
        "windows_full": sum(
            w["vehicles_plannable"] > 0 and w["vehicles_certified"] == w["vehicles_plannable"]
            for w in windows
        ),
        "vehicles_present": total("vehicles_present"),
        "vehicles_plannable": total("vehicles_plannable"),
        "vehicles_certified": total("vehicles_certified"),
        "vehicles_changed": sum(w["coordination"]["vehicles_changed"] for w in windows),
        "delay_s": sum(w["coordination"]["delay_s"] for w in windows),
        "log_s": span / NS_PER_S,
    }


def window_figures(outcome: WindowOutcome) -> dict[str, Any]:
    """The figures of one window."""
    plan, certificates = outcome.plan, outcome.certificates
    scenario, window, corridors = plan.scenario, plan.scenario.window, plan.corridors
    certified = plan.status in SOUND
    told = outcome.changes if certified else ()
    reasons = [e.reason for e in scenario.excluded]
    return {
        "index": window.index,
        "start_ns": window.start_ns,
        "end_ns": window.end_ns,
        "rules": "traffic" if scenario.traffic else "scene",
        "unit_s": window.unit_s,
        "units": window.units,
        "frame": {"x_m": window.frame.x_m, "y_m": window.frame.y_m, "yaw_rad": window.frame.yaw_rad},
        "status": str(plan.status),
        "reason": plan.reason,
        "vehicles_present": scenario.vehicles_present,
        "vehicles_plannable": len(scenario.participants) + len(plan.frozen),
        "vehicles_certified": len(plan.trajectories) if certified else 0,
        "excluded": {reason: reasons.count(reason) for reason in sorted(set(reasons))},
        "exclusions": [
            {"vehicle_id": e.vehicle_id, "reason": e.reason, "detail": e.detail} for e in scenario.excluded
        ],
        "frozen": [{"vehicle_id": e.vehicle_id, "reason": e.reason, "detail": e.detail} for e in plan.frozen],
        "vehicle_gap_m": plan.vehicle_gap_m,
        "obstacle_gap_m": plan.obstacle_gap_m,
        "rounds": plan.rounds,
        "undrivable": [
            {"vehicle_id": u.vehicle_id, "unit": u.unit, "slack_m": u.slack_m, "detail": u.detail}
            for u in plan.undrivable
        ],
        "conflicts": [
            {"vehicles": [c.first, c.second], "unit": c.unit}
            for c in (() if corridors is None else corridors.conflicts)
        ],
        "late": list(plan.late),
        "corridors": {
            "status": None if corridors is None else str(corridors.status),
            "objective": None if corridors is None else corridors.objective,
            "bound": None if corridors is None else corridors.bound,
            "gap": None if corridors is None else corridors.gap,
            "found_by": "" if corridors is None else corridors.found_by,
            "reason": "" if corridors is None else corridors.reason,
            "seconds": plan.seconds.get("corridors", 0.0),
        },
        "trajectories": {"seconds": plan.seconds.get("trajectories", 0.0)},
        "certificate": _certificate(certificates),
        "recorded": _recorded(outcome.recorded, window.start_ns),
        "coordination": _coordination(told),
        "vehicles": _vehicles(scenario, plan, outcome.against_plan, told),
    }


def _coordination(told: Sequence[Change]) -> dict[str, Any]:
    """What coordination changed in a window: sums, and the most of any vehicle."""
    return {
        "vehicles_changed": sum(change.changed for change in told),
        "delay_s": sum(change.delay_s for change in told),
        "deviation_most_m": max((change.deviation_m for change in told), default=0.0),
        "lateral_most_m": max((change.lateral_m for change in told), default=0.0),
        "clearance_least_m": min((c.clearance_m for c in told if c.clearance_m is not None), default=None),
    }


def _certificate(certificates: Sequence[Certificate]) -> dict[str, Any]:
    return {
        "verdict": str(overall(certificates) if certificates else Verdict.NOT_APPLICABLE),
        "checks": [
            {
                "check": c.check,
                "verdict": str(c.verdict),
                "margin": c.margin,
                "unit": c.unit,
                "time_s": c.time_s,
                "vehicles": list(c.vehicles),
                "detail": c.detail,
            }
            for c in certificates
        ],
    }


def _recorded(gap: RecordedGap | None, start_ns: int) -> dict[str, Any] | None:
    if gap is None:
        return None
    return {
        "min_separation_m": gap.min_separation_m,
        "pair": list(gap.pair),
        "time_s": (gap.time_ns - start_ns) / NS_PER_S,
    }


def _vehicles(
    scenario: Scenario,
    plan: WindowPlan,
    against_plan: Sequence[dict[str, Any]],
    changes: Sequence[Change],
) -> list[dict[str, Any]]:
    corridors = {c.vehicle_id: c for c in (plan.corridors.corridors if plan.corridors else ())}
    guidance = {g.vehicle_id: g for g in plan.guidance}
    trajectories = {t.vehicle_id: t for t in plan.trajectories}
    changed = {change.vehicle_id: asdict(change) for change in changes}
    compared = {row["vehicle_id"]: row for row in against_plan}
    beside = {kept.vehicle_id: kept for kept in plan.lateral}
    rows = []
    for participant in scenario.participants:
        row = _vehicle(participant)
        against = compared.get(participant.vehicle_id, {})
        told = {key: value for key, value in against.items() if key not in _OF_THE_WINDOW}
        row["recorded_against_plan"] = told or None
        change = changed.get(participant.vehicle_id)
        row["coordination"] = change and {key: change[key] for key in change if key != "vehicle_id"}
        kept = beside.get(participant.vehicle_id)
        row["lateral"] = kept and _lateral(kept)
        guide = guidance.get(participant.vehicle_id)
        row["guidance"] = None if guide is None else guide.kind
        corridor = corridors.get(participant.vehicle_id)
        if corridor is not None:
            width, height = np.diff(corridor.cubes_m)[:, [0, 2]].T
            row["corridor_area_m2"] = float(width @ height)
            row["corridor_breadth_m"] = float((width + height).sum())
            deviation = np.hypot(*(corridor.pivots_m - corridor.references_m).T)
            row["pivot_deviation_m"] = float(deviation[1:].mean())
        trajectory = trajectories.get(participant.vehicle_id)
        if trajectory is not None:
            row |= _motion(participant, trajectory)
        rows.append(row)
    return rows


def _lateral(kept: Lateral) -> dict[str, Any]:
    """How a plan keeps its lateral bound."""
    return {
        "bounds": list(kept.bounds),
        "excursion_m": kept.excursion_m,
        "margin_m": kept.margin_m,
        "bound": kept.bound,
        "recorded_off_road_m": kept.off_road_m,
    }


def _vehicle(participant: Participant) -> dict[str, Any]:
    return {
        "id": participant.vehicle_id,
        "priority": participant.priority,
        "dimensions_source": participant.dimensions_source,
        "start": "recording" if participant.approach is None else "handed_over",
        "first_unit": participant.first_unit,
        "units": participant.units,
        "corridor_area_m2": None,
        "corridor_breadth_m": None,
        "pivot_deviation_m": None,
        "speed_std_mps": None,
        "length_m": None,
        "goal_distance_m": None,
        "arrived": None,
    }


def _motion(participant: Participant, trajectory: Trajectory) -> dict[str, Any]:
    steps = np.diff(trajectory.states[:, :2], axis=0)
    found: dict[str, Any] = {
        "speed_std_mps": float(trajectory.states[:, 4].std()),
        "length_m": float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
    }
    recording = participant.recording
    if recording.ends_standing:
        end = box_poses(trajectory.states[-1], trajectory.dimensions.rear_axle_to_centre_m)
        distance = float(np.hypot(*(recording.poses[-1] - end)[:2]))
        arrived = distance <= ARRIVED_M
        found |= {
            "goal_distance_m": distance,
            "arrived": None if participant.goes_on and not arrived else arrived,
        }
    return found
