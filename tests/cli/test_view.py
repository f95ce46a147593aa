"""`istc-replay view`, `run --view`, and a run that is interrupted."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

Command = Callable[..., "subprocess.CompletedProcess[str]"]
ROOT = Path(__file__).resolve().parents[2]
LOG = ROOT / "sample_logs" / "intersection_turn_first.mcap"
#: Settings that cut the sample into four windows and plan them fast.
CUT = "[window]\nwhole_log_s = 4.0\nhorizon_s = 4.0\nstride_s = 3.0\n[corridors]\nmode = 'fast'\n"


@pytest.fixture
def result(synthetic_bytes: bytes, tmp_path: Path) -> Path:
    """A result.mcap alone in its folder."""
    path = tmp_path / "result.mcap"
    path.write_bytes(synthetic_bytes)
    return path


@pytest.fixture
def screenless(monkeypatch: pytest.MonkeyPatch) -> None:
    """No screen to open a window on."""
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)


def test_view_saves_the_view_of_a_result(call: Command, result: Path, tmp_path: Path) -> None:
    out = tmp_path / "again.rrd"
    done = call("view", result, "--save", out, "--focus", "car 2")
    assert (done.returncode, done.stderr) == (0, "")
    assert out.stat().st_size > 10_000


def test_view_without_a_screen_says_what_to_do(call: Command, result: Path, screenless: None) -> None:
    done = call("view", result)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert all(way in done.stderr for way in ("--save", "--bundle", "--web"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--web", "--save", "v.rrd"], "give one of"),
        (["--save", "v.rrd", "--at", "2"], "does not say where it opens"),
        (["--at", "77"], "it holds 0 to 6 s"),
        (["--focus", "car <b>\n9"], "no such vehicle; there are car 1, car 2, car 3"),
        (["--finding", "zz"], "no such finding"),
        (["--connect", "rerun+http://127.0.0.1:9/proxy"], "no viewer answers"),
    ],
)
def test_what_cannot_be_shown_is_one_line(
    call: Command, result: Path, tmp_path: Path, options: list[str], words: str
) -> None:
    done = call("view", result, *options, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_a_run_without_a_screen_goes_on_unwatched(call: Command, tmp_path: Path, screenless: None) -> None:
    config = tmp_path / "c.toml"
    config.write_text("[corridors]\nmode = 'fast'\n")
    done = call("run", LOG, "-o", tmp_path / "out", "-c", config, "--view")
    assert done.returncode == 0
    assert "not watched: there is no screen" in done.stderr
    assert done.stderr.count("\n") == 1
    assert (tmp_path / "out" / LOG.stem / "view.rrd").stat().st_size > 10_000


@pytest.mark.slow
def test_an_interrupted_run_keeps_the_windows_that_are_done(call: Command, tmp_path: Path) -> None:
    config, out = tmp_path / "c.toml", tmp_path / "out"
    config.write_text(CUT)
    command = [sys.executable, "-c", "from istc_replay.cli import main; main()", "run", str(LOG)]
    process = subprocess.Popen(
        [*command, "-o", str(out), "-c", str(config)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )

    def kept() -> list[Path]:
        return [path for path in out.glob("*/.istc-work-*/*") if not path.name.startswith(".")]

    try:
        deadline = time.monotonic() + 120.0
        while not kept() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        printed, errors = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 130, errors
    assert "what was finished is kept" in errors
    assert len(errors.split("\n")) <= 3  # the terminal's ^C gets a line of its own
    assert printed == ""
    assert kept()
    assert not list(out.glob("*/result.mcap"))  # an output exists whole or not at all
    again = call("run", LOG, "-o", out, "-c", config)
    alone = call("run", LOG, "-o", tmp_path / "alone", "-c", config)
    assert again.returncode == alone.returncode
    results = [folder / LOG.stem / "result.mcap" for folder in (out, tmp_path / "alone")]
    assert results[0].read_bytes() == results[1].read_bytes()
    assert not kept()
