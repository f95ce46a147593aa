"""Fixtures of the Rerun view's tests: the view in a file, and its rows by entity."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from istc_replay.config import ViewConfig
from istc_replay.datatypes import Result

Rows = list[dict[str, Any]]


@pytest.fixture
def strict_rerun() -> Iterator[None]:
    """Let Rerun raise where it would only warn."""
    import rerun

    rerun.set_strict_mode(True)
    yield
    rerun.set_strict_mode(False)


@pytest.fixture(scope="session")
def rows_by_entity() -> Callable[[Any], dict[str, Rows]]:
    """Give all rows of chunks by entity, times as int nanoseconds; static rows have no times."""

    def rows(chunks: Any) -> dict[str, Rows]:
        found: dict[str, Rows] = defaultdict(list)
        for chunk in chunks:
            table = pl.from_arrow(chunk.to_record_batch())
            assert isinstance(table, pl.DataFrame)
            times = [name for name in ("time", "scenario_time") if name in table.columns]
            found[chunk.entity_path] += table.with_columns(pl.col(times).cast(pl.Int64)).to_dicts()
        return dict(found)

    return rows


@pytest.fixture(scope="session")
def rrd(synthetic_result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The view of `synthetic_result` in a file."""
    from istc_replay.export.rerun_view import write_view

    path = tmp_path_factory.mktemp("view") / "view.rrd"
    write_view(synthetic_result, ViewConfig(), path)
    return path


@pytest.fixture(scope="session")
def entities(rrd: Path, rows_by_entity: Callable[[Any], dict[str, Rows]]) -> dict[str, Rows]:
    """All rows of the file by entity."""
    from rerun.chunk import RrdReader

    return rows_by_entity(RrdReader(rrd).stream().to_chunks())


@pytest.fixture
def view_of(
    rows_by_entity: Callable[[Any], dict[str, Rows]], strict_rerun: None
) -> Callable[[Result], dict[str, Rows]]:
    """Give the rows by entity of a result's view."""
    from istc_replay.export.rerun_view import view_chunks

    return lambda result: rows_by_entity(view_chunks(result, ViewConfig()))
