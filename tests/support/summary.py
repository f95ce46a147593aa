"""The summary of a plan, with its timings, written out by hand."""

from __future__ import annotations

from typing import Any

from istc_replay.datatypes import Certificate, Log, Participant, Verdict, WindowPlan

_TOTALS = {
    "windows": 1,
    "windows_full": 1,
    "vehicles_present": 3,
    "vehicles_plannable": 3,
    "vehicles_certified": 3,
    "log_s": 6.0,
    "cpu_s": 1.5,
}


def summary_of(log: Log, plan: WindowPlan, certificates: list[Certificate]) -> dict[str, Any]:
    """The summary of a log whose one window has this plan."""
    return {
        "schema": "istc-replay.summary.v1",
        "input": {"path": log.path, "sha256": log.sha256, "complete": True, "problems": []},
        "versions": {"istc-replay": "0.1.0"},
        "config_sha256": "1" * 64,
        "windows": [_window(plan, certificates)],
        "totals": _TOTALS,
        "stages": {"ingest": 0.01, "corridors": 0.95, "trajectories": 0.06},
    }


def _window(plan: WindowPlan, certificates: list[Certificate]) -> dict[str, Any]:
    window = plan.scenario.window
    return {
        "index": window.index,
        "start_ns": window.start_ns,
        "end_ns": window.end_ns,
        "unit_s": window.unit_s,
        "units": window.units,
        "frame": {"x_m": window.frame.x_m, "y_m": window.frame.y_m, "yaw_rad": window.frame.yaw_rad},
        "status": "certified",
        "reason": "",
        "vehicles_present": 3,
        "vehicles_plannable": 3,
        "vehicles_certified": 3,
        "excluded": {},
        "exclusions": [],
        "rounds": 1,
        "undrivable": [],
        "corridors": _corridors(plan),
        "trajectories": {"seconds": 0.06},
        "certificate": {"verdict": "fail", "checks": [_check(c) for c in certificates if _judged(c)]},
        "recorded": {"min_separation_m": 4.2, "pair": ["car 1", "car 2"], "time_s": 5.0},
        "vehicles": [_vehicle(participant) for participant in plan.scenario.participants],
    }


def _corridors(plan: WindowPlan) -> dict[str, Any]:
    found = plan.corridors
    assert found is not None
    told = {name: getattr(found, name) for name in ("objective", "bound", "gap", "found_by", "reason")}
    return {"status": found.status.value, **told, "seconds": 0.95}


def _vehicle(participant: Participant) -> dict[str, Any]:
    return {
        "id": participant.vehicle_id,
        "priority": participant.priority,
        "dimensions_source": "log",
        "first_unit": participant.first_unit,
        "units": participant.units,
        "corridor_area_m2": 100.0 + 50.0 * participant.priority,
        "pivot_deviation_m": 0.14,
        "guidance": "recorded",
        "speed_std_mps": 0.1,
    }


def _judged(certificate: Certificate) -> bool:
    return certificate.verdict is not Verdict.NOT_APPLICABLE


def _check(certificate: Certificate) -> dict[str, Any]:
    told = {name: getattr(certificate, name) for name in ("check", "margin", "unit", "time_s")}
    return {
        **told,
        "verdict": certificate.verdict.value,
        "vehicles": list(certificate.vehicles),
        "detail": "",
    }
