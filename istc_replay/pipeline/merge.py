"""Joining logs into one."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from istc_replay.errors import UsageError
from istc_replay.export.mcap_copy import LogCopy
from istc_replay.ingest.problems import quoted
from istc_replay.ingest.records import Channel, Message
from istc_replay.ingest.walk import LogFile, open_log
from istc_replay.pipeline.copying import Copied, Progress, nothing, refuse_inputs, silent, write_copy

#: Topics that are told one by one.
_TOLD = 10


def merge_logs(
    sources: Sequence[Path], out: Path, apart: bool = False, progress: Progress = silent
) -> Copied:
    """Write the messages of several logs in the order of their log times, as one log.

    A channel that several logs declare alike becomes one; what differs in anything stays apart.
    Messages of one log stay in its own order.

    Parameters
    ----------
    sources : sequence of Path
        Two logs or more.
    out : Path
        The file to write.
    apart : bool
        Put each log's topics below its file's name, so that vehicles that use the same topics are
        not taken for one.
    progress : callable, optional
        Told bytes read and bytes in all.

    Raises
    ------
    LogError
        If there is nothing to walk in one of them.
    UsageError
        If fewer than two logs are given, one is given twice, or is the output.
    """
    if len(sources) < 2:
        raise UsageError("give two logs or more")
    refuse_inputs(out, sources)
    logs = [open_log(path) for path in sources]
    notes = [*_twice(sources, logs)]
    for log in logs:
        for _ in log.batches(nothing):
            pass
    prefixes = _prefixes(sources) if apart else [""] * len(logs)
    notes += [] if apart else _shared_topics(logs)
    notes += _clocks(logs)
    profiles = {log.profile for log in logs}
    if len(profiles) > 1:
        told = ", ".join(quoted(name) for name in sorted(profiles))
        notes.append(f"the logs state different profiles ({told}): the merged log states none")
    total = sum(log.size for log in logs)

    def fill(copy: LogCopy) -> Sequence[str]:
        streams = [_numbered(index, log) for index, log in enumerate(logs)]
        for source, message in heapq.merge(*streams, key=lambda entry: entry[1].log_time_ns):
            copy.message(source, message, prefixes[source])
            progress(sum(log.position for log in logs), total)
        for source, log in enumerate(logs):
            for channel in log.counts:
                copy.declare(source, channel, prefixes[source])
        return notes

    return write_copy(out, logs, profiles.pop() if len(profiles) == 1 else "", fill)


def _numbered(index: int, log: LogFile) -> Iterator[tuple[int, Message]]:
    for message in log.messages():
        yield index, message


def _twice(sources: Sequence[Path], logs: Sequence[LogFile]) -> Iterator[str]:
    """Refuse a file that is given twice; tell files that hold the same bytes."""
    for index, path in enumerate(sources):
        for other in range(index):
            if path.samefile(sources[other]):
                raise UsageError(f"{path}: is given twice")
            if logs[index].size == logs[other].size and logs[index].sha256() == logs[other].sha256():
                yield f"{path} holds the same bytes as {sources[other]}: its messages are there twice"


def _prefixes(sources: Sequence[Path]) -> list[str]:
    names = [path.stem or "log" for path in sources]
    counts = Counter(names)
    return [f"/{name}" if counts[name] == 1 else f"/{name}_{index + 1}" for index, name in enumerate(names)]


def _shared_topics(logs: Sequence[LogFile]) -> Iterator[str]:
    """Tell topics that several logs have."""
    kinds: dict[str, set[tuple[object, ...]]] = {}
    holders: dict[str, set[int]] = {}
    for index, log in enumerate(logs):
        for channel in log.counts:
            kinds.setdefault(channel.topic, set()).add(_kind(channel))
            holders.setdefault(channel.topic, set()).add(index)
    shared = [topic for topic, held in holders.items() if len(held) > 1]
    for topic in shared[:_TOLD]:
        what = f"{quoted(topic)} is in {len(holders[topic])} logs"
        if len(kinds[topic]) == 1:
            yield f"{what}: one channel; if they are of different vehicles, --apart keeps them so"
        else:
            yield f"{what}, declared differently: channels of their own on one topic"
    if len(shared) > _TOLD:
        yield f"{len(shared) - _TOLD} more topics are in several logs"


def _kind(channel: Channel) -> tuple[object, ...]:
    return channel.message_encoding, channel.schema, tuple(channel.metadata.items())


def _clocks(logs: Sequence[LogFile]) -> Iterator[str]:
    """Tell logs that have no time in common with any other: their clocks may differ."""
    spans = [(log.start_ns, log.end_ns) for log in logs]
    for index, (start, end) in enumerate(spans):
        if start is None or end is None:
            yield f"{logs[index].name} holds no messages"
            continue
        others = [(low, high) for place, (low, high) in enumerate(spans) if place != index]
        if not any(
            low is not None and high is not None and low <= end and start <= high for low, high in others
        ):
            yield f"{logs[index].name} has no time in common with another log; their clocks may differ"
