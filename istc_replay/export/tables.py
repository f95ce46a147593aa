"""Tables as Parquet and CSV files."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Literal

import polars as pl
from pyarrow.parquet import ParquetWriter

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


def by_source(parts: Iterable[pl.DataFrame], spool: Path) -> Iterator[pl.DataFrame]:
    """The states of plans in the order of a result, by source, of parts with those of all sources.

    Parameters
    ----------
    parts : iterable of DataFrame
        Each is kept in a file until its turn comes.
    spool : Path
        The folder for these.
    """
    pieces: dict[str, list[Path]] = {source: [] for source in ("planned", "rejected", "guidance")}
    for number, part in enumerate(parts):
        for source, own in pieces.items():
            own.append(spool / f"{source}_{number}.parquet")
            part.filter(pl.col("source") == source).write_parquet(own[-1])
    for piece in itertools.chain(*pieces.values()):
        yield pl.read_parquet(piece)


def write_tables(
    tables: Mapping[str, pl.DataFrame | Iterable[pl.DataFrame]], folder: Path, formats: Sequence[Format]
) -> list[Path]:
    """Write each table as `<folder>/<name>.<format>`, each file whole or not at all.

    In CSV, lists are joined by spaces, a null is an empty field and an empty text is `""`. Texts
    are written as the log has them: a vehicle may be named `=1+1`, so a spreadsheet should import
    these columns as text.

    Parameters
    ----------
    tables : mapping of str to DataFrame or iterable of DataFrame
        Tables by name, or their pieces one after the other, of which there is one at least.
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
        paths = [folder / f"{name}.{format_}" for format_ in formats]
        with ExitStack() as files:
            writers = [
                files.enter_context(_WRITERS[format_](files.enter_context(atomic_file(path))))
                for format_, path in zip(formats, paths, strict=True)
            ]
            for piece in [table] if isinstance(table, pl.DataFrame) else table:
                for write in writers:
                    write(piece)
        written += paths
    return written


@contextmanager
def _parquet(path: Path) -> Iterator[Callable[[pl.DataFrame], None]]:
    writer: ParquetWriter | None = None

    def write(piece: pl.DataFrame) -> None:
        nonlocal writer
        table = piece.to_arrow()
        if writer is None:
            writer = ParquetWriter(path, table.schema, compression="zstd")
        writer.write_table(table)

    yield write
    if writer is not None:
        writer.close()


@contextmanager
def _csv(path: Path) -> Iterator[Callable[[pl.DataFrame], None]]:
    with path.open("wb") as file:

        def write(piece: pl.DataFrame) -> None:
            lists = [name for name, dtype in piece.schema.items() if isinstance(dtype, pl.List)]
            flat = piece.with_columns(pl.col(name).cast(pl.List(pl.String)).list.join(" ") for name in lists)
            flat.write_csv(file, include_header=file.tell() == 0)

        yield write


_WRITERS = {"parquet": _parquet, "csv": _csv}
