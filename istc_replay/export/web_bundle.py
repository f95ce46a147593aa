"""A view as a folder that any static web server shows, offline: Rerun's web viewer beside the data."""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import subprocess
import time
import urllib.error
import urllib.request
from importlib import resources
from pathlib import Path

from istc_replay.config import ViewConfig
from istc_replay.datatypes import Result
from istc_replay.errors import ExportError
from istc_replay.export.atomic import atomic_file, prepare_folder
from istc_replay.export.rerun.events import Event, all_events, arrivals
from istc_replay.export.rerun.view import Opening, Parts, laid_out, write_view
from istc_replay.export.rerun.viewer import LOCAL, free_port, rerun_command
from istc_replay.export.web_page import view_page

_VIEWER = ("re_viewer.js", "re_viewer_bg.wasm")
_START_S = 30.0


def write_bundle(
    result: Result,
    config: ViewConfig,
    folder: Path,
    opening: Opening,
    instant_ns: int | None = None,
    report: Path | None = None,
    parts: Parts | None = None,
) -> None:
    """Write index.html, the viewer and view.rrd to a folder.

    Parameters
    ----------
    instant_ns : int, optional
        Where it opens, from the first window's start; there, otherwise.
    report : Path, optional
        A report to go along, where it exists.
    parts : callable, optional
        The result's parts, where it is without its states.

    Raises
    ------
    ExportError
        If a file cannot be written whole, or Rerun's web viewer cannot be had.
    """
    prepare_folder(folder)
    for name, content in _web_viewer().items():
        _write(folder / name, content)
    own = resources.files("istc_replay") / "data" / "web"
    for name in ("view.js", "view.css"):
        _write(folder / name, (own / name).read_bytes())
    write_view(result, config, folder / "view.rrd", opening, parts)
    with_report = report is not None and report.is_file()
    if report is not None and with_report and report.resolve() != (folder / "report.html").resolve():
        with atomic_file(folder / "report.html") as file:
            shutil.copyfile(report, file)
    origin, events, comings = 0, list[Event](), list[Event]()
    for stage, found in laid_out(result, config, opening.focus, parts):
        origin = stage.clock.origin_ns
        events += all_events(stage, found)
        comings += arrivals(stage)
    page = view_page(result, sorted(events), comings, origin, instant_ns or 0, report=with_report)
    _write(folder / "index.html", page.encode())


def _write(path: Path, content: bytes) -> None:
    with atomic_file(path) as file:
        file.write_bytes(content)


def _web_viewer() -> dict[str, bytes]:
    """Rerun's web viewer and its licences.

    It stands inside Rerun's program alone, which hands it out on a port of this machine.
    """
    port = free_port()
    command = rerun_command("--serve-web", "--port", str(free_port()), "--web-viewer-port", str(port))
    process = subprocess.Popen(  # noqa: S603
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        files = {name: _fetched(f"http://{LOCAL}:{port}/{name}", process) for name in _VIEWER}
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait(timeout=10)
    spec = importlib.util.find_spec("rerun_cli")
    notices = Path(spec.origin or "").parent / "THIRD_PARTY_NOTICES.md" if spec else Path()
    if notices.is_file():
        files["re_viewer.NOTICES.md"] = notices.read_bytes()
    return files


def _fetched(url: str, process: subprocess.Popen[bytes]) -> bytes:
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    deadline = time.monotonic() + _START_S
    while True:
        try:
            with opener.open(url, timeout=_START_S) as answer:
                return bytes(answer.read())
        except (urllib.error.URLError, OSError) as error:
            if process.poll() is not None or time.monotonic() > deadline:
                raise ExportError(
                    f"Rerun's web viewer cannot be had: {error}; use --save and open that in Rerun"
                ) from None
            time.sleep(0.05)
