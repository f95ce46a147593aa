"""What the record of the solvers says of a plan: feasible but not proven optimal is a finding, no failure."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import polars as pl

from istc_replay.config import Config
from istc_replay.datatypes import SOUND, Verdict
from istc_replay.safety.log_audit import Audit
from istc_replay.safety.rules import SOLVER_RULE
from istc_replay.states import FINDINGS_SCHEMA


def with_solver_record(audit: Audit, windows: Sequence[Mapping[str, Any]], config: Config) -> Audit:
    """The audit with a finding for each plan whose corridors are not proven optimal.

    Parameters
    ----------
    audit : Audit
        The audit of what was recorded.
    windows : sequence of mappings
        The windows of a summary: what the solvers said of each.
    config : Config
        The gap that was asked for.
    """
    rows = [row for window in windows if (row := _finding(window, config)) is not None]
    if not rows:
        return audit
    findings = pl.concat([audit.findings, pl.DataFrame(rows, schema=FINDINGS_SCHEMA)])
    return replace(audit, findings=findings.sort("start_ns", "rule", "worst_ns", "finding_id"))


def _finding(window: Mapping[str, Any], config: Config) -> dict[str, Any] | None:
    corridors = window.get("corridors") or {}
    if window.get("status") not in SOUND or corridors.get("status") == "optimal":
        return None
    gap, start = corridors.get("gap"), int(window["start_ns"])
    known = isinstance(gap, int | float)
    found_by = f"window {window['index']}: found by {corridors.get('found_by')}"
    how = "feasible, its objective within this share of the bound" if known else "feasible, without a bound"
    return {
        "finding_id": hashlib.sha256(f"{SOLVER_RULE}\x1e{start}".encode()).hexdigest()[:16],
        "rule": SOLVER_RULE,
        "verdict": Verdict.FAIL.value,
        "severity": "minor",
        "vehicles": [],
        "start_ns": start,
        "worst_ns": start,
        "end_ns": int(window["end_ns"]),
        "x_m": None,
        "y_m": None,
        "value": float(gap) if known else float("inf"),  # type: ignore[arg-type]
        "unit": "",
        "threshold": config.corridors.gap_tolerance,
        "threshold_source": "ours: corridors.gap_tolerance",
        "topic": "/istc/solves",
        "message_index": None,
        "encounter_id": None,
        "detail": f"{found_by}; {how}; not proven optimal",
    }
