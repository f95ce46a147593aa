"""The view as a folder, in a real browser that reaches no other host."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import matplotlib.image
import pytest

from istc_replay.config import ViewConfig
from istc_replay.datatypes import Result
from istc_replay.errors import ExportError
from istc_replay.export.rerun.events import Event
from istc_replay.export.rerun.view import Opening
from istc_replay.export.web_bundle import write_bundle
from istc_replay.export.web_page import view_page
from istc_replay.export.web_server import folder_server

from ..support.processes import listening

INSTANT_NS = 4_250_000_000


@pytest.fixture(scope="module")
def folder(hostile_result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle of a result with hostile names, and a report beside it."""
    from dataclasses import replace

    path = tmp_path_factory.mktemp("web") / "bundle"
    report = path.with_name("report.html")
    report.write_text("<!DOCTYPE html><html lang=en><title>r</title><main><h1>Report</h1></main></html>")
    readable = replace(hostile_result, config_toml="[window]\nunit_s = 1.0\n")
    write_bundle(readable, ViewConfig(), path, Opening(), INSTANT_NS, report)
    return path


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of the folder while it is served."""
    with folder_server(folder) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


def test_the_folder_holds_all_that_the_page_needs(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    assert names == {
        *("index.html", "view.js", "view.css", "view.rrd", "report.html"),
        *("re_viewer.js", "re_viewer_bg.wasm", "re_viewer.NOTICES.md"),
    }
    assert (folder / "re_viewer_bg.wasm").read_bytes()[:4] == b"\0asm"


def test_the_page_shows_hostile_names_as_text(folder: Path) -> None:
    page = (folder / "index.html").read_text(encoding="utf-8")
    assert "<script>" not in page
    assert "&lt;script&gt;alert(1)" in page
    assert "\u202e" not in page
    assert page.isprintable() or set(page) - {"\n"} <= {c for c in page if c.isprintable()}
    assert len(page) < 60_000


def test_every_vehicle_has_a_button_to_its_coming_and_many_are_folded(hostile_result: Result) -> None:
    comings = [
        Event(n * 10**9, "vehicles", "INFO", f"vehicle <b>{n}</b> is shown for 1.0 s") for n in range(30)
    ]
    few, many = (view_page(hostile_result, [], some, 0, 0, report=False) for some in (comings[:9], comings))
    assert "<details>" not in few
    assert "<details><summary>30 vehicles, by the time when they come</summary>" in many
    for page, count in ((few, 9), (many, 30)):
        assert page.count("data-ns=") == count + 2  # the page's own, and the window's
        assert f'data-ns="{(count - 1) * 10**9}"' in page
        assert "<b>" not in page


def test_the_server_is_for_pages_of_this_machine_alone(folder: Path) -> None:
    with served(folder) as url:
        with urlopen(url) as answer:
            assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
        with urlopen(f"{url}re_viewer_bg.wasm") as answer:
            assert answer.headers["Content-Type"] == "application/wasm"
        folder.with_name("secret.txt").write_text("secret")
        for path, host in (("", "evil.example"), ("../secret.txt", None), ("%2e%2e/secret.txt", None)):
            request = Request(url + path, headers={"Host": host} if host else {})
            with pytest.raises(HTTPError) as caught:
                urlopen(request)
            assert caught.value.code in (403, 404)
            caught.value.close()


def test_the_server_listens_on_this_machine_alone(folder: Path) -> None:
    with served(folder):
        assert listening(os.getpid()) == {"127.0.0.1"}


def test_a_port_that_is_taken_is_told(folder: Path) -> None:
    with (
        folder_server(folder) as server,
        pytest.raises(ExportError, match="choose another with --port"),
    ):
        folder_server(folder, server.server_port)


def test_the_page_passes_axe(folder: Path, browser: Any) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
    with served(folder) as url:
        for scheme in ("light", "dark"):
            page = browser.new_page(color_scheme=scheme, viewport={"width": 1400, "height": 900})
            # Without its script: what the page is while the viewer loads, and where it cannot.
            page.route("**/view.js", lambda route: route.abort())
            page.goto(url)
            found = axe.Axe().run(page)
            assert found.violations_count == 0, found.generate_report()
            page.close()


@pytest.mark.slow
def test_the_browser_shows_the_scene_and_its_instants_offline(folder: Path, browser: Any) -> None:
    asked: list[str] = []
    with served(folder) as url:
        page = browser.new_page(viewport={"width": 1500, "height": 900})
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"{url}?renderer=webgl")
        page.wait_for_selector("body[data-ready]", timeout=120_000)
        assert page.title() == "Replay of " + page.locator("h1").inner_text().removeprefix("Replay of ")
        assert _stands_at(page, INSTANT_NS)
        before = _settled(page)
        assert before.std() > 0.05
        button = page.locator("#events ~ ul").first.locator("button").last
        button.click()
        page.wait_for_timeout(1500)
        assert _stands_at(page, int(button.get_attribute("data-ns")))
        assert not page.evaluate("document.body.dataset.failed")
        assert _reports(page) == []
        axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
        worst = [
            v["id"]
            for v in axe.Axe().run(page).response["violations"]
            if v["impact"] in ("serious", "critical")
        ]
        assert worst == []
        page.close()
    assert {address.split("/")[2] for address in asked if "://" in address} == {url.split("/")[2]}


def _settled(page: Any) -> Any:
    """The scene's picture once nothing more loads."""
    picture = None
    for _ in range(15):
        before = picture
        picture = matplotlib.image.imread(io.BytesIO(page.locator("#scene").screenshot()))[..., :3]
        if before is not None and abs(picture - before).mean() < 1e-4:
            break
        page.wait_for_timeout(1000)
    return picture


def _state(page: Any) -> list[tuple[int, Any]]:
    """The viewer's own account of itself, as fields of its message."""
    return _fields(bytes(page.evaluate("Array.from(window.viewer.viewer_state())")))


def _stands_at(page: Any, instant_ns: int) -> bool:
    """Whether the cursor of the only recording stands there: nothing else of it has this number."""
    (recording,) = (value for number, value in _state(page) if number == 3)
    return instant_ns in list(_leaves(recording))


def _reports(page: Any) -> list[bytes]:
    """Views that report anything: their messages' field for it."""
    views = [_fields(value) for number, value in _state(page) if number == 5]
    assert len(views) > 20
    return [value for view in views for number, value in view if number >= 6 and isinstance(value, bytes)]


def _fields(message: bytes) -> list[tuple[int, Any]]:
    found, at = [], 0
    while at < len(message):
        key, at = _varint(message, at)
        if key & 7 == 0:
            value, at = _varint(message, at)
            found.append((key >> 3, value))
        elif key & 7 == 2:
            length, at = _varint(message, at)
            found.append((key >> 3, message[at : at + length]))
            at += length
        else:
            at += 8 if key & 7 == 1 else 4
    return found


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = message[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at


def _leaves(message: bytes) -> Iterator[Any]:
    for _, value in _fields(message):
        if isinstance(value, bytes):
            try:
                yield from _leaves(value)
            except IndexError:
                yield value
        else:
            yield value


@pytest.mark.slow
def test_view_web_serves_until_it_is_interrupted(synthetic_bytes: bytes, tmp_path: Path) -> None:
    (tmp_path / "result.mcap").write_bytes(synthetic_bytes)
    code = "from istc_replay.cli import main; main()"
    command = [sys.executable, "-c", code, "view", str(tmp_path / "result.mcap"), "--web", "--at", "2"]
    screenless = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=screenless
    )
    try:
        assert process.stdout is not None
        url = process.stdout.readline().split()[0]
        assert listening(process.pid) == {"127.0.0.1"}
        with urlopen(url) as answer:
            assert b'data-ns="2000000000"' in answer.read()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20)
        assert (process.returncode, errors.strip()) == (0, "")
    finally:
        process.kill()
        process.wait()
