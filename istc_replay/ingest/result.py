"""Reading a result.mcap back into tables.

A result is read whole or not at all: unlike a recorded log, nothing in it is recovered.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

import polars as pl

from istc_replay.datatypes import Result
from istc_replay.errors import LogError
from istc_replay.ingest.problems import quoted
from istc_replay.ingest.result_rows import ResultRows, Row, collect, holds_rows, holds_states
from istc_replay.ingest.walk import LogFile, open_log
from istc_replay.states import (
    CERTIFICATES_SCHEMA,
    CORRIDORS_SCHEMA,
    FINDINGS_SCHEMA,
    OBSTACLES_SCHEMA,
    RESULT_STATES_SCHEMA,
    SOLVES_SCHEMA,
)

SUMMARY_SCHEMA = "istc-replay.summary.v1"
REMEDY = "make it again with istc-replay run"
_SUMMARY_LIMIT = 2**28
#: Rows of states made a table of at a time.
_ROWS = 20_000
#: What a summary tells of one run alone.
_OF_ONE_RUN = frozenset({"seconds", "cpu_s", "wall_s", "stages", "solves"})


def read_result(source: Path | bytes, *, states: bool = True) -> Result:
    """Read a result.mcap.

    States are sorted by source (recorded, planned, rejected, guidance), window, vehicle and time. A recorded
    state belongs to the latest window that it falls into, both ends included; its window is null
    where there is none. Speeds of guidance rows are null: a guidance tells places and times.
    `solves.wall_s` is null: wall-clock times are not part of the file.

    Parameters
    ----------
    source : Path or bytes
        The file, or what it holds.
    states : bool
        Whether to read the states, which take by far the most memory; else there are none.

    Raises
    ------
    LogError
        If there is no such file, it is not a result, or anything in it is damaged.
    """
    log = open_log(source)
    rows, tables = ResultRows(), [RESULT_STATES_SCHEMA.to_frame()]
    for message in log.messages(holds_rows):
        if not states and holds_states(message.channel):
            continue
        try:
            collect(rows, message)
            if len(rows.states) >= _ROWS:
                tables.append(_table(rows.states, RESULT_STATES_SCHEMA))
                rows.states = []
        except ValueError as error:
            place = f"{quoted(message.channel.topic)}, byte {message.offset}"
            raise LogError(f"{log.name}: damaged result: {place}: {error}; {REMEDY}") from None
    _require_whole(log, rows)
    tables.append(_table(rows.states, RESULT_STATES_SCHEMA))
    windows = [dict(zip(("index", "start_ns", "end_ns"), row, strict=True)) for row in rows.windows]
    return Result(
        path=log.name,
        states=result_states(pl.concat(tables), windows),
        corridors=_table(rows.corridors, CORRIDORS_SCHEMA),
        obstacles=_table(rows.obstacles, OBSTACLES_SCHEMA),
        solves=_table(rows.solves, SOLVES_SCHEMA),
        certificates=_table(rows.certificates, CERTIFICATES_SCHEMA),
        findings=_table(rows.findings, FINDINGS_SCHEMA),
        scene=rows.scenes[0],
        summary=_summary(log),
        config_toml=_text(log, "config.toml"),
    )


def is_result(path: Path) -> bool:
    """Tell whether a path names a result: its folder, or a file with a result's provenance.

    Raises
    ------
    LogError
        If there is no such file, or it is not MCAP.
    """
    if path.is_dir():
        return True
    log = open_log(path)
    for _ in log.messages(lambda _: False):
        pass
    return any(record.name == "istc.provenance" for record in log.metadata)


def result_file(path: Path) -> Path:
    """The result.mcap of a result's folder, or the file itself."""
    return path / "result.mcap" if path.is_dir() else path


def load_result_folder(path: Path, *, states: bool = True) -> Result:
    """Read a result from its folder, or from the result.mcap in it; `states` as of `read_result`.

    Where a summary.json stands beside the file and tells of this very result, it takes the place
    of the attached one and lends its wall-clock times to the solves table. A summary of another
    result is left alone.

    Raises
    ------
    LogError
        As `read_result` does.
    """
    file = result_file(path)
    result = read_result(file, states=states)
    summary = _read_summary(file.parent / "summary.json")
    if summary is None or repeatable_summary(summary) != result.summary:
        return result
    return replace(result, summary=summary, solves=_with_times(result.solves, summary.get("solves")))


def repeatable_summary(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the summary without what differs between runs: wall-clock times, the log's folder."""
    kept: dict[str, Any] = _without_times(summary)
    told = kept.get("input")
    if isinstance(told, dict) and isinstance(told.get("path"), str):
        kept["input"] = {**told, "path": PurePath(told["path"]).name}
    return kept


def _without_times(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_times(item) for key, item in value.items() if key not in _OF_ONE_RUN}
    if isinstance(value, list | tuple):
        return [_without_times(item) for item in value]
    return value


# --- the whole -------------------------------------------------------------------------------


def _require_whole(log: LogFile, rows: ResultRows) -> None:
    missing = []
    if not any(record.name == "istc.provenance" for record in log.metadata):
        missing.append("the metadata istc.provenance")
    attached = {attachment.name for attachment in log.attachments}
    missing += [f"the attachment {name}" for name in ("config.toml", "summary.json") if name not in attached]
    if not rows.scenes:
        missing.append("the topic /istc/static of istc.v1.Scene")
    if len(missing) == 4:
        raise LogError(
            f"{log.name}: not a result: it lacks {', '.join(missing)}; "
            "give a result.mcap, or run istc-replay on this log"
        )
    if len(rows.scenes) > 1 or len(log.attachments) > len(attached):
        raise LogError(f"{log.name}: more than one result in one file; give them one by one")
    if log.problems:
        problem = log.problems[0]
        place = "" if problem.offset is None else f" at byte {problem.offset}"
        more = f" (and {len(log.problems) - 1} more)" if len(log.problems) > 1 else ""
        raise LogError(f"{log.name}: damaged result: {problem.code}{place}: {problem.detail}{more}; {REMEDY}")
    if missing:
        raise LogError(f"{log.name}: not a whole result: it lacks {', '.join(missing)}; {REMEDY}")


def _table(rows: list[Row], schema: pl.Schema) -> pl.DataFrame:
    return pl.DataFrame(rows, schema=schema, orient="row")


def result_states(states: pl.DataFrame, windows: Sequence[Mapping[str, Any]]) -> pl.DataFrame:
    """States in the order of a result, the recorded ones with the windows that they fall into."""
    spans = pl.DataFrame(
        [(window["index"], window["start_ns"], window["end_ns"]) for window in windows],
        schema={"at": pl.Int32, "from_ns": pl.Int64, "to_ns": pl.Int64},
        orient="row",
    )
    order = pl.col("source").replace_strict(
        {"recorded": 0, "planned": 1, "rejected": 2, "guidance": 3}, return_dtype=pl.Int8
    )
    within = pl.when(pl.col("time_ns") <= pl.col("to_ns")).then("at")
    return (
        states.sort("time_ns", maintain_order=True)
        .join_asof(spans.sort("from_ns"), left_on="time_ns", right_on="from_ns")
        .with_columns(
            _order=order,
            window=pl.when(pl.col("source") == "recorded").then(within).otherwise("window"),
        )
        .sort(
            "_order",
            pl.when(pl.col("source") != "recorded").then("window"),
            "vehicle_id",
            "time_ns",
            maintain_order=True,
        )
        .select(RESULT_STATES_SCHEMA.names())
    )


def _text(log: LogFile, name: str) -> str:
    attachment = next(attachment for attachment in log.attachments if attachment.name == name)
    try:
        return log.attachment_data(attachment).decode()
    except UnicodeDecodeError as error:
        raise LogError(f"{log.name}: damaged result: {name} is not UTF-8: {error}; {REMEDY}") from None


def _summary(log: LogFile) -> dict[str, Any]:
    summary = _parsed(_text(log, "summary.json"))
    if summary is None:
        raise LogError(f"{log.name}: damaged result: summary.json is not a JSON object; {REMEDY}")
    schema = summary.get("schema", SUMMARY_SCHEMA)
    if schema != SUMMARY_SCHEMA:
        told = quoted(str(schema))
        raise LogError(
            f"{log.name}: its summary has the schema {told}; this version reads {SUMMARY_SCHEMA}: {REMEDY}"
        )
    return summary


def _parsed(text: str) -> dict[str, Any] | None:
    try:
        summary = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return summary if isinstance(summary, dict) else None


def _read_summary(path: Path) -> dict[str, Any] | None:
    try:
        if not path.is_file() or path.stat().st_size > _SUMMARY_LIMIT:
            return None
        return _parsed(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _with_times(solves: pl.DataFrame, times: Any) -> pl.DataFrame:
    names = ("window", "vehicle_id", "layer", "stage")
    if not isinstance(times, list) or len(times) != solves.height:
        return solves
    if not all(isinstance(time, dict) for time in times):
        return solves
    told = [tuple(time.get(name) for name in names) for time in times]
    if told != solves.select(names).rows():
        return solves
    seconds = [time.get("wall_s") for time in times]
    if not all(s is None or isinstance(s, int | float) for s in seconds):
        return solves
    return solves.with_columns(pl.Series("wall_s", seconds, dtype=pl.Float64, strict=False))
