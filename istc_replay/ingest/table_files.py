"""CSV and Parquet files in pieces of rows."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import polars as pl

from istc_replay.ingest.parquet import ParquetTable
from istc_replay.ingest.problems import Problems
from istc_replay.ingest.xml_stream import Progress

_ROWS = 50_000
#: The longest field of a CSV file [characters].
_FIELD = 10_000
#: The longest header of a CSV file [characters].
_HEADER = 2**20


class CsvFile:
    """A CSV file in pieces of texts; an empty field is null."""

    unit = "line"

    def __init__(self, path: Path, problems: Problems, progress: Progress) -> None:
        self._path, self._problems, self._progress = path, problems, progress
        with self._open() as stream:
            head = stream.readline(_HEADER)
        self._delimiter = max(",;\t|", key=head.count)
        self.columns = [name.strip() for name in next(csv.reader([head], delimiter=self._delimiter), [])]

    def _open(self) -> TextIO:
        return self._path.open(encoding="utf-8-sig", errors="replace", newline="")

    def pieces(self, wanted: Sequence[str]) -> Iterator[tuple[pl.DataFrame, list[int]]]:
        """Give the wanted columns and the lines that they stand on, many rows at a time."""
        places = [self.columns.index(name) for name in wanted]
        csv.field_size_limit(_FIELD)
        size = self._path.stat().st_size
        with self._open() as stream:
            reader = csv.reader(stream, delimiter=self._delimiter)
            next(reader, None)
            rows = self._rows(reader)
            while piece := list(islice(rows, _ROWS)):
                cells = [[row[place] or None for row, _ in piece] for place in places]
                table = pl.DataFrame(
                    dict(zip(wanted, cells, strict=True)), schema=dict.fromkeys(wanted, pl.String)
                )
                yield table, [line for _, line in piece]
                self._progress(stream.buffer.tell(), size)

    def _rows(self, reader: Any) -> Iterator[tuple[list[str], int]]:
        count = len(self.columns)
        while True:
            try:
                row = next(reader)
            except StopIteration:
                return
            except csv.Error as error:
                self._problems.lose("bad_row", f"line {reader.line_num}: left out: {error}")
                continue
            if len(row) == count:
                yield row, reader.line_num
            elif row:
                detail = f"line {reader.line_num}: {len(row)} fields where the header has {count}; left out"
                self._problems.lose("bad_row", detail)


class ParquetFile:
    """A Parquet file in pieces."""

    unit = "row"

    def __init__(self, path: Path, progress: Progress) -> None:
        self._table, self._progress = ParquetTable(path), progress
        self.columns = self._table.columns

    def pieces(self, wanted: Sequence[str]) -> Iterator[tuple[pl.DataFrame, list[int]]]:
        """Give the wanted columns and the numbers of their rows, from 1."""
        start = 0
        for piece in self._table.pieces(wanted, _ROWS):
            yield piece, list(range(start + 1, start + 1 + piece.height))
            start += piece.height
            self._progress(start, self._table.height)
