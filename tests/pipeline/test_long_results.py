"""Long results are judged and written as tables part by part: to the same tables as the whole."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Literal

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from istc_replay.config import Config
from istc_replay.pipeline import reading
from istc_replay.pipeline.audit import audit_path
from istc_replay.pipeline.tables import export_tables
from istc_replay.safety.log_audit import Audit

TABLES = [field.name for field in fields(Audit) if field.name not in ("log", "config", "origin_ns")]


@pytest.fixture
def folder(long_bytes: bytes, tmp_path: Path) -> Path:
    """A result of five windows."""
    (tmp_path / "result.mcap").write_bytes(long_bytes)
    return tmp_path


def test_an_audit_in_parts_is_that_of_the_whole(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = audit_path(folder)
    monkeypatch.setattr(reading, "PART_WINDOWS", 2)
    parts = audit_path(folder)
    assert whole.certificates["window"].unique().to_list() == [0, 1, 2, 3, 4]
    assert whole.against_plan.height == 15
    for name in TABLES:
        assert_frame_equal(getattr(parts, name), getattr(whole, name))
    assert_frame_equal(parts.log.states, whole.log.states)
    assert (parts.origin_ns, parts.verdict) == (whole.origin_ns, whole.verdict)


@pytest.mark.parametrize("kind", ["parquet", "csv"])
def test_tables_written_in_parts_are_those_of_the_whole(
    folder: Path, monkeypatch: pytest.MonkeyPatch, kind: Literal["parquet", "csv"]
) -> None:
    export_tables(folder, folder / "whole", [kind], Config())
    monkeypatch.setattr(reading, "PART_WINDOWS", 2)
    _, files = export_tables(folder, folder / "parts", [kind], Config())
    assert {file.name for file in (folder / "parts").iterdir()} == {file.name for file in files}
    for file in files:
        other = folder / "whole" / file.name
        if kind == "csv":
            assert file.read_bytes() == other.read_bytes(), file.name
        else:
            assert_frame_equal(pl.read_parquet(file), pl.read_parquet(other))
