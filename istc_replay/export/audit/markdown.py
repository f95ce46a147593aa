"""audit.md: the findings, worst first, for people and the pages of a CI run."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import polars as pl

from istc_replay.datatypes import Verdict
from istc_replay.safety.log_audit import Audit
from istc_replay.safety.rules import SEVERITIES, worst_first
from istc_replay.units import NS_PER_S

#: Rows that a table lists; the files of tables have them all.
_LISTED = 50


def audit_markdown(audit: Audit) -> str:
    """Give a summary for people."""
    found = audit.findings.filter(pl.col("verdict") == Verdict.FAIL.value)
    doubt = audit.findings.filter(pl.col("verdict") == Verdict.INCONCLUSIVE.value)
    counts = ", ".join(f"{audit.counts[severity]} {severity}" for severity in reversed(SEVERITIES))
    lines = [
        f"# Audit of {_cell(Path(audit.log.path).name)}: {audit.verdict.value}",
        "",
        f"Findings: {counts}; {doubt.height} inconclusive. Judged: {judged_share(audit)}.",
        *_certificates(audit),
        *_against(audit),
    ]
    first = audit.log.states["time_ns"].min()
    start = first if isinstance(first, int) else 0
    for title, rows in (("Findings", found), ("In doubt", doubt)):
        if rows.is_empty():
            continue
        lines += [
            "",
            f"## {title}",
            "",
            "| severity | rule | vehicles | at s | value | threshold | source | detail |",
        ]
        lines.append("|---|---|---|---|---|---|---|---|")
        lines += [_line(row, start) for row in worst_first(rows).head(_LISTED).iter_rows(named=True)]
        if rows.height > _LISTED:
            lines += ["", f"{rows.height - _LISTED} more are in the tables."]
    return "\n".join(lines) + "\n"


def judged_share(audit: Audit) -> str:
    """How much was judged, in words."""
    applicable = audit.coverage.filter(pl.col("verdict") != Verdict.NOT_APPLICABLE.value)
    judged, recorded = (float(applicable[name].sum()) for name in ("judged_s", "recorded_s"))
    share = f"{100.0 * judged / recorded:.0f} %" if recorded else "nothing"
    return f"{share} of what the rules apply to"


def _certificates(audit: Audit) -> list[str]:
    if audit.certificates.is_empty():
        return ["", "No plan was certified: there is none."] if audit.of_result else []
    lines = ["", "## Plans, certified anew", "", "| window | check | verdict | margin | detail |"]
    lines.append("|---|---|---|---|---|")
    for row in audit.certificates.head(_LISTED).iter_rows(named=True):
        margin = "" if row["margin"] is None else f"{row['margin']:.4g} {row['unit']}"
        lines.append(
            f"| {row['window']} | {row['check']} | {row['verdict']} | {margin} | {_cell(row['detail'])} |"
        )
    rest = audit.certificates.height - _LISTED
    if rest > 0:
        lines += ["", f"{rest} more are in the tables."]
    return lines


def _against(audit: Audit) -> list[str]:
    if audit.against_plan.is_empty():
        return []
    lines = [
        "",
        "## Recorded against planned",
        "",
        "A counterfactual estimate: nobody drove the plan.",
        "",
        "| window | vehicle | out of its corridor | deviation m | delay s |",
        "|---|---|---|---|---|",
    ]
    for row in audit.against_plan.head(_LISTED).iter_rows(named=True):
        out = "never"
        if row["first_exit_ns"] is not None:
            after = (row["first_exit_ns"] - row["start_ns"]) / NS_PER_S
            out = f"from {after:.2f} s on, {row['deepest_m']:.2f} m deep"
        elif row["deepest_m"] is None:
            out = "not judged"
        figures = (_number(row["deviation_most_m"]), _number(row["delay_end_s"]))
        lines.append(f"| {row['window']} | {_cell(row['vehicle_id'])} | {out} | {' | '.join(figures)} |")
    return lines


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _line(row: dict[str, Any], start_ns: int) -> str:
    at = (row["worst_ns"] - start_ns) / NS_PER_S
    cells = [
        row["severity"] or "-",
        row["rule"],
        " ".join(_cell(name) for name in row["vehicles"][:5]) + (" ..." if len(row["vehicles"]) > 5 else ""),
        f"{at:.2f}",
        f"{row['value']:.3g} {row['unit']}",
        f"{row['threshold']:.3g}",
        _cell(row["threshold_source"]),
        _cell(row["detail"]),
    ]
    return "| " + " | ".join(cells) + " |"


def _cell(text: str) -> str:
    """Text of a log as one cell of a table, without markup."""
    one_line = "".join(character if character.isprintable() else " " for character in text)
    return re.sub(r"([\\`*_{}\[\]<>()#+!|&~$-])", r"\\\1", one_line[:200])
