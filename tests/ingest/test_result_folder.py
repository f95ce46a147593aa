"""The folder of a result, and the summary beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from polars.testing import assert_frame_equal

from istc_replay.datatypes import (
    Log,
    Result,
    WindowPlan,
)
from istc_replay.export.result_mcap import solve_times
from istc_replay.ingest.result import is_result, load_result_folder

from ..support.results import one_message

Plan = tuple[Log, list[WindowPlan]]


@pytest.fixture
def folder(
    tmp_path: Path, synthetic_plan: Plan, synthetic_bytes: bytes, synthetic_summary: dict[str, Any]
) -> Path:
    """A result's folder as run writes it."""
    (tmp_path / "result.mcap").write_bytes(synthetic_bytes)
    summary = {**synthetic_summary, "solves": solve_times(synthetic_plan[1][0])}
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    return tmp_path


@pytest.mark.parametrize("name", ["", "result.mcap"])
def test_the_summary_beside_a_result_lends_its_times(folder: Path, name: str) -> None:
    result = load_result_folder(folder / name)
    assert result.path == str(folder / "result.mcap")
    assert result.solves["wall_s"].to_list() == [0.05, 0.9, 0.02, 0.02, 0.02]
    assert result.summary["totals"]["cpu_s"] == 1.5


@pytest.mark.parametrize(
    "foreign", ['{"schema": "istc-replay.summary.v1"}', "no json", "[]", "[" * 100_000, "\udcff"]
)
def test_a_summary_of_something_else_is_left_alone(folder: Path, foreign: str) -> None:
    (folder / "summary.json").write_bytes(foreign.encode("utf-8", "surrogateescape"))
    result = load_result_folder(folder)
    assert result.solves["wall_s"].null_count() == 5
    assert "stages" not in result.summary
    assert result.summary["totals"]["windows"] == 1


def test_a_summary_of_another_run_is_left_alone(folder: Path) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps({**summary, "config_sha256": "2" * 64}))
    assert load_result_folder(folder).solves["wall_s"].null_count() == 5


@pytest.mark.parametrize("times", [[], [1.0] * 5, "x", [{"wall_s": "soon"}] * 5])
def test_times_that_do_not_fit_the_solves_are_not_used(folder: Path, times: Any) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps({**summary, "solves": times}))
    assert load_result_folder(folder).solves["wall_s"].null_count() == 5


def test_a_result_without_a_summary_beside_it_is_read(folder: Path, synthetic_result: Result) -> None:
    (folder / "summary.json").unlink()
    assert_frame_equal(load_result_folder(folder).states, synthetic_result.states)


def test_a_result_is_told_from_a_log(folder: Path) -> None:
    (folder / "log.mcap").write_bytes(one_message("/scene", "Scene", b""))
    assert is_result(folder)
    assert is_result(folder / "result.mcap")
    assert not is_result(folder / "log.mcap")
