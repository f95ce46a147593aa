"""A fleet's figures: a row a log and a row a window, from what each log's folder holds."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import polars as pl

from istc_replay.fleet.manifest import Entry

LOGS_SCHEMA = pl.Schema(
    {
        "log": pl.String(),  # the name of its folder
        "location": pl.String(),
        "outcome": pl.String(),  # done, inconclusive, failed, waiting
        "error": pl.String(),
        "severity": pl.String(),  # the worst of its findings that can be trusted
        "critical": pl.Int64(),
        "serious": pl.Int64(),
        "minor": pl.Int64(),
        "in_doubt": pl.Int64(),
        "windows": pl.Int64(),
        "windows_full": pl.Int64(),
        "vehicles_present": pl.Int64(),
        "vehicles_plannable": pl.Int64(),
        "vehicles_certified": pl.Int64(),
        "log_s": pl.Float64(),
        "complete": pl.Boolean(),
        "problems": pl.Int64(),
        "least_gap_m": pl.Float64(),  # as recorded
        "least_ttc_s": pl.Float64(),
        "least_pet_s": pl.Float64(),
        "corridors_s": pl.Float64(),
        "trajectories_s": pl.Float64(),
        "most_gap": pl.Float64(),
        "page": pl.String(),  # what of its folder a link leads to
        "seconds": pl.Float64(),
        "cpu_s": pl.Float64(),
        "peak_mb": pl.Float64(),
        "tries": pl.Int64(),
        "worker": pl.String(),
        "log_sha256": pl.String(),
    }
)

WINDOWS_SCHEMA = pl.Schema(
    {
        "log": pl.String(),
        "window": pl.Int32(),
        "start_ns": pl.Int64(),
        "end_ns": pl.Int64(),
        "status": pl.String(),
        "reason": pl.String(),
        "vehicles_present": pl.Int64(),
        "vehicles_plannable": pl.Int64(),
        "vehicles_certified": pl.Int64(),
        "corridors_s": pl.Float64(),
        "trajectories_s": pl.Float64(),
        "objective": pl.Float64(),
        "gap": pl.Float64(),
        "recorded_gap_m": pl.Float64(),
    }
)

PROBLEMS_SCHEMA = pl.Schema({"log": pl.String(), "code": pl.String(), "detail": pl.String()})

_SEVERITIES = ("critical", "serious", "minor")
_TEXT_CHARACTERS = 1000


def entry_row(entry: Entry) -> dict[str, Any]:
    """What the manifest tells of a log."""
    row = {key: entry.get(key) for key in ("seconds", "cpu_s", "peak_mb", "tries", "worker", "log_sha256")}
    row |= {"log": entry["folder"], "location": _text(entry["log"]), "outcome": entry["event"]}
    return {**row, "error": _text(entry.get("error", ""))}


def read_summary(folder: Path) -> dict[str, Any] | None:
    """Read a log's summary; None where it is missing or damaged."""
    try:
        summary = json.loads((folder / "summary.json").read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return summary if isinstance(summary, dict) and isinstance(summary.get("windows"), list) else None


def summary_row(summary: dict[str, Any], folder: Path) -> dict[str, Any]:
    """What a log's summary tells of it."""
    totals, source = summary.get("totals") or {}, summary.get("input") or {}
    audit = summary.get("audit") or {}
    counts = audit.get("counts") or {}
    windows = [_window_row(window) for window in summary["windows"]]
    pages = [name for name in ("report.html", "summary.json") if (folder / name).is_file()]
    names = (
        "windows",
        "windows_full",
        "vehicles_present",
        "vehicles_plannable",
        "vehicles_certified",
        "log_s",
    )
    return {
        **{name: totals.get(name) for name in names},
        **{name: counts.get(name) for name in _SEVERITIES},
        "severity": next((name for name in _SEVERITIES if counts.get(name)), None),
        "in_doubt": audit.get("inconclusive"),
        "complete": source.get("complete"),
        "problems": len(source.get("problems") or ()),
        "least_gap_m": _least(w["recorded_gap_m"] for w in windows),
        "corridors_s": _sum(w["corridors_s"] for w in windows),
        "trajectories_s": _sum(w["trajectories_s"] for w in windows),
        "most_gap": max((w["gap"] for w in windows if w["gap"] is not None), default=None),
        "page": pages[0] if pages else None,
    }


def window_rows(summary: dict[str, Any], log: str) -> Iterator[dict[str, Any]]:
    """What a log's summary tells of its windows."""
    for window in summary["windows"]:
        yield {"log": log, **_window_row(window)}


def problem_rows(summary: dict[str, Any], log: str) -> Iterator[dict[str, Any]]:
    """What is wrong with a log."""
    for problem in (summary.get("input") or {}).get("problems") or ():
        yield {"log": log, "code": _text(problem.get("code")), "detail": _text(problem.get("detail"))}


def _window_row(window: dict[str, Any]) -> dict[str, Any]:
    corridors, recorded = window.get("corridors") or {}, window.get("recorded") or {}
    names = ("start_ns", "end_ns", "status", "vehicles_present", "vehicles_plannable", "vehicles_certified")
    return {
        "window": window.get("index"),
        **{name: window.get(name) for name in names},
        "reason": _text(window.get("reason")),
        "corridors_s": corridors.get("seconds"),
        "trajectories_s": (window.get("trajectories") or {}).get("seconds"),
        "objective": corridors.get("objective"),
        "gap": corridors.get("gap"),
        "recorded_gap_m": recorded.get("min_separation_m"),
    }


def _text(value: Any) -> str:
    """Text for a table: what cannot be encoded is written out."""
    shown = str(value if value is not None else "").encode("utf-8", "backslashreplace").decode()
    return shown[:_TEXT_CHARACTERS]


def _least(values: Iterable[float | None]) -> float | None:
    return min((v for v in values if v is not None), default=None)


def _sum(values: Iterable[float | None]) -> float:
    return sum(v for v in values if v is not None)
