"""The log of events of the Rerun view: what happened when, each line leading to its instant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import polars as pl
import rerun as rr
from rerun.chunk import Chunk

from istc_replay.datatypes import SOUND
from istc_replay.export.rerun.chunks import FOREVER_NS, each, entity, label, shown
from istc_replay.export.rerun.clearance import Clearance
from istc_replay.export.rerun.findings import findings_lines
from istc_replay.export.rerun.markdown import ROWS, cut
from istc_replay.export.rerun.plots import manoeuvres
from istc_replay.export.rerun.spans import Span
from istc_replay.export.rerun.stage import Stage

_LEVELS = {
    "INFO": rr.TextLogLevel.INFO,
    "WARN": rr.TextLogLevel.WARN,
    "ERROR": rr.TextLogLevel.ERROR,
    "CRITICAL": rr.TextLogLevel.CRITICAL,
}


@dataclass(frozen=True, slots=True, order=True)
class Event:
    """Something that happened at an instant; `kind` is the last part of its entity."""

    time_ns: int
    kind: str
    level: str
    text: str


def all_events(stage: Stage, found: list[Clearance]) -> list[Event]:
    """Everything that happened, in order of time; its texts are ready to be shown."""
    events = {*_input_events(stage), *_gap_events(stage, found), *_yield_events(stage), *_check_events(stage)}
    for span in stage.spans:
        events |= set(_window_events(span))
    events |= {Event(*parts) for parts in findings_lines(stage)}
    return sorted(replace(event, text=cut(event.text)) for event in events)


def arrivals(stage: Stage) -> list[Event]:
    """When each vehicle of the whole result comes, for how long, and whose entities it has."""
    low, high = stage.limits_ns
    events = []
    for vehicle_id, (first, last) in stage.presence.items():
        if low <= first < high:
            where = f", in {stage.slots[vehicle_id]}" if stage.slots else ""
            text = f"vehicle {label(vehicle_id)} is shown for {(last - first) / 1e9:.1f} s{where}"
            events.append(Event(first, "vehicles", "INFO", text))
    return sorted(events)


def event_chunks(stage: Stage, found: list[Clearance]) -> list[Chunk]:
    """Chunks under `/events`, one entity a kind, and `/vehicles`, where each line leads to a vehicle."""
    events = all_events(stage, found)
    chunks = _lines(stage, entity("vehicles"), arrivals(stage))
    for kind in sorted({event.kind for event in events}):
        chunks += _lines(stage, entity("events", kind), [event for event in events if event.kind == kind])
    return chunks


def _lines(stage: Stage, path: str, events: list[Event]) -> list[Chunk]:
    return shown(
        stage.clock,
        path,
        [event.time_ns for event in events],
        [FOREVER_NS] * len(events),
        each(rr.TextLog, text=[e.text for e in events], level=[_LEVELS[e.level] for e in events]),
        row_bytes=300.0,
    )


def _input_events(stage: Stage) -> list[Event]:
    problems = stage.result.summary["input"].get("problems", []) if stage.anchor.from_ns is None else []
    start = stage.clock.origin_ns
    events = [Event(start, "log", "WARN", f"log: {p['code']}: {p['detail']}") for p in problems[:ROWS]]
    if len(problems) > ROWS:
        events.append(Event(start, "log", "WARN", f"log: {len(problems) - ROWS} more problems"))
    return events


def _window_events(span: Span) -> list[Event]:
    w, start = span.summary, span.start_ns
    solved = w["status"] in SOUND or w["status"] == "not_certified"
    level = (
        "INFO" if w["status"] == "certified" else "WARN" if solved or not w["vehicles_plannable"] else "ERROR"
    )
    text = (
        f"window {span.index}: {w['status'].replace('_', ' ')}, {w['vehicles_certified']} of "
        f"{w['vehicles_plannable']} plannable vehicles certified"
        + (f": {w['reason']}" if w["reason"] else "")
    )
    events = [Event(start, "windows", level, text)]
    for e in w.get("frozen", [])[:ROWS]:
        text = f"vehicle {label(e['vehicle_id'])} stays as recorded: {e['reason']}: {e['detail']}"
        events.append(Event(start, "frozen", "WARN", text))
    for e in w["exclusions"][:ROWS]:
        text = f"vehicle {label(e['vehicle_id'])} is not planned: {e['reason']}: {e['detail']}"
        events.append(Event(start, "excluded", "WARN", text))
    for u in w["undrivable"][:ROWS]:
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
