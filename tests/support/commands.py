"""Commands as a user calls them, on sample logs and on logs that are altered."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import polars as pl

from istc_replay.export.sample_log import sample_bytes
from istc_replay.samples.scenes import find_sample

Command = Callable[..., "subprocess.CompletedProcess[str]"]

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = sorted((ROOT / "sample_logs").glob("*.mcap"))
TURN_FIRST = ROOT / "sample_logs" / "intersection_turn_first.mcap"
#: Fast mode: the proof has its own tests.
FAST = '[corridors]\nmode = "fast"\n'


def expect_failure(done: subprocess.CompletedProcess[str], code: int, *words: str) -> None:
    """One line on stderr that says so, the right exit code, and no traceback."""
    assert done.returncode == code, (done.stdout, done.stderr)
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    for word in words:
        assert word in lines[0]


def altered(tmp_path: Path, change: Callable[[pl.DataFrame], pl.DataFrame]) -> Path:
    """The intersection as a log whose recorded states were changed."""
    recorded = find_sample("intersection_turn_first").record()
    path = tmp_path / "altered.mcap"
    path.write_bytes(sample_bytes(replace(recorded, states=change(recorded.states))))
    (tmp_path / "fast.toml").write_text(FAST)
    return path


def run_fast(call: Command, log: Path) -> subprocess.CompletedProcess[str]:
    """Run a log in fast mode, results beside it."""
    return call("run", log, "-c", log.parent / "fast.toml", "-o", log.parent / "out")
