"""The view in Rerun's own viewer, drawn in software without a screen."""

from __future__ import annotations

import io
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest

from istc_replay.export.colours import vehicle_colours

pytestmark = pytest.mark.slow

_START_S = 30.0


@pytest.fixture(scope="module")
def viewer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A client of a headless viewer; skips where the machine cannot draw."""
    from rerun.experimental import ViewerClient

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    log = tmp_path_factory.mktemp("viewer") / "log.txt"
    command = [sys.executable, "-m", "rerun_cli", "--headless", "--bind", "127.0.0.1", "--port", str(port)]
    command += ["--window-size", "1600x1000", "--hide-welcome-screen", "--memory-limit", "1GB"]
    with log.open("w") as out:
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, start_new_session=True)
    try:
        yield _connected(ViewerClient, f"rerun+http://127.0.0.1:{port}/proxy", process, log)
    finally:
        _stop(process)


def _connected(client: Any, url: str, process: subprocess.Popen[bytes], log: Path) -> Any:
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline and process.poll() is None:
        try:
            found = client.connect(url)
            found.get_state()
        except Exception:  # whatever it is, the viewer is not up yet
            time.sleep(0.3)
        else:
            return found
    words = log.read_text(errors="replace").strip().splitlines() or ["no word"]
    return pytest.skip(f"Rerun's viewer does not start here (no Vulkan in software?): {words[-1]}")


def _stop(process: subprocess.Popen[bytes]) -> None:
    try:
        os.killpg(process.pid, signal.SIGTERM)
    except ProcessLookupError:
        return
    process.wait(timeout=20)


def _picture(viewer: Any, seconds: float) -> np.ndarray:
    viewer.set_time("scenario_time", duration=seconds, play_state="paused")
    picture = np.empty(0)
    for _ in range(10):  # the first frames still load
        time.sleep(0.5)
        before, picture = picture, matplotlib.image.imread(io.BytesIO(viewer.take_screenshot()))[..., :3]
        if before.shape == picture.shape and np.abs(before - picture).mean() < 1e-4:
            break
    return picture


def test_the_viewer_shows_every_view_without_complaint(viewer: Any, rrd: Path) -> None:
    viewer.open(str(rrd))
    early, late = _picture(viewer, 0.5), _picture(viewer, 4.5)
    state = viewer.get_state()
    assert not state.loading
    (recording,) = state.recordings
    assert {timeline.name for timeline in recording.timelines} == {"time", "scenario_time", "time_unit"}
    assert recording.current_timeline == "scenario_time"
    assert len(state.views) > 15
    assert not [(view.name, view.reports) for view in state.views if view.reports]
    complaints = [entry for entry in viewer.get_logs() if entry.level in ("WARN", "ERROR")]
    assert not [entry for entry in complaints if "asterizer" not in entry.message]
    assert early.std() > 0.05  # not blank
    assert np.abs(early - late).mean() > 1e-3  # the replay moves


def test_the_vehicles_show_in_their_colours(viewer: Any, rrd: Path) -> None:
    viewer.open(str(rrd))
    picture = _picture(viewer, 3.0)
    for colour in vehicle_colours(("car 1", "car 2", "car 3")).values():
        distance = np.abs(picture - np.array(colour) / 255.0).max(axis=-1)
        assert (distance < 0.08).sum() > 100
