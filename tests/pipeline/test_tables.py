"""Exports of a log or a result: tables, and the layout that shows a result elsewhere."""

from __future__ import annotations

import json
from pathlib import Path

import polars as pl
import pytest

from istc_replay.config import Config
from istc_replay.errors import UsageError
from istc_replay.export.foxglove_layout import foxglove_layout
from istc_replay.ingest.result import load_result_folder
from istc_replay.pipeline.tables import LAYOUT, export_files

from ..support.commands import TURN_FIRST


@pytest.fixture
def result(synthetic_bytes: bytes, tmp_path: Path) -> Path:
    """A result's file."""
    path = tmp_path / "result.mcap"
    path.write_bytes(synthetic_bytes)
    return path


def test_a_layout_alone_is_what_foxglove_gets_of_the_result(result: Path, tmp_path: Path) -> None:
    whole, files = export_files(result, tmp_path / "out", ["foxglove"], Config())
    assert whole
    assert files == [tmp_path / "out" / LAYOUT]
    assert list((tmp_path / "out").iterdir()) == files
    expected = foxglove_layout([load_result_folder(result).states])
    assert json.loads(files[0].read_text(encoding="utf-8")) == json.loads(json.dumps(expected))


def test_a_layout_goes_beside_the_tables(result: Path, tmp_path: Path) -> None:
    _, files = export_files(result, tmp_path / "out", ["foxglove", "parquet"], Config())
    assert files[-1].name == LAYOUT
    tables = {file.stem for file in files[:-1]}
    assert {"states", "corridors", "obstacles", "solves", "certificates", "findings", "coverage"} <= tables
    states = pl.read_parquet(tmp_path / "out" / "states.parquet")
    assert set(states["source"]) == {"recorded", "planned", "guidance"}


def test_a_log_has_tables_and_no_layout(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="a layout fits a result, not a log"):
        export_files(TURN_FIRST, tmp_path / "out", ["foxglove", "csv"], Config())
    assert not (tmp_path / "out").exists()
    whole, files = export_files(TURN_FIRST, tmp_path / "out", ["csv"], Config())
    assert whole
    assert {file.suffix for file in files} == {".csv"}
