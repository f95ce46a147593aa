"""What the commands share: lists of formats, and progress on a terminal."""

from __future__ import annotations

import sys

import click
import pytest

from istc_replay.cli import common
from istc_replay.cli.common import Progress, chosen_formats


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that progress sees [s], to be set by a test."""
    now = [100.0]
    monkeypatch.setattr(common.time, "monotonic", lambda: now[0])
    return now


def on_terminal(name: str, monkeypatch: pytest.MonkeyPatch) -> Progress:
    """Progress that believes that stderr is a terminal."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    return Progress(name)


def shown(capsys: pytest.CaptureFixture[str]) -> str:
    """What stands on the terminal's line after all that was written."""
    return capsys.readouterr().err.split("\r\x1b[K")[-1]


def test_windows_are_counted_with_their_rate_and_what_is_left(
    monkeypatch: pytest.MonkeyPatch, clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    progress = on_terminal("a.mcap", monkeypatch)
    progress("corridors", 0, 1)
    assert shown(capsys) == "a.mcap: corridors"
    progress("corridors", 4, 10)
    assert shown(capsys) == "a.mcap: window 5 of 10: corridors"
    clock[0] += 6.0
    progress("trajectories", 6, 10)  # two windows in six seconds
    assert shown(capsys) == "a.mcap: window 7 of 10: trajectories, 20 windows/min, 12 s left"
    progress("view", 10, 10)
    assert shown(capsys) == "a.mcap: window 10 of 10: view"


def test_a_file_is_read_with_a_bar_that_is_not_drawn_too_often(
    monkeypatch: pytest.MonkeyPatch, clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    progress = on_terminal("a.mcap", monkeypatch)
    clock[0] += 2.0
    progress.bytes(2**20, 4 * 2**20)
    assert shown(capsys) == "a.mcap: [########......................]  25% 0 MiB/s, 6 s left"
    clock[0] += 0.05
    progress.bytes(2 * 2**20, 4 * 2**20)
    assert shown(capsys) == ""
    clock[0] += 0.1
    progress.bytes(4 * 2**20, 4 * 2**20)
    assert "100%" in shown(capsys)


def test_the_line_goes_when_all_is_done_and_names_are_not_obeyed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with on_terminal("a\x1b[31m\nb", monkeypatch) as progress:
        progress("ingest", 0, 1)
        told = capsys.readouterr().err
    assert "b: ingest" in told
    assert "\n" not in told
    assert "\x1b[31m" not in told
    assert capsys.readouterr().err == "\r\x1b[K"


def test_where_there_is_no_terminal_it_is_silent(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("a.mcap") as progress:
        progress("ingest", 0, 3)
        progress.bytes(1, 2)
    assert capsys.readouterr().err == ""


def test_formats_are_given_in_their_own_order_and_unknown_ones_refused() -> None:
    assert chosen_formats("csv, parquet,csv", ["parquet", "csv"]) == ["parquet", "csv"]
    with pytest.raises(click.UsageError, match="'xls' is not one of parquet, csv"):
        chosen_formats("csv,xls", ["parquet", "csv"])
