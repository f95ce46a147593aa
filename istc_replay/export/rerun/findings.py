"""The audit's findings in the Rerun view: lines of the log, marks at their places, a list."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import polars as pl
import rerun as rr
from rerun.chunk import Chunk

from istc_replay.export.colours import LANE, Colour
from istc_replay.export.rerun.cast import SEVERITIES
from istc_replay.export.rerun.chunks import at_height, each, entity, label, same, shown, ui_radius
from istc_replay.export.rerun.markdown import escaped, number, table
from istc_replay.export.rerun.spans import Span
from istc_replay.export.rerun.stage import Stage

_LEVELS = {"critical": "CRITICAL", "serious": "ERROR", "minor": "WARN"}
_COLOURS: dict[str, Colour] = {"critical": (220, 50, 40), "serious": (230, 110, 20), "minor": (190, 150, 20)}
#: Of more findings the worst are shown.
_LINES, _MARKS, _LISTED = 10_000, 300, 12
#: A mark is seen for so long at least.
_SHORTEST_NS = 500_000_000


def worst_first(findings: pl.DataFrame) -> pl.DataFrame:
    """Findings by severity, then by the time when they are worst."""
    rank = pl.col("severity").replace_strict(
        {severity: rank for rank, severity in enumerate(SEVERITIES)}, default=len(SEVERITIES)
    )
    return findings.sort(rank, "worst_ns", "finding_id", maintain_order=True)


def findings_lines(stage: Stage) -> Iterator[tuple[int, str, str, str]]:
    """Lines of the log: instant [ns], kind, level and text."""
    low, high = stage.limits_ns
    findings = worst_first(stage.result.findings)
    own = findings.head(_LINES).filter((pl.col("worst_ns") >= low) & (pl.col("worst_ns") < high))
    for row in own.iter_rows(named=True):
        seconds = (row["end_ns"] - row["start_ns"]) / 1e9
        lasting = f" for {seconds:.1f} s" if seconds > 0.0 else ""
        text = f"{_headline(row)}{lasting}, id {row['finding_id']}" + _after(row["detail"])
        yield row["worst_ns"], "findings", _LEVELS.get(row["severity"] or "", "INFO"), text
    if findings.height > _LINES and stage.anchor.from_ns is None:
        text = f"{findings.height - _LINES} more findings: istc-replay audit tells all of them"
        yield stage.clock.origin_ns, "findings", "WARN", text


def _headline(row: dict[str, Any]) -> str:
    who = " and ".join(label(vehicle_id) for vehicle_id in row["vehicles"] or [])
    value = number(row["value"], ".3g", f" {row['unit']}" if row["unit"] else "")
    limit = number(row["threshold"], ".3g")
    return f"{row['severity'] or row['verdict']}: {row['rule']} {value} (limit {limit}): {who}"


def _after(detail: str | None) -> str:
    return f": {detail}" if detail else ""


def finding_chunks(stage: Stage) -> list[Chunk]:
    """Marks where findings are worst: on the present plane while they last, and in (x, y, t).

    One mark tells of all findings of the same vehicles in a row. Minor ones are quiet.
    """
    chunks: list[Chunk] = []
    for row, more in _marks(stage.result.findings):
        if not stage.in_part(np.array([row["start_ns"]]))[0]:
            continue
        point = at_height([[row["x_m"] - stage.origin_m[0], row["y_m"] - stage.origin_m[1]]], 0.0)
        colour = _COLOURS.get(row["severity"] or "", LANE)
        place = ("shared",) if row["severity"] in ("critical", "serious") else ("quiet",)
        ring = same(rr.Points3D, colors=(*colour, 160), radii=ui_radius(8.0))
        told = f"{row['severity'] or row['verdict']}: {label(row['rule'])}" + (f" + {more}" if more else "")
        path = entity("now", *place, "findings", label(row["finding_id"]))
        times = ([row["start_ns"]], [max(row["end_ns"], row["start_ns"] + _SHORTEST_NS)])
        words = same(rr.Points3D, labels=told)
        chunks += shown(stage.clock, path, *times, each(rr.Points3D, positions=point), ring, words)
        span = next((s for s in stage.spans if s.start_ns <= row["worst_ns"] <= s.shown_end_ns), None)
        if span is not None:
            lifted = point + np.array([0.0, 0.0, float(stage.height_m(span, row["worst_ns"]))])
            path = entity("space_time", *place, "findings", label(row["finding_id"]))
            rows = each(rr.Points3D, positions=lifted)
            chunks += shown(stage.clock, path, *stage.overview([span]), rows, ring)
    return chunks


def _marks(findings: pl.DataFrame) -> list[tuple[dict[str, Any], int]]:
    """The worst finding of each row of findings of the same vehicles, and how many more there are."""
    placed = worst_first(findings.filter(pl.col("x_m").is_finite() & pl.col("y_m").is_finite()))
    marks: dict[tuple[str, ...], list[tuple[dict[str, Any], int]]] = {}
    for row in placed.head(_LINES).iter_rows(named=True):
        own = marks.setdefault(tuple(sorted(row["vehicles"] or ())), [])
        for place, (worst, more) in enumerate(own):
            if row["start_ns"] <= worst["end_ns"] and row["end_ns"] >= worst["start_ns"]:
                own[place] = worst, more + 1
                break
        else:
            own.append((row, 0))
    return [mark for own in marks.values() for mark in own][:_MARKS]


def findings_text(stage: Stage, span: Span) -> str:
    """The worst findings of a window as Markdown; nothing where there are none."""
    during = (pl.col("start_ns") <= span.end_ns) & (pl.col("end_ns") >= span.start_ns)
    own = worst_first(stage.result.findings.filter(during))
    if not own.height:
        return ""
    rows = [
        (
            f"**{escaped(row['severity'] or row['verdict'])}**",
            escaped(row["rule"]),
            ", ".join(escaped(label(vehicle_id)) for vehicle_id in row["vehicles"] or []),
            number(row["value"], ".3g", f" {escaped(row['unit'])}"),
            f"{(row['worst_ns'] - stage.clock.origin_ns) / 1e9:.1f} s",
        )
        for row in own.head(_LISTED).iter_rows(named=True)
    ]
    if own.height > _LISTED:
        rows.append((f"and {own.height - _LISTED} more", "in *events*", "", "", ""))
    return "### Findings, as recorded\n\n" + table(("severity", "rule", "who", "value", "at"), rows)
