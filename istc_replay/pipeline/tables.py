"""Tables of a log or a result, and the layout that shows a result elsewhere."""

from __future__ import annotations

import itertools
import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from istc_replay.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    import polars as pl

    from istc_replay.config import Config

LAYOUT = "foxglove-layout.json"


def export_files(
    source: Path,
    folder: Path,
    formats: Sequence[Literal["parquet", "csv", "foxglove"]],
    config: Config,
    reading: Callable[[int, int], None] | None = None,
) -> tuple[bool, list[Path]]:
    """Write a log's or a result's files of these formats; returns whether it was whole, and the files.

    Raises
    ------
    UsageError
        If a layout is asked for of a log.
    """
    from istc_replay.ingest.result import is_result

    tables: list[Literal["parquet", "csv"]] = [kind for kind in formats if kind != "foxglove"]
    if "foxglove" not in formats:
        return export_tables(source, folder, tables, config, reading)
    if not is_result(source):
        raise UsageError(f"{source}: a layout fits a result, not a log: run istc-replay on it first")
    complete, files = export_tables(source, folder, tables, config) if tables else (True, [])
    return complete, [*files, write_layout(source, folder)]


def write_layout(source: Path, folder: Path) -> Path:
    """Write the layout in which Foxglove and Lichtblick show a result."""
    from istc_replay.export.atomic import atomic_file, prepare_folder
    from istc_replay.export.foxglove_layout import foxglove_layout
    from istc_replay.pipeline.reading import read_in_parts

    layout = foxglove_layout(part.states for part in read_in_parts(source).each())
    path = prepare_folder(folder) / LAYOUT
    with atomic_file(path) as file:
        file.write_text(json.dumps(layout, indent=1) + "\n", encoding="utf-8")
    return path


def export_tables(
    source: Path,
    folder: Path,
    formats: Sequence[Literal["parquet", "csv"]],
    config: Config,
    reading: Callable[[int, int], None] | None = None,
) -> tuple[bool, list[Path]]:
    """Write the tables of a log or a result and of its audit; returns whether it was whole, and the files."""
    from istc_replay.export.atomic import prepare_folder
    from istc_replay.export.audit import audit_tables
    from istc_replay.export.tables import by_source, log_tables, result_tables, write_tables
    from istc_replay.ingest.log import read_log
    from istc_replay.ingest.result import is_result
    from istc_replay.pipeline.audit import audit_reading
    from istc_replay.pipeline.reading import read_in_parts
    from istc_replay.safety.log_audit import audit_log

    if is_result(source):
        found = read_in_parts(source)
        with tempfile.TemporaryDirectory(prefix=".istc-export-", dir=prepare_folder(folder)) as spool:
            # What the file has itself goes before what is made anew.
            tables: dict[str, pl.DataFrame | Iterable[pl.DataFrame]]
            tables = {**audit_tables(audit_reading(found)), **result_tables(found.result)}
            plans = (part.states for part in found.plans())
            tables["states"] = itertools.chain([found.recorded()], by_source(plans, Path(spool)))
            return True, write_tables(tables, folder, formats)
    log = read_log(source, config, reading)
    return log.complete, write_tables(log_tables(log) | audit_tables(audit_log(log, config)), folder, formats)
