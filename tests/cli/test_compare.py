"""`istc-replay compare` as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from istc_replay.config import parse_config
from istc_replay.pipeline.replay import replay_log

from ..support.commands import Command

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def results(synthetic_bytes: bytes, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two results of different logs."""
    folder = tmp_path_factory.mktemp("results")
    replayed = replay_log(
        ROOT / "sample_logs" / "intersection_turn_first.mcap", parse_config('[corridors]\nmode = "fast"\n')
    )
    for name, data in (("one", synthetic_bytes), ("two <b>", replayed.mcap)):
        (folder / name).mkdir()
        (folder / name / "result.mcap").write_bytes(data)
    return folder / "one", folder / "two <b>"


def test_a_result_beside_itself_says_that_nothing_differs(call: Command, results: tuple[Path, Path]) -> None:
    done = call("compare", results[0], results[0] / "result.mcap")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "Nothing differs: the two results are the same.\n"


def test_page_view_and_facts_of_two_results_are_written(
    call: Command, results: tuple[Path, Path], tmp_path: Path
) -> None:
    done = call("compare", *results, "-o", tmp_path / "out")
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert "6 vehicles are in one of the two alone" in lines[0]
    assert any(line.startswith("only in A: vehicle car 1, car 2") for line in lines)
    files = [Path(line) for line in lines[-3:]]
    assert [file.name for file in files] == ["compare.html", "compare.json", "compare.rrd"]
    page = files[0].read_text(encoding="utf-8")
    assert "two &lt;b&gt;" in page
    assert "<b>" not in page
    facts = json.loads(files[1].read_text())
    assert (facts["same"], facts["vehicles_only_b"]) == (False, ["1", "2", "3"])


def test_json_tells_the_same_on_stdout(call: Command, results: tuple[Path, Path]) -> None:
    done = call("compare", *results, "--json")
    facts = json.loads(done.stdout)
    assert facts["schema"] == "istc-replay.comparison.v1"
    assert {change["key"] for change in facts["settings"]} >= {"corridors.mode"}


def test_a_log_is_no_result(call: Command, results: tuple[Path, Path]) -> None:
    done = call("compare", results[0], ROOT / "sample_logs" / "dense_4.mcap")
    assert done.returncode == 3
    assert "not a result" in done.stderr
    assert done.stderr.count("\n") == 1
