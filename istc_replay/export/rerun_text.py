"""The words of the Rerun view: the report beside the scene, and the log of events.

Identifiers, paths and details come from logs: in the report every character that Markdown or
HTML could read as markup is escaped, and long words are cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
import rerun as rr
from rerun.chunk import Chunk

from istc_replay.export.rerun_chunks import FOREVER_NS, each, entity, label, plain, same, shown
from istc_replay.export.rerun_clearance import HORIZON_M, Clearance, least_by_vehicle
from istc_replay.export.rerun_plots import manoeuvres
from istc_replay.export.rerun_stage import Span, Stage

_MARKUP = str.maketrans({c: f"\\{c}" for c in "\\`*_{}[]()<>#+-.!|~&$^=:\"'/"})
_LONGEST = 200
_ROWS = 60
_LEVELS = {"INFO": rr.TextLogLevel.INFO, "WARN": rr.TextLogLevel.WARN, "ERROR": rr.TextLogLevel.ERROR}


# --- the report ------------------------------------------------------------------------------


def report_chunks(stage: Stage, found: list[Clearance]) -> list[Chunk]:
    """The report: one document a window, shown while its window is."""
    documents = [_document(stage, span, found) for span in stage.spans] or [_source(stage)]
    tracks = stage.recorded.values()
    first = min([stage.clock.origin_ns, *(int(track.times_ns[0]) for track in tracks)])
    times = [first, *(span.start_ns for span in stage.spans[1:])]
    return shown(
        stage.clock,
        entity("report"),
        times,
        [FOREVER_NS] * len(times),
        each(rr.TextDocument, text=documents),
        same(rr.TextDocument, media_type="text/markdown"),
        row_bytes=float(np.mean([len(text.encode()) for text in documents])),
    )


def escaped(text: object) -> str:
    """Untrusted text as Markdown that shows just these characters, on one line."""
    line = plain(text)
    if len(line) > _LONGEST:
        line = line[: _LONGEST - 1] + "\N{HORIZONTAL ELLIPSIS}"
    return line.translate(_MARKUP)


def _document(stage: Stage, span: Span, found: list[Clearance]) -> str:
    parts = [_verdict(stage, span), _vehicles(stage, span, found), _clearance_lines(stage, span, found)]
    parts += [_exclusions(span), _checks(stage, span), _solves(stage, span), _source(stage)]
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
    head = ("vehicle", "priority", "corridor", "clearance", "recorded", "speed sd", "solve")
    rows = []
    for vehicle in span.summary["vehicles"]:
        name, solve = vehicle["id"], by_vehicle.get(vehicle["id"], {})
        rows.append(
            (
                escaped(stage.names.get(name) or label(name)),
                _number(vehicle.get("priority"), ".2f"),
                _number(vehicle.get("corridor_area_m2"), ".0f", " m²"),
                _gap(gaps["planned"], name) if (span.index, name) in stage.planned else "\N{EN DASH}",
                _gap(gaps["recorded"], name),
                _number(vehicle.get("speed_std_mps"), ".2f", " m/s"),
                _solve(solve),
            )
        )
    return _table(head, rows)


def _solve(row: dict[str, Any]) -> str:
    if not row:
        return "\N{EN DASH}"
    if row.get("wall_s") is not None:
        return _number(row["wall_s"], ".2f", " s")
    return f"{escaped(row['status'])}, {_number(row.get('iterations'), 'd', ' it')}"


def _gap(gaps: dict[str, float], vehicle_id: str) -> str:
    return f"{gaps[vehicle_id]:.2f} m" if vehicle_id in gaps else f"> {HORIZON_M:g} m"


def _exclusions(span: Span) -> str:
    rows = [
        (escaped(label(e["vehicle_id"])), escaped(f"{e['reason']}: {e['detail']}"))
        for e in (*span.summary.get("frozen", []), *span.summary["exclusions"])
    ]
    return "### Not planned\n\n" + _table(("vehicle", "why"), rows) if rows else ""


def _checks(stage: Stage, span: Span) -> str:
    table = stage.result.certificates.filter(pl.col("window") == span.index)
    rows = []
    for row in table.iter_rows(named=True):
        at = "" if row["time_ns"] is None else f"{(row['time_ns'] - stage.clock.origin_ns) / 1e9:.1f} s"
        who = ", ".join(escaped(label(vehicle_id)) for vehicle_id in row["vehicles"] or [])
        verdict = escaped(row["verdict"].replace("_", " "))
        rows.append(
            (
                escaped(row["check"]),
                verdict if row["verdict"] in ("pass", "not_applicable") else f"**{verdict}**",
                _number(row["margin"], ".3g", f" {escaped(row['unit'])}"),
                ", ".join(part for part in (at, who) if part),
            )
        )
    return "### Certificate\n\n" + _table(("check", "verdict", "margin", "least at"), rows) if rows else ""


def _solves(stage: Stage, span: Span) -> str:
    table = stage.result.solves.filter(pl.col("window") == span.index, pl.col("layer") == "corridors")
    rows = [
        (
            escaped(row["stage"]),
            escaped(row["solver"]),
            escaped(row["status"]),
            _number(row["objective"], ".4g"),
            _number(row["gap"], ".1e"),
            _number(row["nodes"], "d"),
            _number(row["binaries"], "d"),
        )
        for row in table.iter_rows(named=True)
    ]
    head = ("stage", "solver", "status", "objective", "gap", "nodes", "binaries")
    return "### Corridors, solver\n\n" + _table(head, rows) if rows else ""


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "\N{EN DASH}" if value is None else f"{value:{form}}{unit}"


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows[:_ROWS]]
    if len(rows) > _ROWS:
        lines.append((f"and {len(rows) - _ROWS} more", *("",) * (len(head) - 1)))
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


# --- events ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, order=True)
class Event:
    """Something that happened at an instant; `kind` is the last part of its entity."""

    time_ns: int
    kind: str
    level: str
    text: str


def event_chunks(stage: Stage, found: list[Clearance]) -> list[Chunk]:
    """Chunks under `/events`, one entity a kind."""
    events = sorted(
        {*_input_events(stage), *_gap_events(stage, found), *_yield_events(stage), *_check_events(stage)}
    )
    for span in stage.spans:
        events += _window_events(span)
    chunks = []
    for kind in sorted({event.kind for event in events}):
        own = sorted(event for event in events if event.kind == kind)
        chunks += shown(
            stage.clock,
            entity("events", kind),
            [event.time_ns for event in own],
            [FOREVER_NS] * len(own),
            each(rr.TextLog, text=[_cut(e.text) for e in own], level=[_LEVELS[e.level] for e in own]),
            row_bytes=300.0,
        )
    return chunks


def _cut(text: str) -> str:
    line = plain(text)
    return line if len(line) <= 2 * _LONGEST else line[: 2 * _LONGEST] + "\N{HORIZONTAL ELLIPSIS}"


def _input_events(stage: Stage) -> list[Event]:
    problems = stage.result.summary["input"].get("problems", [])
    start = stage.clock.origin_ns
    events = [Event(start, "log", "WARN", f"log: {p['code']}: {p['detail']}") for p in problems[:_ROWS]]
    if len(problems) > _ROWS:
        events.append(Event(start, "log", "WARN", f"log: {len(problems) - _ROWS} more problems"))
    return events


def _window_events(span: Span) -> list[Event]:
    w, start = span.summary, span.start_ns
    solved = w["status"] in ("certified", "partial", "not_certified")
    level = (
        "INFO" if w["status"] == "certified" else "WARN" if solved or not w["vehicles_plannable"] else "ERROR"
    )
    text = (
        f"window {span.index}: {w['status'].replace('_', ' ')}, {w['vehicles_certified']} of "
        f"{w['vehicles_plannable']} plannable vehicles certified"
        + (f": {w['reason']}" if w["reason"] else "")
    )
    events = [Event(start, "windows", level, text)]
    for e in w.get("frozen", [])[:_ROWS]:
        text = f"vehicle {label(e['vehicle_id'])} stays as recorded: {e['reason']}: {e['detail']}"
        events.append(Event(start, "frozen", "WARN", text))
    for e in w["exclusions"][:_ROWS]:
        text = f"vehicle {label(e['vehicle_id'])} is not planned: {e['reason']}: {e['detail']}"
        events.append(Event(start, "excluded", "WARN", text))
    for u in w["undrivable"][:_ROWS]:
        at = start + u["unit"] * (span.end_ns - start) // span.units
        text = f"vehicle {label(u['vehicle_id'])} cannot be driven in unit {u['unit']}: {u['detail']}"
        events.append(Event(at, "undrivable", "ERROR", text))
    return events


def _gap_events(stage: Stage, found: list[Clearance]) -> list[Event]:
    events = []
    for clearance in found:
        pair = " and ".join(stage.names[vehicle_id] for vehicle_id in clearance.pair)
        for first, last, least in clearance.overlaps():
            while_s = f"for {(last - first) / 1e9:.1f} s" if last > first else "for an instant"
            text = f"{clearance.source}: vehicles {pair} overlap {while_s}, by {-least:.2f} m at most"
            events.append(Event(first, "overlaps", "ERROR", text))
    return events


def _yield_events(stage: Stage) -> list[Event]:
    verbs = {"yield": "yields", "stop": "stops"}
    return [
        Event(
            start,
            "manoeuvres",
            "INFO",
            f"vehicle {stage.names[vehicle_id]} {verbs[state]} for {(end - start) / 1e9:.1f} s",
        )
        for vehicle_id in stage.vehicle_ids
        for start, end, state in manoeuvres(stage, vehicle_id)
        if state in verbs
    ]


def _check_events(stage: Stage) -> list[Event]:
    starts = {span.index: span.start_ns for span in stage.spans}
    events = []
    failed = stage.result.certificates.filter(pl.col("verdict").is_in(["fail", "inconclusive"]))
    for row in failed.iter_rows(named=True):
        who = ", ".join(label(vehicle_id) for vehicle_id in row["vehicles"] or [])
        margin = "" if row["margin"] is None else f", margin {row['margin']:.3g} {row['unit']}"
        text = f"certificate: {row['check']} {row['verdict']}{margin}: {who} {row['detail']}"
        at = (
            row["time_ns"] if row["time_ns"] is not None else starts.get(row["window"], stage.clock.origin_ns)
        )
        events.append(Event(at, "certificates", "ERROR" if row["verdict"] == "fail" else "WARN", text))
    return events
