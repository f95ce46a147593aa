"""Parquet files of others, by Arrow: what is damaged in them is an error there, in Polars a panic."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from istc_replay.errors import LogError


class ParquetTable:
    """A Parquet file, read in pieces.

    Raises
    ------
    LogError
        From every method, if the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = pq.ParquetFile(path)
        except (OSError, ValueError, pa.ArrowException) as error:
            raise self._refused(error) from None

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return list(self._file.schema_arrow.names)

    @property
    def height(self) -> int:
        """Rows of the file, as it says."""
        return int(self._file.metadata.num_rows)

    def pieces(self, columns: Sequence[str] | None, rows: int) -> Iterator[pl.DataFrame]:
        """Give the columns (None: all), so many rows at a time."""
        try:
            for batch in self._file.iter_batches(batch_size=rows, columns=columns):
                batch.validate(full=True)
                piece = pl.from_arrow(batch)
                if isinstance(piece, pl.DataFrame):
                    yield piece
        except (OSError, ValueError, TypeError, pa.ArrowException, pl.exceptions.PolarsError) as error:
            raise self._refused(error) from None

    def _refused(self, error: Exception) -> LogError:
        reason = " ".join((getattr(error, "strerror", None) or str(error)).split())[:200]
        return LogError(f"{self._path}: is no Parquet file that can be read: {reason}")
