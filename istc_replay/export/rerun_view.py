"""The Rerun view of a result: recorded and planned in one recording, with its layout.

The view is a pure function of the result; the file is a cache that can be made from the result
again, since Rerun promises to read a file only in the version after the one that wrote it.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path, PurePath

import rerun as rr
from rerun.chunk import Chunk

from istc_replay.config import ViewConfig, parse_config
from istc_replay.datatypes import Result
from istc_replay.errors import ExportError
from istc_replay.export.atomic import atomic_file
from istc_replay.export.rerun_blueprint import blueprint
from istc_replay.export.rerun_chunks import label
from istc_replay.export.rerun_clearance import clearances
from istc_replay.export.rerun_now import now_chunks
from istc_replay.export.rerun_plots import plot_chunks
from istc_replay.export.rerun_space_time import space_time_chunks
from istc_replay.export.rerun_stage import make_stage
from istc_replay.export.rerun_text import event_chunks, report_chunks
from istc_replay.ingest.result import load_result_folder

APPLICATION_ID = "istc-replay"


def view_chunks(result: Result, config: ViewConfig) -> list[Chunk]:
    """Lay a result out as chunks of a Rerun recording.

    Entities: `/space_time` corridors and trajectories in (x, y, t), `/now` the replay on the
    present plane, `/plots/<signal>/<source>/<vehicle>`, `/states`, `/precedence`, `/events`,
    `/report`, and the eyes `/camera` and `/now/camera`. Positions are relative to the first
    window's frame origin, so that single precision holds them. Timelines: `time`,
    `scenario_time` (from the first window's start) and `time_unit`.

    Raises
    ------
    ConfigError
        If the result's configuration cannot be read by this version.
    """
    stage = make_stage(result, config)
    found = clearances(stage)
    return [
        *space_time_chunks(stage),
        *now_chunks(stage),
        *plot_chunks(stage, found),
        *event_chunks(stage, found),
        *report_chunks(stage, found),
    ]


def recording_id(result: Result) -> str:
    """A run's identity: the same log planned with the same configuration has the same."""
    identity = f"{result.summary['input']['sha256']}\n{result.config_toml}"
    return hashlib.sha256(identity.encode()).hexdigest()[:32]


def view_bytes(result: Result, config: ViewConfig) -> bytes:
    """The view and its layout as the bytes of an .rrd file.

    Raises
    ------
    ConfigError
        If the result's configuration cannot be read by this version.
    """
    recording = rr.RecordingStream(
        APPLICATION_ID, recording_id=recording_id(result), make_default=False, send_properties=False
    )
    # Into memory, not to a file: Rerun's file writer fails without a word when the disk is full.
    memory = recording.memory_recording()
    rr.send_blueprint(blueprint(), make_active=False, make_default=True, recording=recording)
    rr.send_recording_name(label(PurePath(result.summary["input"]["path"]).name), recording=recording)
    rr.send_chunks(view_chunks(result, config), recording=recording)
    return bytes(memory.drain_as_bytes())


def write_view(result: Result, config: ViewConfig, path: Path) -> None:
    """Write the view and its layout as an .rrd file, whole or not at all.

    Raises
    ------
    ConfigError
        If the result's configuration cannot be read by this version.
    ExportError
        If the file cannot be written.
    """
    content = view_bytes(result, config)
    with atomic_file(path) as temporary:
        temporary.write_bytes(content)


def save_view(source: Path, path: Path) -> None:
    """Write the view of a result's folder or file as an .rrd file.

    Raises
    ------
    LogError
        If there is no readable result.
    ExportError
        If the file cannot be written.
    """
    result = load_result_folder(source)
    write_view(result, parse_config(result.config_toml, f"{source}: config.toml").view, path)


def show_view(source: Path) -> None:
    """Make the view of a result's folder or file anew, beside it, and open it in Rerun's viewer.

    Raises
    ------
    LogError
        If there is no readable result.
    ExportError
        If the view cannot be written, or there is no screen to show it on.
    """
    folder = source if source.is_dir() else source.parent
    _require_screen(folder / "view.rrd")
    save_view(source, folder / "view.rrd")
    show_native(folder / "view.rrd")


def show_native(path: Path) -> int:
    """Open an .rrd file in Rerun's own viewer, which listens on this machine alone.

    Returns
    -------
    int
        The viewer's process id; it goes on running.

    Raises
    ------
    ExportError
        If there is no screen, or the viewer does not start.
    """
    _require_screen(path)
    command = [sys.executable, "-m", "rerun_cli", str(path), "--bind", "127.0.0.1", "--port", "auto"]
    try:
        process = subprocess.Popen(  # noqa: S603
            [*command, "--memory-limit", "4GB", "--hide-welcome-screen"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError as error:
        raise ExportError(f"{path}: Rerun's viewer does not start: {error}; use --save") from None
    return process.pid


def _require_screen(path: Path) -> None:
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in screens):
        raise ExportError(
            f"{path}: there is no screen to show it on; write it with --save VIEW.rrd "
            "and open that on a machine with a screen: rerun VIEW.rrd"
        )
