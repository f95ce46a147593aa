"""Memory does not grow with the windows of a log or a result, but for what is recorded and told of each."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.datatypes import Certificate, Log, StaticScene, WindowPlan
from istc_replay.export.sample_log import sample_bytes
from istc_replay.samples.drive import RecordedScene

from ..support.results import repeated_bytes
from ..support.tracks import track

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="peak memory is told in other units"),
]
_HORIZON_S = 8.0


def peak_mb(*arguments: str | Path) -> int:
    """The peak memory of a command, run as its users do."""
    command = [Path(sys.executable).with_name("istc-replay"), *map(str, arguments)]
    process = subprocess.Popen(
        command, env={**os.environ, "OMP_NUM_THREADS": "1"}, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    assert process.stderr is not None
    told = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    process.stderr.close()
    assert process.returncode in (0, 1), told  # 1: the audit found something
    return int(usage.ru_maxrss // 1024)


def traffic(windows: int) -> pl.DataFrame:
    """Eight cars, each on a lane of its own, four of them new in each window."""
    tables = []
    for name in range(4 * windows + 4):
        start_s = max(0.0, (name // 4 - 1) * _HORIZON_S)
        end_s = min((name // 4 + 1) * _HORIZON_S, windows * _HORIZON_S)
        times = np.arange(round(start_s * 10), round(end_s * 10) + 1) / 10.0
        x_m = 12.0 * (times - start_s)
        lane = {"y_m": 8.0 * (name % 8), "speed_mps": 12.0, "length_m": 4.5, "width_m": 1.8}
        tables.append(track(str(name), times, x_m=x_m, **lane))
    return pl.concat(tables)


@pytest.fixture(scope="module")
def result_of(
    synthetic_plan: tuple[Log, list[WindowPlan]],
    synthetic_certificates: list[Certificate],
    synthetic_summary: dict[str, Any],
    tmp_path_factory: pytest.TempPathFactory,
) -> Callable[[int], Path]:
    """Give a result of so many windows with three vehicles each; 460 states a window."""
    folder = tmp_path_factory.mktemp("results")
    log, (plan,) = synthetic_plan

    def made(windows: int) -> Path:
        path = folder / f"{windows}" / "result.mcap"
        if not path.exists():
            path.parent.mkdir()
            path.write_bytes(repeated_bytes(log, plan, synthetic_certificates, synthetic_summary, windows))
        return path

    return made


@pytest.mark.parametrize("command", ["audit", "export", "compare"])
def test_a_result_of_five_times_the_windows_takes_hardly_more(
    command: str, result_of: Callable[[int], Path], tmp_path: Path
) -> None:
    peaks = []
    for windows in (100, 500):
        result = result_of(windows)
        sources = [result, result] if command == "compare" else [result]
        formats = ["--format", "parquet"] if command != "compare" else []
        peaks.append(peak_mb(command, *sources, "-o", tmp_path / str(windows), *formats))
    print(command, peaks)
    assert peaks[1] - peaks[0] < 100


def test_a_log_of_three_times_the_windows_takes_hardly_more(tmp_path: Path) -> None:
    (tmp_path / "fast.toml").write_text('corridors.mode = "fast"\n')
    peaks = []
    for windows in (48, 144):
        log = tmp_path / f"{windows}.mcap"
        log.write_bytes(sample_bytes(RecordedScene("long", StaticScene(), traffic(windows))))
        peaks.append(peak_mb("run", log, "-c", tmp_path / "fast.toml", "-o", tmp_path / "results"))
    print("run", peaks)
    assert peaks[1] - peaks[0] < 100
