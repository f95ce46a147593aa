"""Rerun's own viewer: started on this machine alone, sent a view, and set to an instant."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import rerun as rr

from istc_replay.config import ViewConfig
from istc_replay.datatypes import Result
from istc_replay.errors import ExportError
from istc_replay.export.rerun.spans import Anchor
from istc_replay.export.rerun.view import (
    Opening,
    Parts,
    lay_out,
    new_recording,
    recording_id,
    send_result,
    stage_chunks,
)

LOCAL = "127.0.0.1"
#: A viewer that is not there after this long does not come [s].
_START_S = 30.0
#: A view that has not arrived after this long is not waited for [s].
_ARRIVE_S = 120.0
#: A live viewer that takes a window this slowly is given up [s].
_LIVE_S = 10.0
_MEMORY = "4GB"


def free_port() -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((LOCAL, 0))
        return int(probe.getsockname()[1])


def has_screen() -> bool:
    """Whether there is a screen that a window could open on."""
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in screens)


def rerun_command(*arguments: str) -> list[str]:
    """The command line of Rerun's own program, listening on this machine alone."""
    return [sys.executable, "-m", "rerun_cli", "--bind", LOCAL, *arguments]


def start_viewer() -> str:
    """Start a viewer with a window, which goes on running, and return its address.

    Raises
    ------
    ExportError
        If there is no screen, or the viewer does not start.
    """
    if not has_screen():
        raise ExportError(
            "there is no screen to show the view on; write it with --save VIEW.rrd or --bundle FOLDER for a "
            "machine that has one, or use --web"
        )
    port = free_port()
    command = rerun_command("--port", str(port), "--memory-limit", _MEMORY, "--hide-welcome-screen")
    with tempfile.TemporaryFile() as words:
        try:
            process = subprocess.Popen(  # noqa: S603
                command, stdin=subprocess.DEVNULL, stdout=words, stderr=words, start_new_session=True
            )
        except OSError as error:
            raise ExportError(f"Rerun's viewer does not start: {error}; use --save or --web") from None
        if not _listens(port, process):
            _end(process)
            words.seek(0)
            last = words.read().decode(errors="replace").strip().splitlines()[-1:] or ["it says nothing"]
            raise ExportError(f"Rerun's viewer does not start: {last[0][:300]}; use --save or --web")
    return f"rerun+http://{LOCAL}:{port}/proxy"


def _listens(port: int, process: subprocess.Popen[bytes]) -> bool:
    deadline = time.monotonic() + _START_S
    while time.monotonic() < deadline and process.poll() is None:
        try:
            with socket.create_connection((LOCAL, port), timeout=1.0):
                return True
        except OSError:
            time.sleep(0.1)
    return False


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the viewer and the interpreter that started it: they are a session of their own."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(timeout=10)


def connected(recording: rr.RecordingStream, url: str, opening: Opening) -> rr.RecordingStream:
    """The recording, now sent to the viewer at an address.

    Raises
    ------
    ExportError
        If no viewer answers there.
    """
    # A recording would wait for a viewer that is not there without a word.
    with _client(url) as client:
        client.get_state()
    with _refusals(url):
        recording.set_sinks(rr.GrpcSink(url), default_blueprint=opening.blueprint)
    return recording


@contextmanager
def _refusals(url: str) -> Iterator[None]:
    try:
        yield
    except (RuntimeError, ValueError) as error:
        raise ExportError(f"{url}: no viewer takes the view: {error}; is one running there?") from None


def send_view(
    result: Result,
    config: ViewConfig,
    url: str,
    opening: Opening,
    instant_ns: int | None,
    parts: Parts | None = None,
) -> None:
    """Send a result's view to a running viewer and set it to an instant.

    Parameters
    ----------
    url : str
        The viewer's address, `rerun+http://127.0.0.1:PORT/proxy`.
    instant_ns : int, optional
        Where it opens, from the first window's start; there, otherwise.
    parts : callable, optional
        As of `write_view`.

    Raises
    ------
    ExportError
        If no viewer listens there.
    """
    recording = connected(new_recording(result), url, opening)
    try:
        with _refusals(url):
            for _ in send_result(result, config, opening.focus, recording, parts):
                recording.flush(timeout_sec=_ARRIVE_S)
    finally:
        recording.disconnect()
    set_time(url, recording_id(result), instant_ns or 0)


def send_live(part: Result, config: ViewConfig, anchor: Anchor, recording: rr.RecordingStream) -> Anchor:
    """Add a window of a result that is still being made to its live recording.

    Returns
    -------
    Anchor
        With the place and the scale that the first window has set for all.

    Raises
    ------
    ExportError
        If the viewer has gone.
    """
    stage, found = lay_out(part, config, anchor=anchor)
    with _refusals("the viewer"):
        rr.send_chunks(stage_chunks(stage, found), recording=recording)
        recording.flush(timeout_sec=_LIVE_S)
    return replace(anchor, origin_m=stage.origin_m, metres_per_second=stage.metres_per_second)


def close_recording(url: str, name: str) -> None:
    """Close a recording in a viewer, if it has it."""
    with _client(url) as client:
        for recording in client.get_state().recordings:
            if recording.store_id.endswith(f":{name}"):
                client.close(store_ids=[recording.store_id])


@contextmanager
def _client(url: str) -> Iterator[Any]:
    from rerun.experimental import ViewerClient

    try:
        yield ViewerClient.connect(url)
    except Exception as error:  # the client's own kinds are not public
        raise ExportError(f"{url}: no viewer answers: {error}; is one running there?") from None


def set_time(url: str, name: str, instant_ns: int) -> None:
    """Set a viewer's time cursor once it has the recording.

    Raises
    ------
    ExportError
        If the viewer has gone.
    """
    deadline = time.monotonic() + _ARRIVE_S
    with _client(url) as client:
        while time.monotonic() < deadline:
            state = client.get_state()
            if not state.loading and _arrived(state.recordings, name):
                break
            time.sleep(0.2)
        instant = np.timedelta64(instant_ns, "ns")
        client.set_time("scenario_time", duration=instant, play_state="paused")


def _arrived(recordings: Sequence[Any], name: str) -> bool:
    return any(r.store_id.endswith(f":{name}") and r.timelines for r in recordings)
