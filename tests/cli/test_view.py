"""`istc-replay view` as a user calls it."""

from __future__ import annotations

from pathlib import Path

import pytest

from ..support.commands import TURN_FIRST, Command, expect_failure


def test_view_saves_the_view_of_a_result(call: Command, result: Path, tmp_path: Path) -> None:
    out = tmp_path / "again.rrd"
    assert call("view", result / "result.mcap", "--save", out).returncode == 0
    assert out.stat().st_size > 10_000


def test_view_without_a_screen_says_what_to_do(
    call: Command, result: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    done = call("view", result)
    assert done.returncode == 2
    assert "--save" in done.stderr


def test_a_log_is_no_result(call: Command, tmp_path: Path) -> None:
    expect_failure(call("view", TURN_FIRST, "--save", tmp_path / "v.rrd"), 3, "not a result")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--save", "v.rrd", "--bundle", "site"], "give one of --web, --save, --bundle and --connect"),
        (["--save", "v.rrd", "--at", "2"], "does not say where it opens; use --bundle or --web"),
    ],
)
def test_a_view_goes_to_one_place_that_can_hold_all_that_is_asked_for(
    call: Command, tmp_path: Path, options: list[str], words: str
) -> None:
    expect_failure(call("view", tmp_path / "result.mcap", *options), 2, words)
