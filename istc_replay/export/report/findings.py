"""Findings of the audit as a section of a report, and what was recorded against what was planned."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import polars as pl

from istc_replay.datatypes import Result
from istc_replay.export.report.markup import (
    NOTHING,
    Html,
    element,
    fixed,
    join,
    name,
    names,
    number,
    prose,
    table,
)
from istc_replay.safety.rules import worst_first
from istc_replay.units import NS_PER_S

Row = dict[str, Any]

#: Findings that the report of a replay lists.
_LISTED = 30

TONES = {"critical": "bad", "serious": "open", "minor": None, None: None}
WORDS = {"critical": "✗ critical", "serious": "! serious", "minor": "minor", None: "? in doubt"}


def recorded_behaviour(result: Result) -> Html | None:
    """The section of what the audit found in the recording; None where it was not audited."""
    audit = result.summary.get("audit")
    if audit is None:
        return None
    title = element("h2", "Recorded behaviour")
    if "reason" in audit:
        return join([title, element("p", "It was not judged: ", prose(audit["reason"]))])
    counts = ", ".join(f"{count} {severity}" for severity, count in reversed(list(audit["counts"].items())))
    lines = [element("p", f"Findings: {counts}; {number(audit['inconclusive'])} of doubtful data.")]
    if not result.findings.is_empty():
        starts = [int(window["start_ns"]) for window in result.summary.get("windows") or ()]
        caption = "Findings in what was recorded, worst first; times are from the first window's start"
        lines.append(findings_table(result.findings, min(starts, default=0), caption, _LISTED))
    more = (
        "istc-replay audit tells more: pictures of encounters, coverage, thresholds, certificates made anew."
    )
    return join([title, *lines, element("p", more)])


def severity_word(row: Row) -> Html:
    """A finding's severity in words and colour; in doubt where its data are."""
    severity = row["severity"]
    if row["verdict"] == "inconclusive" and severity is not None:
        return element("span", f"? {severity}, in doubt", class_="open")
    return element("span", WORDS.get(severity, str(severity)), class_=TONES.get(severity))


def findings_table(
    findings: pl.DataFrame,
    start_ns: int,
    caption: str,
    most: int,
    link: Callable[[Row], Html | None] | None = None,
) -> Html:
    """A table of findings, worst first; `link` gives what leads to a finding's instant."""
    rows = [
        (
            severity_word(row),
            row["rule"].replace("_", " "),
            names(row["vehicles"] or [], 4),
            number((row["worst_ns"] - start_ns) / NS_PER_S, 2),
            _measured(row["value"], row["unit"]),
            join([number(row["threshold"], 2), " (", prose(row["threshold_source"]), ")"]),
            prose(row["detail"] or NOTHING),
            join([name(row["topic"]), f" {row['message_index']}"]),
            *((link(row) or NOTHING,) if link else ()),
        )
        for row in worst_first(findings).head(most).iter_rows(named=True)
    ]
    headings = ("Severity", "rule", "vehicles", "at [s]", "value", "threshold", "detail", "message")
    rest = findings.height - len(rows)
    more = element("p", f"{rest} more are in the tables.") if rest > 0 else None
    shown = (*headings, "instant") if link else headings
    return join([table(caption, shown, rows, (3, 4)), more])


def _measured(value: float | None, unit: str) -> str:
    if value is not None and value == float("inf"):
        return "∞"
    return number(value, 2, unit.replace("^2", "²").replace("^3", "³"))


def against_plan_table(rows: list[Row], windows: bool) -> Html | None:
    """Recorded against planned, a row a vehicle; None where nothing was compared."""
    compared = [row for row in rows if row.get("samples")]
    if not compared:
        return None
    cells = [
        (
            name(row["vehicle_id"]),
            *((number(row["window"]),) if windows else ()),
            _exit(row),
            fixed(row["deepest_m"], 2),
            fixed(row["deviation_mean_m"], 2),
            fixed(row["deviation_most_m"], 2),
            fixed(row["delay_end_s"], 2),
            _both(row, "braking_mps2"),
            _both(row, "lateral_mps2"),
            _both(row, "jerk_mps3"),
        )
        for row in compared
    ]
    headings = (
        *("Vehicle", *(("window",) if windows else ()), "out of its corridor from", "deepest [m]"),
        *("deviation [m]", "most [m]", "delay [s]", "braking [m/s²]", "lateral [m/s²]", "jerk [m/s³]"),
    )
    caption = (
        "What was recorded against what was planned: a counterfactual estimate, as nobody drove the plan. "
        "Delay is the planned less the recorded time at equal arc length; the last three columns are the "
        "most, recorded / planned, through the same filter"
    )
    return table(caption, headings, cells, range(2 + windows, len(headings)))


def _exit(row: Row) -> str:
    if row["first_exit_ns"] is None:
        return "never" if row["deepest_m"] is not None else NOTHING
    return f"{number((row['first_exit_ns'] - row['start_ns']) / NS_PER_S, 2, 's')} on"


def _both(row: Row, what: str) -> str:
    return f"{fixed(row[f'recorded_{what}'], 1)} / {fixed(row[f'planned_{what}'], 1)}"
