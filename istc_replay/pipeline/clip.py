"""Cutting a span out of a log."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import polars as pl

from istc_replay.config import Config
from istc_replay.errors import LogError, UsageError
from istc_replay.export.mcap_copy import LogCopy
from istc_replay.ingest.finding_file import FoundSpan, read_finding
from istc_replay.ingest.log import read_log
from istc_replay.ingest.problems import quoted
from istc_replay.ingest.records import Channel
from istc_replay.ingest.walk import LogFile, open_log
from istc_replay.pipeline.copying import Copied, Progress, nothing, refuse_inputs, silent, write_copy
from istc_replay.units import NS_PER_S, seconds_to_ns

#: ROS 2 recorders note how long a publisher keeps what it said.
_KEPT_BY_PUBLISHER = re.compile(r"durability:\s*(?:1|transient_local)\b")
_SECONDS = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)")
#: Where a log begins and ends that is not cut there; a file's times are not negative.
_FIRST_NS, _LAST_NS = 0, 2**64
_STANDING_SCHEMAS = {"istc.v1.Scene"}


@dataclass(frozen=True, slots=True)
class Around:
    """A span around a moment [ns], or around a finding of an audit."""

    margin_s: float
    moment: str | None = None
    finding_id: str | None = None
    audit: Path | None = None


@dataclass(frozen=True, slots=True)
class Between:
    """A span from one moment up to another, this one not included; None: the log's start or end."""

    start: str | None
    end: str | None


def clip_log(
    source: Path, out: Path, span: Around | Between, config: Config, progress: Progress = silent
) -> Copied:
    """Write what a log holds of a span of log time, as a log.

    What holds for the whole log (static transforms, scenes, topics whose publisher keeps what it
    said) is kept from before the span too; attachments and metadata are all kept.

    Parameters
    ----------
    source, out : Path
        The log, and the file to write.
    span : Around or Between
        Moments are seconds from the log's start ("12.5"), nanoseconds ("1700000000000000000ns"),
        or a date and time of ISO 8601.
    config : Config
        How to read the log's states, for a finding.
    progress : callable, optional
        Told bytes read and bytes in all.

    Raises
    ------
    LogError
        If there is nothing to walk, or the log has no messages.
    UsageError
        If the span cannot be used: a moment that is none, nothing in the span, no such finding.
    """
    refuse_inputs(out, [source])
    log = open_log(source)
    walks = 1 + _counts_from_start(span)
    first_ns = _start(log, progress) if walks > 1 else 0
    start_ns, end_ns = _limits(source, span, config, first_ns)
    stands = cache(is_standing)

    def fill(copy: LogCopy) -> Sequence[str]:
        inside = before = 0
        for message in log.messages():
            progress((walks - 1) * log.size + log.position, walks * log.size)
            within = start_ns <= message.log_time_ns < end_ns
            early = message.log_time_ns < start_ns and stands(message.channel)
            inside, before = inside + within, before + early
            if within or early:
                copy.message(0, message)
        if log.start_ns is None or log.end_ns is None:
            raise LogError(f"{source}: holds no messages; there is nothing to clip")
        told = max(start_ns, log.start_ns), min(end_ns, log.end_ns + 1)
        if not inside:
            raise UsageError(_empty(log, start_ns, end_ns))
        for channel in log.counts:
            copy.declare(0, channel)
        noted = [f"{before} messages from before the span that hold for the whole log are kept"]
        return [f"log times {told[0]} to {told[1]} ns", *(noted if before else [])]

    return write_copy(out, [log], log.profile, fill)


def _start(log: LogFile, progress: Progress) -> int:
    """Walk the log to learn where its time begins [ns]: what its summary says of that may be wrong."""
    for _ in log.batches(nothing):
        progress(log.position, 2 * log.size)
    return log.start_ns or 0


def _counts_from_start(span: Around | Between) -> bool:
    """Tell whether a span says where it is by seconds from the log's start."""
    moments = (span.moment,) if isinstance(span, Around) else (span.start, span.end)
    return any(moment is not None and _SECONDS.fullmatch(moment.strip()) for moment in moments)


def is_standing(channel: Channel) -> bool:
    """Tell whether what a channel says holds until it says otherwise."""
    return (
        channel.topic.rpartition("/")[2] == "tf_static"
        or (channel.schema is not None and channel.schema.name in _STANDING_SCHEMAS)
        or bool(_KEPT_BY_PUBLISHER.search(channel.metadata.get("offered_qos_profiles", "")))
    )


def moment_ns(text: str, start_ns: int) -> int:
    """Read a moment; seconds count from start_ns.

    Raises
    ------
    UsageError
        If it is none.
    """
    given = text.strip()
    try:
        if given.endswith("ns"):
            return int(given[:-2])
        if _SECONDS.fullmatch(given):
            return start_ns + seconds_to_ns(float(given))
        when = datetime.fromisoformat(given)
        when = when if when.tzinfo else when.replace(tzinfo=UTC)
        return round((when - datetime.fromtimestamp(0, UTC)).total_seconds() * NS_PER_S)
    except (ValueError, OverflowError):
        raise UsageError(
            f"{quoted(text)} is no moment; give seconds from the log's start (12.5), nanoseconds "
            "(1700000000000000000ns) or a date and time (2026-05-01T10:00:00Z)"
        ) from None


def _limits(source: Path, span: Around | Between, config: Config, first_ns: int) -> tuple[int, int]:
    """Return where the span starts and ends, the end not included [ns]."""
    if isinstance(span, Between):
        start_ns = _FIRST_NS if span.start is None else moment_ns(span.start, first_ns)
        end_ns = _LAST_NS if span.end is None else moment_ns(span.end, first_ns)
        if start_ns >= end_ns:
            raise UsageError(f"the span from {start_ns} to {end_ns} ns is empty; --to must be after --from")
        return start_ns, end_ns
    margin_ns = seconds_to_ns(span.margin_s)
    if span.finding_id is not None:
        low, high = _finding_log_times(source, span.finding_id, span.audit, config)
        return low - margin_ns, high + margin_ns + 1
    middle_ns = moment_ns(span.moment or "", first_ns)
    return middle_ns - margin_ns, middle_ns + margin_ns + 1


def _finding_log_times(source: Path, finding_id: str, audit: Path | None, config: Config) -> tuple[int, int]:
    """Return the log times of the states that a finding is about: its own times may be other clocks'."""
    log = read_log(source, config)
    found = _audited(log, finding_id, config) if audit is None else read_finding(audit, finding_id)
    if found.sha256 and found.sha256 != log.sha256:
        raise UsageError(f"{audit}: is the audit of another log than {source} (their sha256 differ)")
    states = log.states.filter(pl.col("vehicle_id").is_in(found.vehicles))
    inside = states.filter(pl.col("time_ns").is_between(found.start_ns, found.end_ns))
    if inside.is_empty() and not states.is_empty():
        # Between two states: those nearest to its start.
        inside = states.sort((pl.col("time_ns") - found.start_ns).abs()).head(2)
    if inside.is_empty():
        raise UsageError(f"finding {finding_id}: {source} holds no state of its vehicles at its time")
    times = inside["log_time_ns"]
    return int(times.min()), int(times.max())  # type: ignore[arg-type]


def _audited(log: object, finding_id: str, config: Config) -> FoundSpan:
    from istc_replay.ingest.finding_file import found_in
    from istc_replay.safety.log_audit import audit_log

    return found_in(audit_log(log, config).findings.to_dicts(), finding_id, "the audit of this log")  # type: ignore[arg-type]


def _empty(log: LogFile, start_ns: int, end_ns: int) -> str:
    lasts_s = ((log.end_ns or 0) - (log.start_ns or 0)) / NS_PER_S
    return (
        f"{log.name}: no message has a log time from {start_ns} to {end_ns} ns; "
        f"the log lasts {lasts_s:.3f} s from {log.start_ns} ns"
    )
