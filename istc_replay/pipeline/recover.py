"""Making a damaged log whole."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from istc_replay.errors import LogError
from istc_replay.export.mcap_copy import LogCopy
from istc_replay.ingest.walk import open_log
from istc_replay.pipeline.copying import Copied, Progress, refuse_inputs, silent, write_copy


def recover_log(source: Path, out: Path, progress: Progress = silent) -> Copied:
    """Write everything intact in a log, in its order, as a whole log.

    Raises
    ------
    LogError
        If there is nothing to walk, or nothing intact.
    UsageError
        If the output is the input.
    ExportError
        If the output cannot be written.
    """
    refuse_inputs(out, [source])
    log = open_log(source)

    def fill(copy: LogCopy) -> Sequence[str]:
        for message in log.messages(private=copy.private_record):
            copy.message(0, message)
            progress(log.position, log.size)
        for channel in log.counts:
            copy.declare(0, channel)
        for schema in log.schemas:
            copy.schema(schema)
        if not (log.complete or log.message_count or log.attachments or log.metadata or log.private_count):
            why = log.problems[0].detail
            raise LogError(f"{source}: nothing in it is intact, so nothing is written: {why}")
        return ()

    return write_copy(out, [log], log.profile, fill)
