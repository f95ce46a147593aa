"""Tables of a log or a result."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from istc_replay.config import Config


def export_tables(
    source: Path, folder: Path, formats: Sequence[Literal["parquet", "csv"]], config: Config
) -> tuple[bool, list[Path]]:
    """Write the tables of a log or a result and of its audit; returns whether it was whole, and the files."""
    from istc_replay.export.audit import audit_tables
    from istc_replay.export.tables import log_tables, result_tables, write_tables
    from istc_replay.ingest.log import read_log
    from istc_replay.ingest.result import is_result, load_result_folder
    from istc_replay.pipeline.audit import audit_loaded
    from istc_replay.safety.log_audit import audit_log

    if is_result(source):
        result = load_result_folder(source)
        # What the file has itself goes before what is made anew.
        tables = audit_tables(audit_loaded(result)) | result_tables(result)
        return True, write_tables(tables, folder, formats)
    log = read_log(source, config)
    tables = log_tables(log) | audit_tables(audit_log(log, config))
    return log.complete, write_tables(tables, folder, formats)
