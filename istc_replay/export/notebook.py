"""Results and audits as a notebook shows them: a verdict, tables, and pictures inside the page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import polars as pl

from istc_replay.comparison.difference import Comparison
from istc_replay.comparison.words import verdict
from istc_replay.datatypes import Result
from istc_replay.export.report.findings import findings_table
from istc_replay.export.report.markup import Html, element, join, name, number, table
from istc_replay.export.text import shortened, visible

if TYPE_CHECKING:
    from istc_replay.safety.log_audit import Audit

#: Windows, vehicles and findings listed; the tables hold the rest.
_WINDOWS, _VEHICLES, _FINDINGS = 12, 30, 20
_PICTURES = {
    "corridors": "Corridors of all vehicles in space and time",
    "top_down": "Trajectories from above, recorded and planned, with a tick each second",
}
_STYLE = """
.istc-replay table{border-collapse:collapse;margin:.4em 0}
.istc-replay caption{text-align:left;opacity:.75;caption-side:top}
.istc-replay th,.istc-replay td{text-align:left;padding:.15em .8em .15em 0;border:0;background:none}
.istc-replay .n{text-align:right;font-variant-numeric:tabular-nums}
.istc-replay .wide{overflow-x:auto}
.istc-replay img{max-width:100%;height:auto}
"""


def result_text(result: Result) -> str:
    """One line of a result, for consoles and for notebooks that show no HTML."""
    totals = result.summary.get("totals") or {}
    counts = [number(totals.get(f"vehicles_{which}")) for which in ("certified", "plannable", "present")]
    full, windows = number(totals.get("windows_full")), number(totals.get("windows"))
    return (
        f"Result of {_log(result)}: {counts[0]} of {counts[1]} plannable vehicles certified "
        f"({counts[2]} present), {full} of {windows} windows in full, {result.findings.height} findings"
    )


def result_html(result: Result) -> str:
    """A result's windows, vehicles and findings, with pictures of the window that came closest."""
    windows: list[dict[str, Any]] = list(result.summary.get("windows") or [])
    chosen = min(windows, key=_closeness, default=None)
    return _box(
        element("strong", result_text(result)),
        _windows(windows),
        _vehicles(chosen) if chosen else None,
        _findings(result.findings, min((int(window["start_ns"]) for window in windows), default=0)),
        _pictures(result, chosen) if chosen else None,
    )


def audit_text(audit: Audit) -> str:
    """One line of an audit."""
    counts = ", ".join(f"{count} {severity}" for severity, count in reversed(audit.counts.items()))
    log = visible(shortened(str(audit.log.path), 80))
    return f"Audit of {log}: {audit.verdict}; findings: {counts}; {audit.in_doubt} in doubt"


def audit_notebook(audit: Audit) -> str:
    """An audit's verdict, its worst findings and how much was judged."""
    judged = audit.coverage.group_by("rule", maintain_order=True).agg(pl.col("judged_s").sum())
    rows = [(name(rule), number(seconds, 1)) for rule, seconds in judged.iter_rows()]
    share = table("How much was judged, of all vehicles", ("Rule", "judged [s]"), rows, (1,))
    return _box(
        element("strong", audit_text(audit)),
        _findings(audit.findings, audit.log.start_ns or 0),
        element("details", element("summary", "How much was judged"), share) if rows else None,
    )


def comparison_notebook(comparison: Comparison) -> str:
    """What differs between two results, as tables."""
    from istc_replay.export.report.beside import differences

    return _box(element("strong", verdict(comparison)), differences(comparison, {}))


def _log(result: Result) -> str:
    path = str((result.summary.get("input") or {}).get("path", result.path))
    return visible(shortened(path, 80))


def _box(*parts: Html | None) -> str:
    return str(element("div", element("style", Html(_STYLE)), list(parts), class_="istc-replay"))


def _closeness(window: dict[str, Any]) -> float:
    gap = (window.get("recorded") or {}).get("min_separation_m")
    return float("inf") if gap is None else float(gap)


def _windows(windows: Sequence[dict[str, Any]]) -> Html:
    rows = []
    for window in windows[:_WINDOWS]:
        recorded, corridors = window.get("recorded") or {}, window.get("corridors") or {}
        rows.append(
            (
                str(window["index"]),
                name(str(window.get("status")).replace("_", " ")),
                number(window.get("vehicles_certified")),
                number(window.get("vehicles_plannable")),
                number(recorded.get("min_separation_m")),
                number(corridors.get("objective"), 3),
                number(corridors.get("gap"), 5),
            )
        )
    headings = ("Window", "status", "certified", "plannable", "recorded gap [m]", "objective", "gap")
    more = f"; {len(windows) - _WINDOWS} more are in .summary" if len(windows) > _WINDOWS else ""
    return table(f"Windows{more}", headings, rows, (2, 3, 4, 5, 6))


def _vehicles(window: dict[str, Any]) -> Html | None:
    vehicles = window.get("vehicles") or []
    rows = [
        (
            name(vehicle.get("id")),
            number(vehicle.get("priority")),
            number(vehicle.get("corridor_area_m2"), 1),
            number(vehicle.get("pivot_deviation_m")),
            number(vehicle.get("speed_std_mps")),
            number(vehicle.get("length_m"), 1),
        )
        for vehicle in vehicles[:_VEHICLES]
    ]
    headings = ("Vehicle", "priority η", "corridor [m²]", "deviation [m]", "speed σ [m/s]", "path [m]")
    return table(f"Vehicles of window {window['index']}", headings, rows, (1, 2, 3, 4, 5)) if rows else None


def _findings(findings: pl.DataFrame, start_ns: int) -> Html:
    if findings.is_empty():
        return element("p", "No findings.")
    caption = "Findings in what was recorded, worst first; times are from the start"
    return findings_table(findings, start_ns, caption, _FINDINGS)


def _pictures(result: Result, window: dict[str, Any]) -> Html:
    from istc_replay.export.figures import draw_figures, figure_bytes

    figures = draw_figures(result, window["index"], only=_PICTURES)
    shown = []
    for kind, alternative in _PICTURES.items():
        if kind in figures:
            data = base64.b64encode(figure_bytes(figures[kind], "png")).decode()
            shown.append(element("img", src=f"data:image/png;base64,{data}", alt=alternative))
    return join(shown)
