"""What the command line tells: lines of text made of plain values, each safe to print."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    import polars as pl

    from istc_replay.datatypes import Log
    from istc_replay.pipeline.convert import Converted
    from istc_replay.pipeline.copying import Copied

_LINE_LIMIT = 2000
#: Rows of a table for people.
_LISTED = 50


def line(text: object) -> str:
    """One printable line: control characters and line breaks shown, not obeyed."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(text))
    return shown if len(shown) <= _LINE_LIMIT else shown[:_LINE_LIMIT] + " ..."


def run_lines(summary: Mapping[str, Any], folder: Path) -> Iterator[str]:
    """Tell what a replay found, window by window."""
    totals, source = summary["totals"], summary["input"]
    name = line(source["path"])
    yield (
        f"{name}: {totals['vehicles_certified']} of {totals['vehicles_plannable']} plannable "
        f"vehicles certified ({totals['vehicles_present']} present), "
        f"{totals['windows_full']} of {totals['windows']} windows in full"
    )
    for problem in source["problems"]:
        yield f"  log: {line(problem['code'])}: {line(problem['detail'])}"
    for window in summary["windows"]:
        yield from _window_lines(window)
    audit = summary.get("audit")
    if audit is not None and "reason" in audit:
        yield f"  recorded behaviour: not judged: {line(audit['reason'])}"
    elif audit is not None:
        counts = ", ".join(f"{count} {severity}" for severity, count in reversed(audit["counts"].items()))
        yield f"  recorded behaviour: {counts} findings; {audit['inconclusive']} in doubt"
    total_s = sum(summary["stages"].values())
    yield f"  {total_s:.1f} s; results in {line(folder)}"


def _window_lines(window: Mapping[str, Any]) -> Iterator[str]:
    corridors = window["corridors"]
    reason = f": {line(window['reason'])}" if window["reason"] else ""
    yield f"  window {window['index']}: {window['status']}{reason}"
    if corridors["objective"] is not None:
        bound = "none" if corridors["bound"] is None else f"{corridors['bound']:.4f}"
        gap = "not known" if corridors["gap"] is None else f"{corridors['gap']:.1e}"
        yield (
            f"    corridors {corridors['status']}: objective {corridors['objective']:.4f}, bound {bound}, "
            f"gap {gap}, found by {corridors['found_by']}"
        )
    for exclusion in window["exclusions"]:
        yield f"    left out: {line(exclusion['vehicle_id'])}: {line(exclusion['detail'])}"
    recorded = window["recorded"]
    if recorded is not None:
        pair = " and ".join(line(vehicle) for vehicle in recorded["pair"])
        least = recorded["min_separation_m"]
        what = f"overlap by {-least:.2f} m" if least < 0 else f"come within {least:.2f} m"
        yield f"    recorded: {pair} {what} at {recorded['time_s']:.1f} s"
    for check in window["certificate"]["checks"]:
        margin = "" if check["margin"] is None else f" {check['margin']:.4g} {check['unit']}"
        yield f"    {check['check']:<22}{check['verdict']:<15}{margin}"


def log_facts(log: Log) -> dict[str, Any]:
    """What a log holds, as `info --json` tells it."""
    return {
        "path": log.path,
        "complete": log.complete,
        "messages": log.messages,
        "attachments": log.attachments,
        "metadata": log.metadata,
        "chunks": log.chunks,
        "start_ns": log.start_ns,
        "end_ns": log.end_ns,
        "time_source": log.time_source,
        "channels": [
            {
                "topic": c.topic,
                "schema": c.schema,
                "schema_encoding": c.schema_encoding,
                "message_encoding": c.message_encoding,
                "messages": c.messages,
                "understood_as": c.understood_as,
                "reason": c.reason,
                "first_ns": c.first_ns,
                "last_ns": c.last_ns,
                "rate_hz": _rate_hz(c.messages, c.first_ns, c.last_ns),
            }
            for c in log.channels
        ],
        "vehicles": _vehicles(log.states),
        "road": {
            "lanes": len(log.scene.lane_lines),
            "lanes_with_edges": sum(line.left_m is not None for line in log.scene.lane_lines),
            "edges": len(log.scene.road_edges),
            "areas": len(log.scene.road_areas),
        },
        "problems": [{"code": p.code, "detail": p.detail, "offset": p.offset} for p in log.problems],
    }


def _rate_hz(count: int, first_ns: int | None, last_ns: int | None) -> float | None:
    if first_ns is None or last_ns is None or last_ns <= first_ns or count < 2:
        return None
    return (count - 1) * 1e9 / (last_ns - first_ns)


def _vehicles(states: pl.DataFrame) -> list[dict[str, Any]]:
    """Facts of every vehicle; a gap is a step longer than 1.5 times the vehicle's median step."""
    import polars as pl

    step = pl.col("time_ns").diff().over("vehicle_id")
    usual = pl.col("step_ns").median().over("vehicle_id")
    derived = (("heading", 1), ("speed", 2), ("acceleration", 4))
    return (
        states.with_columns(step_ns=step)
        .with_columns(gap=pl.col("step_ns") > 1.5 * usual)
        .group_by("vehicle_id")
        .agg(
            pl.len().alias("states"),
            pl.col("time_ns").min().alias("first_ns"),
            pl.col("time_ns").max().alias("last_ns"),
            pl.col("length_m").drop_nulls().first(),
            pl.col("width_m").drop_nulls().first(),
            pl.col("role").drop_nulls().first(),
            (1e9 / pl.col("step_ns").filter(pl.col("step_ns") > 0).median()).alias("rate_hz"),
            pl.col("gap").sum().alias("gaps"),
            (pl.col("step_ns").max() / 1e9).alias("longest_step_s"),
            pl.col("topic").unique().sort().alias("topics"),
            *(((pl.col("derived") & bit) > 0).any().alias(f"derived_{name}") for name, bit in derived),
        )
        .sort("vehicle_id")
        .with_columns(
            pl.concat_list(pl.when(pl.col(f"derived_{name}")).then(pl.lit(name)) for name, _ in derived)
            .list.drop_nulls()
            .alias("derived")
        )
        .drop(f"derived_{name}" for name, _ in derived)
        .rename({"vehicle_id": "id"})
        .to_dicts()
    )


def json_lines(facts: Mapping[str, Any]) -> Iterator[str]:
    """Facts as JSON, an entry of a list a line: as fast as it can be written, and still for people."""
    yield "{"
    for place, (key, value) in enumerate(facts.items()):
        comma = "," if place < len(facts) - 1 else ""
        if isinstance(value, list) and value:
            encode = json.JSONEncoder().encode
            yield f' "{key}": ['
            yield from (f"  {encode(item)}," for item in value[:-1])
            yield f"  {encode(value[-1])}"
            yield f" ]{comma}"
        else:
            yield f' "{key}": {json.dumps(value)}{comma}'
    yield "}"


def info_lines(facts: Mapping[str, Any]) -> Iterator[str]:
    """Tell what a log holds."""
    whole = "complete" if facts["complete"] else "INCOMPLETE"
    yield f"{line(facts['path'])}: {whole}, {facts['messages']} messages in {facts['chunks']} chunks"
    if facts["start_ns"] is not None:
        span_s = (facts["end_ns"] - facts["start_ns"]) / 1e9
        yield f"span: {span_s:.3f} s from {facts['start_ns']} ns; times of states: {facts['time_source']}"
    yield from _channel_lines(facts["channels"])
    yield from _vehicle_lines(facts["vehicles"])
    road = facts["road"]
    if any(road.values()):
        yield (
            f"road: {road['lanes']} lanes, {road['lanes_with_edges']} with both edges; "
            f"{road['edges']} road edges, {road['areas']} areas"
        )
    for problem in facts["problems"]:
        where = "" if problem["offset"] is None else f" at byte {problem['offset']}"
        yield f"problem: {line(problem['code'])}{where}: {line(problem['detail'])}"


def _channel_lines(channels: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    rows = [["topic", "schema", "encoding", "messages", "rate Hz", "read as"]]
    for c in channels[:_LISTED]:
        kind = c["understood_as"] or f"not read: {c['reason'] or 'no reason'}"
        if c["understood_as"] and c["reason"]:
            kind += f", not used: {c['reason']}"
        rows.append(
            [
                c["topic"],
                c["schema"],
                c["message_encoding"],
                str(c["messages"]),
                _number(c["rate_hz"], 1),
                kind,
            ]
        )
    yield from table_lines(rows, "<<<>>")
    if len(channels) > _LISTED:
        yield f"  and {len(channels) - _LISTED} channels more; --json lists all"


def _vehicle_lines(vehicles: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    if not vehicles:
        return
    begin_ns = min(v["first_ns"] for v in vehicles)
    head = ("vehicle", "role", "states", "from s", "to s", "rate Hz", "gaps", "longest s")
    rows = [[*head, "length m", "width m", "derived", "topics"]]
    for v in vehicles[:_LISTED]:
        span = [f"{(v[key] - begin_ns) / 1e9:.3f}" for key in ("first_ns", "last_ns")]
        topics = v["topics"][0] + (f" and {len(v['topics']) - 1} more" if len(v["topics"]) > 1 else "")
        steps = [_number(v["rate_hz"], 1), str(v["gaps"]), _number(v["longest_step_s"], 3)]
        size = [_number(v["length_m"], 2), _number(v["width_m"], 2)]
        told = [v["id"], v["role"] or "", str(v["states"])]
        rows.append([*told, *span, *steps, *size, ", ".join(v["derived"]), topics])
    yield from table_lines(rows, "<<>>>>>>>><<")
    if len(vehicles) > _LISTED:
        yield f"  and {len(vehicles) - _LISTED} vehicles more; --json lists all"


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def copied_lines(copied: Copied) -> Iterator[str]:
    """Tell what a copy holds, and what of its inputs was lost."""
    private = f", {copied.private} private records" if copied.private else ""
    yield (
        f"{line(copied.path)}: {copied.messages} messages on {copied.channels} channels, "
        f"{copied.attachments} attachments, {copied.metadata} metadata records{private}"
    )
    for note in copied.notes:
        yield f"  {line(note)}"
    for name, problem in copied.problems:
        where = "" if problem.offset is None else f" at byte {problem.offset}"
        yield f"  {line(name)}: {line(problem.code)}{where}: {line(problem.detail)}"


def converted_lines(done: Converted) -> Iterator[str]:
    """Tell what was converted."""
    standing = f", {done.obstacles} standing obstacles" if done.obstacles else ""
    lanes = f", {done.lanes} lanes" if done.lanes else ""
    yield (
        f"{line(done.path)}: {done.states} states of {done.vehicles} road users over {done.span_s:.3f} s"
        f"{standing}{lanes}, from {done.kind}"
    )
    for note in done.notes:
        yield f"  {line(note)}"
    for problem in done.problems:
        yield f"  {line(problem.code)}: {line(problem.detail)}"


def table_lines(rows: Sequence[Sequence[str]], sides: str = "") -> Iterator[str]:
    """Lay out rows of cells as columns; a table without rows but its head is left out.

    `sides` has `>` for each column whose cells stand on the right.
    """
    if len(rows) == 1:
        return
    shown = [[line(cell)[:60] for cell in row[:-1]] + [line(row[-1])[:200]] for row in rows]
    widths = [max(len(row[column]) for row in shown) for column in range(len(shown[0]))]
    for row in shown:
        cells = [
            cell.rjust(width) if sides[place : place + 1] == ">" else cell.ljust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield ("  " + "  ".join(cells)).rstrip()


def robustness_lines(found: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Tell how many perturbed copies of each scene were certified and arrived."""
    for scene in found:
        good, count = scene["certified_and_arrived"], scene["perturbed"]
        yield f"{scene['name']}: {good} of {count} perturbed copies certified and arrived"
        for miss in scene["misses"]:
            status = miss["status"].replace("_", " ")
            yield f"  seed {miss['seed']}: {status}: {line(miss['reason'])}"
