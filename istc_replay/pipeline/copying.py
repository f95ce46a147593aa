"""What clip, merge and recover share: one output, whole and read back, or none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from istc_replay.datatypes import Problem
from istc_replay.errors import ExportError, UsageError
from istc_replay.export.atomic import atomic_file
from istc_replay.export.mcap_copy import LogCopy
from istc_replay.ingest.records import Channel
from istc_replay.ingest.walk import LogFile, open_log

#: Told the bytes that are read and those that there are.
Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Copied:
    """What an output holds, and what its inputs lacked."""

    path: Path
    messages: int
    channels: int
    attachments: int
    metadata: int
    private: int  # records that only their writer can read
    complete: bool  # nothing of the inputs was lost
    problems: tuple[tuple[str, Problem], ...]  # by input
    notes: tuple[str, ...] = ()


def silent(_done: int, _total: int) -> None:
    """Tell nobody."""


def nothing(_channel: Channel) -> bool:
    """Want no channel's messages: a walk that only counts."""
    return False


def refuse_inputs(out: Path, inputs: Sequence[Path]) -> None:
    """Refuse an output that would take an input's place.

    Raises
    ------
    UsageError
        If it is one of them.
    """
    for path in inputs:
        if out.exists() and path.exists() and out.samefile(path):
            raise UsageError(f"{out}: is the input; give the output another name")


def write_copy(
    out: Path, logs: Sequence[LogFile], profile: str, fill: Callable[[LogCopy], Sequence[str]]
) -> Copied:
    """Write a copy of logs and read it back before it gets its name.

    Parameters
    ----------
    out : Path
        The file.
    logs : sequence of LogFile
        The inputs; after `fill` they have been walked.
    profile : str
        What the header states.
    fill : callable
        Copies the messages; returns notes. Attachments and metadata follow by themselves; private
        records that it has not copied are noted.
    """
    with atomic_file(out) as temporary:
        with temporary.open("wb") as stream:
            copy = LogCopy(stream, profile)
            notes = [*fill(copy)]
            for log in logs:
                for attachment in log.attachments:
                    copy.attachment(attachment, log.attachment_data(attachment))
                for record in log.metadata:
                    copy.metadata_record(record)
            copy.finish()
        _read_back(temporary, out, copy)
    left_out = sum(log.private_count for log in logs) - copy.private
    if left_out:
        notes.append(f"private records (opcodes from 0x80) are not copied: {left_out}")
    return Copied(
        out,
        copy.messages,
        copy.channels,
        copy.attachments,
        copy.metadata,
        copy.private,
        all(log.complete for log in logs),
        tuple((log.name, problem) for log in logs for problem in log.problems),
        tuple(notes),
    )


def _read_back(temporary: Path, out: Path, copy: LogCopy) -> None:
    written = open_log(temporary)
    for _ in written.batches(nothing):
        pass
    found = (
        written.message_count,
        written.attachment_count,
        written.metadata_count,
        written.private_count,
    )
    if found != (copy.messages, copy.attachments, copy.metadata, copy.private) or written.problems:
        raise ExportError(f"{out}: what was written does not read back whole; check the disk")
