"""The report of the Rerun view, beside the scene."""

from __future__ import annotations

from typing import Any

import numpy as np
import polars as pl
import rerun as rr
from rerun.chunk import Chunk

from istc_replay.export.rerun.chunks import FOREVER_NS, each, entity, label, same, shown
from istc_replay.export.rerun.clearance import HORIZON_M, Clearance, least_by_vehicle
from istc_replay.export.rerun.findings import findings_text
from istc_replay.export.rerun.markdown import escaped, number, table
from istc_replay.export.rerun.spans import Span
from istc_replay.export.rerun.stage import Stage


def report_chunks(stage: Stage, found: list[Clearance]) -> list[Chunk]:
    """The report: one document a window, shown while its window is."""
    documents = [_document(stage, span, found) for span in stage.spans] or [_source(stage)]
    times = [stage.first_ns, *(span.start_ns for span in stage.spans[1:])]
    return shown(
        stage.clock,
        entity("report"),
        times,
        [FOREVER_NS] * len(times),
        each(rr.TextDocument, text=documents),
        same(rr.TextDocument, media_type="text/markdown"),
        row_bytes=float(np.mean([len(text.encode()) for text in documents])),
    )


def _document(stage: Stage, span: Span, found: list[Clearance]) -> str:
    parts = [_verdict(stage, span), _vehicles(stage, span, found), _clearance_lines(stage, span, found)]
    parts += [findings_text(stage, span), _cast(stage, span), _exclusions(span), _checks(stage, span)]
    parts += [_solves(stage, span), _source(stage)]
    return "\n\n".join(part for part in parts if part)


def _verdict(stage: Stage, span: Span) -> str:
    w = span.summary
    start_s = (span.start_ns - stage.clock.origin_ns) / 1e9
    status = escaped(w["status"].replace("_", " "))
    lines = [
        f"## Window {span.index}: {start_s:g} s to {start_s + span.duration_s:g} s",
        f"**{status}**" + (f": {escaped(w['reason'])}" if w["reason"] else ""),
        f"{w['vehicles_certified']} certified of {w['vehicles_plannable']} plannable of "
        f"{w['vehicles_present']} present vehicles",
    ]
    return lines[0] + "\n\n" + ", ".join(lines[1:]) + "."


def _clearance_lines(stage: Stage, span: Span, found: list[Clearance]) -> str:
    lines = []
    for source in ("planned", "recorded"):
        own = [c for c in found if (c.window, c.source) == (span.index, source)]
        if own:
            least = min(own, key=lambda c: (c.least_m, c.pair))
            at_s = (int(least.times_ns[int(np.nanargmin(least.gaps_m))]) - stage.clock.origin_ns) / 1e9
            pair = " and ".join(escaped(stage.names[vehicle_id]) for vehicle_id in least.pair)
            verb = "**overlap** by" if least.least_m < 0.0 else "are never closer than"
            lines.append(
                f"- As {source}, vehicles {pair} {verb} {abs(least.least_m):.2f} m (at {at_s:.1f} s)."
            )
    return "\n".join(lines)


def _cast(stage: Stage, span: Span) -> str:
    """Who is shown in full, where not everybody is."""
    if set(stage.vehicle_ids) <= stage.starring:
        return ""
    here, plotted = (
        ", ".join(escaped(label(vehicle_id)) for vehicle_id in sorted(ids, key=lambda v: (len(v), v)))
        for ids in (stage.leading[span.index], stage.starring)
    )
    rest = "under *quiet* in the views' trees" if stage.plots_all else "by `view --focus ID`"
    shared = "\n- entities: many come and go and share slots; *vehicles* tells when who is in which"
    return (
        f"### Shown in full\n\n- named and with corridors here: {here}\n- plotted: {plotted}\n"
        f"- corridors of the others: under *quiet* in the views' trees; their plots: {rest}"
        + (shared if stage.slots else "")
    )


def _source(stage: Stage) -> str:
    summary, (x, y) = stage.result.summary, stage.origin_m
    source, totals = summary["input"], summary["totals"]
    lines = [
        f"- {escaped(source['path'])}, sha256 {escaped(source['sha256'][:16])}"
        + ("" if source["complete"] else ", **incomplete**"),
        f"- {totals['windows_full']} of {totals['windows']} windows with every plannable vehicle certified",
        f"- positions are relative to x = {x:.3f} m, y = {y:.3f} m of the map",
        f"- in (x, y, t) a second is {stage.metres_per_second:g} m high",
    ]
    return "### Source\n\n" + "\n".join(lines)


def _vehicles(stage: Stage, span: Span, found: list[Clearance]) -> str:
    gaps = {source: least_by_vehicle(found, span.index, source) for source in ("planned", "recorded")}
    solves = stage.result.solves.filter(pl.col("window") == span.index, pl.col("layer") == "trajectory")
    by_vehicle = {row["vehicle_id"]: row for row in solves.iter_rows(named=True)}
    slot = ("slot",) if stage.slots else ()
    head = ("vehicle", *slot, "priority", "corridor", "clearance", "recorded", "speed sd", "solve")
    rows = []
    for vehicle in span.summary["vehicles"]:
        name, solve = vehicle["id"], by_vehicle.get(vehicle["id"], {})
        rows.append(
            (
                escaped(stage.names.get(name) or label(name)),
                *(escaped(stage.slots.get(name, "")) for _ in slot),
                number(vehicle.get("priority"), ".2f"),
                number(vehicle.get("corridor_area_m2"), ".0f", " m²"),
                _gap(gaps["planned"], name) if (span.index, name) in stage.planned else "\N{EN DASH}",
                _gap(gaps["recorded"], name),
                number(vehicle.get("speed_std_mps"), ".2f", " m/s"),
                _solve(solve),
            )
        )
    return table(head, rows)


def _solve(row: dict[str, Any]) -> str:
    if not row:
        return "\N{EN DASH}"
    if row.get("wall_s") is not None:
        return number(row["wall_s"], ".2f", " s")
    return f"{escaped(row['status'])}, {number(row.get('iterations'), 'd', ' it')}"


def _gap(gaps: dict[str, float], vehicle_id: str) -> str:
    return f"{gaps[vehicle_id]:.2f} m" if vehicle_id in gaps else f"> {HORIZON_M:g} m"


def _exclusions(span: Span) -> str:
    rows = [
        (escaped(label(e["vehicle_id"])), escaped(f"{e['reason']}: {e['detail']}"))
        for e in (*span.summary.get("frozen", []), *span.summary["exclusions"])
    ]
    return "### Not planned\n\n" + table(("vehicle", "why"), rows) if rows else ""


def _checks(stage: Stage, span: Span) -> str:
    checks = stage.result.certificates.filter(pl.col("window") == span.index)
    rows = []
    for row in checks.iter_rows(named=True):
        at = "" if row["time_ns"] is None else f"{(row['time_ns'] - stage.clock.origin_ns) / 1e9:.1f} s"
        who = ", ".join(escaped(label(vehicle_id)) for vehicle_id in row["vehicles"] or [])
        verdict = escaped(row["verdict"].replace("_", " "))
        rows.append(
            (
                escaped(row["check"]),
                verdict if row["verdict"] in ("pass", "not_applicable") else f"**{verdict}**",
                number(row["margin"], ".3g", f" {escaped(row['unit'])}"),
                ", ".join(part for part in (at, who) if part),
            )
        )
    return "### Certificate\n\n" + table(("check", "verdict", "margin", "least at"), rows) if rows else ""


def _solves(stage: Stage, span: Span) -> str:
    checks = stage.result.solves.filter(pl.col("window") == span.index, pl.col("layer") == "corridors")
    rows = [
        (
            escaped(row["stage"]),
            escaped(row["solver"]),
            escaped(row["status"]),
            number(row["objective"], ".4g"),
            number(row["gap"], ".1e"),
            number(row["nodes"], "d"),
            number(row["binaries"], "d"),
        )
        for row in checks.iter_rows(named=True)
    ]
    head = ("stage", "solver", "status", "objective", "gap", "nodes", "binaries")
    return "### Corridors, solver\n\n" + table(head, rows) if rows else ""
