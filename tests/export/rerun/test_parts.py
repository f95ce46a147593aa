"""The view of a long result, made part by part, shows what the view of the whole shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from rerun.chunk import RrdReader

from istc_replay.config import ViewConfig
from istc_replay.datatypes import Result
from istc_replay.export.rerun import view as rerun_view
from istc_replay.export.rerun.view import write_view
from istc_replay.ingest.result import read_result
from istc_replay.ingest.result_states import result_parts

Rows = dict[str, list[dict[str, Any]]]


_NAMED = "Boxes3D:show_labels"


def shown(rows: list[dict[str, Any]]) -> set[str]:
    """What rows show, whatever chunks they came in: without clears, and who is named."""
    told = [{k: v for k, v in row.items() if "RowId" not in k and v is not None} for row in rows]
    return {str(row) for row in told if not any(k in row for k in ("Clear:is_recursive", _NAMED))}


@pytest.fixture(scope="module")
def both(
    long_bytes: bytes, tmp_path_factory: pytest.TempPathFactory, rows_by_entity: Callable[[Any], Rows]
) -> tuple[Rows, Rows]:
    """The rows of the whole's view, and of that in parts of two windows."""
    folder = tmp_path_factory.mktemp("parts")
    whole, head = read_result(long_bytes), read_result(long_bytes, states=False)
    parts: Callable[[], Iterator[Result]] = partial(result_parts, long_bytes, head, 2)
    write_view(whole, ViewConfig(), folder / "whole.rrd")
    write_view(head, ViewConfig(), folder / "parts.rrd", parts=parts)
    one, two = (
        rows_by_entity(RrdReader(folder / name).stream().to_chunks()) for name in ("whole.rrd", "parts.rrd")
    )
    return one, two


def test_it_has_the_same_entities(both: tuple[Rows, Rows]) -> None:
    assert set(both[0]) == set(both[1])


def test_every_row_of_the_whole_is_there(both: tuple[Rows, Rows]) -> None:
    whole, parts = both
    differ = {path for path in whole if not shown(whole[path]) <= shown(parts[path])}
    assert differ == set()


def test_nothing_else_is_shown(both: tuple[Rows, Rows]) -> None:
    whole, parts = both
    more = {path: shown(parts[path]) - shown(whole[path]) for path in parts}
    # What a vehicle does is told again where a part begins.
    assert {path for path, rows in more.items() if rows and not path.startswith("/states/")} == set()


def test_what_holds_at_all_times_is_said_once(both: tuple[Rows, Rows]) -> None:
    whole, parts = both
    for path, rows in parts.items():
        still = [row for row in rows if row.get("time") is None]
        assert len(still) == len([row for row in whole[path] if row.get("time") is None]), path


def test_a_full_disk_is_told(
    synthetic_result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rerun_view, "atomic_file", lambda _: _full())
    with pytest.raises(OSError, match="No space left"):
        write_view(synthetic_result, ViewConfig(), tmp_path / "view.rrd")


class _full:  # noqa: N801
    def __enter__(self) -> Path:
        return Path("/dev/full")

    def __exit__(self, *_: object) -> None:
        pass
