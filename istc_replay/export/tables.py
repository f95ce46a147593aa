"""Tables as Parquet and CSV files."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import polars as pl

from istc_replay.datatypes import Log, Result
from istc_replay.errors import ExportError
from istc_replay.export.atomic import atomic_file, prepare_folder
from istc_replay.states import RESULT_STATES_SCHEMA, conform

Format = Literal["parquet", "csv"]


def log_tables(log: Log) -> dict[str, pl.DataFrame]:
    """Give a log's tables: `states`, all of them recorded, in the columns that results have too."""
    known = [name for name in RESULT_STATES_SCHEMA.names() if name in log.states.columns]
    states = log.states.select(known).with_columns(source=pl.lit("recorded"))
    return {"states": conform(states, RESULT_STATES_SCHEMA)}


def result_tables(result: Result) -> dict[str, pl.DataFrame]:
    """Give a result's tables by name."""
    return {
        "states": result.states,
        "corridors": result.corridors,
        "obstacles": result.obstacles,
        "solves": result.solves,
        "certificates": result.certificates,
        "findings": result.findings,
    }


def write_tables(tables: Mapping[str, pl.DataFrame], folder: Path, formats: Sequence[Format]) -> list[Path]:
    """Write each table as `<folder>/<name>.<format>`, each file whole or not at all.

    In CSV, lists are joined by spaces, a null is an empty field and an empty text is `""`. Texts
    are written as the log has them: a vehicle may be named `=1+1`, so a spreadsheet should import
    these columns as text.

    Parameters
    ----------
    tables : mapping of str to DataFrame
        Tables by name.
    folder : Path
        Made where it is missing.
    formats : sequence of {"parquet", "csv"}
        One or more.

    Returns
    -------
    list of Path
        The files, in the order of tables and formats.

    Raises
    ------
    ExportError
        If a name or format is not one of these, or a file cannot be written.
    """
    for name in tables:
        if not re.fullmatch(r"[a-z0-9_]+", name):
            raise ExportError(f"table name {name!r}: only a-z, 0-9 and _ make a file name; rename the table")
    for format_ in formats:
        if format_ not in _WRITERS:
            raise ExportError(f"no table format is named {format_!r}; there are {', '.join(_WRITERS)}")
    prepare_folder(folder)
    written = []
    for name, table in tables.items():
        for format_ in formats:
            path = folder / f"{name}.{format_}"
            with atomic_file(path) as temporary:
                temporary.write_bytes(_WRITERS[format_](table))
            written.append(path)
    return written


def _parquet(table: pl.DataFrame) -> bytes:
    stream = io.BytesIO()
    table.write_parquet(stream)
    return stream.getvalue()


def _csv(table: pl.DataFrame) -> bytes:
    lists = [name for name, dtype in table.schema.items() if isinstance(dtype, pl.List)]
    flat = table.with_columns(pl.col(name).cast(pl.List(pl.String)).list.join(" ") for name in lists)
    return flat.write_csv().encode()


_WRITERS = {"parquet": _parquet, "csv": _csv}
