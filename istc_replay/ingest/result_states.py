"""The states of a long result, a span of time after the other: all of them would not fit into memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import polars as pl

from istc_replay.datatypes import Result
from istc_replay.errors import LogError
from istc_replay.ingest.problems import quoted
from istc_replay.ingest.records import Channel
from istc_replay.ingest.result import REMEDY, result_states
from istc_replay.ingest.result_rows import ResultRows, collect, holds_states, skip
from istc_replay.ingest.walk import open_log
from istc_replay.states import RESULT_STATES_SCHEMA
from istc_replay.units import NS_PER_S

#: What a part knows of the time before and after its own: a trail's length, and a gap's.
_BEHIND_NS, _AHEAD_NS = 4 * NS_PER_S, 4 * NS_PER_S
#: Rows made a table of at a time.
_ROWS = 20_000
_TABLES = ("corridors", "obstacles", "solves", "certificates")

Window = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class _Span:
    """Windows of a part, and since and until when messages may tell of it [ns]."""

    windows: tuple[Window, ...]
    start_ns: int
    end_ns: int

    @property
    def indices(self) -> list[int]:
        return [window["index"] for window in self.windows]

    @property
    def until_ns(self) -> int:
        """The last log time of what belongs to it; a file's times are not negative."""
        return max([self.end_ns, 0, *(int(window["end_ns"]) for window in self.windows)])


def result_parts(source: Path | bytes, head: Result, windows: int) -> Iterator[Result]:
    """Give a result's parts in order of time: the states about some windows, and their tables.

    Parameters
    ----------
    source : Path or bytes
        The file, or what it holds.
    head : Result
        The result without its states (`read_result`).
    windows : int
        Windows of a part.

    Yields
    ------
    Result
        The states of its windows, and all others from 4 s before the first until 4 s after the
        last; the other tables of its windows alone, and all findings.

    Raises
    ------
    LogError
        If a message is not what its topic promises.
    """
    spans, ordered = _grouped(head, windows)
    for span, states in zip(spans, _states(source, spans, ordered), strict=True):
        yield _part(head, span, states, pl.col("window").is_in(span.indices))


def plan_parts(source: Path | bytes, head: Result, windows: int) -> Iterator[Result]:
    """Give a result's plans in order of time: all states but the recorded ones, each once.

    Parameters
    ----------
    source, head, windows
        As of `result_parts`.

    Yields
    ------
    Result
        The states and the tables of its windows alone; the last one also has those of windows that the
        summary does not list.

    Raises
    ------
    LogError
        If a message is not what its topic promises, or far from the time of its window.
    """
    spans, ordered = _grouped(head, windows)
    known = [window["index"] for window in ordered]
    others = _Others(known)
    given = 0
    for span, states in zip(spans, _states(source, spans, ordered, _holds_plans, others), strict=True):
        own = pl.col("window").is_in(span.indices)
        found = states.filter(own)
        if span is spans[-1]:
            own |= ~pl.col("window").is_in(known)
            found = result_states(pl.concat([found, *others.tables]), ordered)
        given += found.height
        yield _part(head, span, found, own)
    if given != others.rows:
        lost = f"{others.rows - given} states of plans are far from their windows"
        raise LogError(f"{open_log(source).name}: damaged result: {lost}; {REMEDY}")


def recorded_states(source: Path | bytes, head: Result) -> pl.DataFrame:
    """All recorded states of a result, in its order.

    Raises
    ------
    LogError
        If a message is not what its topic promises.
    """
    everything = _Span((), -(2**63), 2**63 - 1)
    (states,) = _states(source, [everything], head.summary["windows"], _holds_recorded)
    return states


def _grouped(head: Result, windows: int) -> tuple[list[_Span], list[Window]]:
    """The spans of parts of so many windows, and all windows in order of time."""
    ordered = sorted(head.summary["windows"], key=lambda w: (w["start_ns"], w["index"]))
    groups = [tuple(ordered[first : first + windows]) for first in range(0, len(ordered), windows)] or [()]
    starts = [group[0]["start_ns"] if group else 0 for group in groups]
    return [
        _Span(group, start - _BEHIND_NS if start > starts[0] else -(2**63), following + _AHEAD_NS)
        for group, start, following in zip(groups, starts, [*starts[1:], 2**62], strict=True)
    ], ordered


def _part(head: Result, span: _Span, states: pl.DataFrame, own: pl.Expr) -> Result:
    return replace(
        head,
        states=states,
        **{name: getattr(head, name).filter(own) for name in _TABLES},
        summary={**head.summary, "windows": list(span.windows)},
    )


def _holds_recorded(channel: Channel) -> bool:
    return holds_states(channel) and channel.topic.startswith("/istc/recorded/")


def _holds_plans(channel: Channel) -> bool:
    return holds_states(channel) and not channel.topic.startswith("/istc/recorded/")


def window_states(source: Path | bytes, head: Result, indices: Sequence[int]) -> pl.DataFrame:
    """The states of some windows, and what is recorded within them."""
    chosen = [window for window in head.summary["windows"] if window["index"] in set(indices)]
    ordered = sorted(chosen, key=lambda w: (w["start_ns"], w["index"]))
    spans = [_Span((window,), window["start_ns"], window["end_ns"] + 1) for window in ordered]
    tables = list(_states(source, spans, head.summary["windows"]))
    return pl.concat([RESULT_STATES_SCHEMA.to_frame(), *tables])


@dataclass(slots=True)
class _Others:
    """What a walk finds of other windows than the known ones, and how many rows it makes."""

    known: list[int]
    tables: list[pl.DataFrame] = field(default_factory=list)
    rows: int = 0

    def take(self, made: pl.DataFrame) -> None:
        """Look at rows as they are made."""
        self.rows += made.height
        self.tables.append(made.filter(~pl.col("window").is_in(self.known)))


def _states(
    source: Path | bytes,
    spans: Sequence[_Span],
    windows: Sequence[Window],
    wanted: Callable[[Channel], bool] = holds_states,
    others: _Others | None = None,
) -> Iterator[pl.DataFrame]:
    """The states of each span in one walk through the file; both ends of the spans ascend."""
    log, rows, tables = open_log(source), ResultRows(), list[pl.DataFrame]()
    waiting = list(spans)
    for message in log.messages(wanted):
        while waiting and message.log_time_ns > waiting[0].until_ns:
            tables = _table(rows, tables, others)
            yield result_states(_of(waiting.pop(0), tables), windows)
            tables = _kept(waiting, tables)
        if not waiting or message.log_time_ns < waiting[0].start_ns:
            skip(rows, message)
            continue
        try:
            collect(rows, message)
        except ValueError as error:
            place = f"{quoted(message.channel.topic)}, byte {message.offset}"
            raise LogError(f"{log.name}: damaged result: {place}: {error}; {REMEDY}") from None
        if len(rows.states) >= _ROWS:
            tables = _table(rows, tables, others)
    for span in waiting:
        tables = _table(rows, tables, others)
        yield result_states(_of(span, tables), windows)


def _table(rows: ResultRows, tables: list[pl.DataFrame], others: _Others | None) -> list[pl.DataFrame]:
    """The tables, with one of the rows that are collected."""
    made = pl.DataFrame(rows.states, schema=RESULT_STATES_SCHEMA, orient="row")
    rows.states = []
    if others is not None:
        others.take(made)
    return [*tables, made]


def _of(span: _Span, tables: Sequence[pl.DataFrame]) -> pl.DataFrame:
    within = (pl.col("time_ns") >= span.start_ns) & (pl.col("time_ns") < span.end_ns)
    mine = within | pl.col("window").is_in(span.indices)
    return pl.concat([RESULT_STATES_SCHEMA.to_frame(), *(table.filter(mine) for table in tables)])


def _kept(waiting: Sequence[_Span], tables: Sequence[pl.DataFrame]) -> list[pl.DataFrame]:
    """What a later span may still want."""
    if not waiting:
        return []
    start_ns = waiting[0].start_ns
    later = (pl.col("time_ns") >= start_ns) | pl.col("window").is_in(waiting[0].indices)
    return [kept for table in tables if (kept := table.filter(later)).height]
