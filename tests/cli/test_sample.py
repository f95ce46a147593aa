"""`istc-replay sample` as a user calls it."""

from __future__ import annotations

from pathlib import Path

from ..support.commands import TURN_FIRST, Command, expect_failure


def test_sample_writes_a_log_that_replays(call: Command, tmp_path: Path) -> None:
    out = tmp_path / "again.mcap"
    assert call("sample", "intersection_turn_first", out).returncode == 0
    assert out.read_bytes() == TURN_FIRST.read_bytes()


def test_an_unknown_sample_names_the_known_ones(call: Command, tmp_path: Path) -> None:
    expect_failure(call("sample", "nowhere", tmp_path / "x.mcap"), 2, "nowhere", "intersection_turn_first")
    expect_failure(call("sample", str(tmp_path / "none.json"), tmp_path / "x.mcap"), 3, "none.json")
