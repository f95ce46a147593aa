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
    """Write the tables of a log or a result; returns whether the source was whole, and the files."""
    from istc_replay.export.tables import log_tables, result_tables, write_tables
    from istc_replay.ingest.log import read_log
    from istc_replay.ingest.result import is_result, load_result_folder

    if is_result(source):
        return True, write_tables(result_tables(load_result_folder(source)), folder, formats)
    log = read_log(source, config)
    return log.complete, write_tables(log_tables(log), folder, formats)
