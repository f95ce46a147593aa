"""Windows of a long log: cut anyhow, planned anywhere, stopped at any time, the result is the same."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from istc_replay.config import parse_config
from istc_replay.datatypes import Log, StaticScene, WindowOutcome
from istc_replay.errors import LogError, ScenarioError
from istc_replay.export.sample_log import sample_bytes
from istc_replay.ingest.log import read_log
from istc_replay.pipeline.assembly import assemble
from istc_replay.pipeline.replay import replay_read
from istc_replay.pipeline.run import run_log
from istc_replay.pipeline.windows import plan_windows
from istc_replay.pipeline.work_folder import WorkFolder, clear_work, packed, unpacked
from istc_replay.plain import from_plain, to_plain
from istc_replay.safety.certificate import certify
from istc_replay.samples.drive import RecordedScene
from istc_replay.windows import log_parts, window_spans

from ..support.tracks import log_of, track

TOML = """
corridors.mode = "fast"
window = { horizon_s = 3.0, stride_s = 3.0, unit_s = 0.5 }
"""
CONFIG = parse_config(TOML)


def long_log() -> Log:
    """Four cars on three lanes for 12 s; one enters late, one leaves early."""
    tracks = []
    for name, lane, ahead, speed, first, last in (
        ("1", 0.0, 0.0, 12.0, 0.0, 12.0),
        ("2", 3.6, 4.0, 11.0, 0.0, 12.0),
        ("3", 0.2, 20.0, 10.6, 0.0, 7.0),
        ("4", 7.0, -3.0, 13.0, 4.3, 12.0),
    ):
        times = np.arange(round(first * 10), round(last * 10) + 1) / 10.0
        places = {"x_m": ahead + speed * times, "y_m": lane + 0.1 * np.sin(times)}
        motion = {"heading_rad": 0.1 * np.cos(times) / speed, "speed_mps": speed}
        tracks.append(track(name, times, **places, **motion, length_m=4.5, width_m=1.8))
    return log_of(*tracks)


@pytest.fixture(scope="module")
def outcomes() -> list[WindowOutcome]:
    """The windows of the long log, planned in turn."""
    return plan_windows(long_log(), CONFIG)


def test_any_number_of_processes_gives_the_same_bytes(outcomes: list[WindowOutcome]) -> None:
    apart = replay_read(long_log(), CONFIG, jobs=2)
    assert apart.mcap == assemble(long_log(), CONFIG, outcomes).mcap
    assert [w["status"] for w in apart.summary["windows"]] == ["certified"] * 4


def test_windows_planned_elsewhere_are_joined_to_the_same_bytes(outcomes: list[WindowOutcome]) -> None:
    whole = assemble(long_log(), CONFIG, outcomes).mcap
    pieces = [
        packed(outcome)
        for indices in ([2, 3], [0], [1])
        for outcome in plan_windows(long_log(), CONFIG, indices)
    ]
    back = sorted(
        (unpacked(piece) for piece in pieces), key=lambda outcome: outcome.plan.scenario.window.index
    )
    assert assemble(long_log(), CONFIG, back).mcap == whole


def test_certificates_of_windows_are_those_of_the_whole_result(outcomes: list[WindowOutcome]) -> None:
    result = assemble(long_log(), CONFIG, outcomes).result
    assert certify(result, parse_config(result.config_toml)) == tuple(
        c for o in outcomes for c in o.certificates
    )


def test_a_part_holds_what_its_window_needs_and_no_more() -> None:
    log = long_log()
    parts = list(log_parts(log, CONFIG))
    assert [part.span for part in parts] == window_spans(log, CONFIG)
    for part in parts:
        start_ns, length_ns, _ = part.span
        times = part.states["time_ns"]
        assert start_ns - 10**9 <= times.min() <= start_ns  # type: ignore[operator]
        assert times.max() <= start_ns + length_ns + 10**9  # type: ignore[operator]
        assert part.states["vehicle_id"].is_sorted()
    with pytest.raises(ScenarioError, match="no window 9; it has 4"):
        list(log_parts(log, CONFIG, [9]))


def test_a_damaged_window_is_told_and_names_no_code() -> None:
    with pytest.raises(LogError, match="not a stored window"):
        unpacked(b"nonsense")
    for value in ({"kind": "Popen", "fields": {}}, {"kind": "array", "shape": [3], "data": "AA=="}, {"a": 1}):
        with pytest.raises(LogError, match="not a stored plan"):
            from_plain(value)
    with pytest.raises(TypeError, match="no type of the data"):
        to_plain(Path("x"))


#: A run that is killed, by nothing that it could catch, when so many windows are done.
KILLED = """
import os, signal, sys
from pathlib import Path
from istc_replay.config import parse_config
from istc_replay.pipeline.run import run_log

def told(_what, done, _total):
    if done == 2:
        os.kill(os.getpid(), signal.SIGKILL)

log, folder, config = sys.argv[1:]
run_log(Path(log), Path(folder), parse_config(config), told)
"""


def test_a_killed_run_goes_on_where_it_was(tmp_path: Path) -> None:
    log, folder = tmp_path / "long.mcap", tmp_path / "out"
    log.write_bytes(sample_bytes(RecordedScene("long", StaticScene(), long_log().states)))
    command = [sys.executable, "-c", KILLED, str(log), str(folder), TOML]
    killed = subprocess.run(command, env={**os.environ, "OMP_NUM_THREADS": "1"}, check=False)
    assert killed.returncode == -signal.SIGKILL
    assert not (folder / "result.mcap").exists()
    assert len(list(folder.glob(".istc-work-*/[0-9]*.zst"))) == 2
    seen: list[int] = []
    done = run_log(log, folder, CONFIG, lambda _what, windows, _total: seen.append(windows))
    assert seen[:2] == [0, 2]  # read, and then no window anew
    assert done.mcap == replay_read(read_log(log, CONFIG), CONFIG).mcap
    assert done.mcap == (folder / "result.mcap").read_bytes()
    assert not list(folder.glob(".istc-work-*"))


def test_what_another_configuration_kept_is_not_taken(tmp_path: Path, outcomes: list[WindowOutcome]) -> None:
    mine, other = (WorkFolder(tmp_path, "0" * 64, toml, {"a": "1"}) for toml in ("x = 1", "x = 2"))
    mine.save(outcomes[1])
    assert mine.holds(1)
    assert not mine.holds(0)
    assert not other.holds(1)
    next(tmp_path.glob("*/*.zst")).write_bytes(b"torn")
    assert not mine.holds(1)
    with pytest.raises(LogError, match="not a stored window"):
        mine.load(1)
    clear_work(tmp_path)
    assert not list(tmp_path.iterdir())
