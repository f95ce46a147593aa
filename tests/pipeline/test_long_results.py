"""Long results are judged and written as tables part by part: to the same tables as the whole."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal

import polars as pl
import pytest
from polars.testing import assert_frame_equal
from rerun.chunk import RrdReader

from istc_replay.comparison.compare import compare_results
from istc_replay.config import Config
from istc_replay.datatypes import Certificate, Log, WindowPlan
from istc_replay.ingest.result import read_result
from istc_replay.pipeline import reading
from istc_replay.pipeline.audit import audit_path
from istc_replay.pipeline.compare import compare_read
from istc_replay.pipeline.reading import read_in_parts
from istc_replay.pipeline.tables import export_tables
from istc_replay.safety.log_audit import Audit

from ..support.results import repeated_bytes

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


def test_a_comparison_in_parts_is_that_of_the_whole(
    folder: Path,
    synthetic_plan: tuple[Log, list[WindowPlan]],
    synthetic_certificates: list[Certificate],
    synthetic_summary: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log, (plan,) = synthetic_plan
    moved = replace(log, states=log.states.with_columns(pl.col("y_m") + 1.0))
    other = repeated_bytes(moved, plan, synthetic_certificates, synthetic_summary, 5)
    (folder / "other.mcap").write_bytes(other)
    whole, _ = compare_read(folder / "result.mcap", folder / "other.mcap", folder / "whole")
    monkeypatch.setattr(reading, "PART_WINDOWS", 2)
    parts, _ = compare_read(folder / "result.mcap", folder / "other.mcap", folder / "parts")
    assert parts == whole
    assert [window.index for window in whole.windows] == [0, 1, 2, 3, 4]
    for name in ("compare.html", "compare.json"):
        assert (folder / "parts" / name).read_bytes() == (folder / "whole" / name).read_bytes()
    one, two = (
        {chunk.entity_path for chunk in RrdReader(folder / name / "compare.rrd").stream().to_chunks()}
        for name in ("whole", "parts")
    )
    assert one == two
    assert any(path.startswith("/b/now/planned/box/") for path in one)


def test_windows_that_one_alone_has_do_not_keep_the_others_waiting(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    head = read_result(folder / "result.mcap")
    fewer = replace(head, summary=head.summary | {"windows": head.summary["windows"][1::2]})
    monkeypatch.setattr(reading, "PART_WINDOWS", 1)
    parts = read_in_parts(folder / "result.mcap")
    found = compare_results(fewer, parts.result, None, parts.each())
    assert found.windows_only_b == (0, 2, 4)
    assert found.windows == ()
