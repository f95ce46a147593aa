"""The manifest: what is in it is on the disk, and no torn line hides another."""

from __future__ import annotations

import resource
import signal
from pathlib import Path

import pytest

from istc_replay.errors import ExportError, LogError
from istc_replay.fleet.manifest import NAME, SCHEMA, Manifest, is_held, read_manifest

CALL = {"event": "fleet", "schema": SCHEMA, "logs": 2, "whole": 0}
END = {"event": "done", "log": "/a", "folder": "a"}


def written(folder: Path, *entries: dict[str, object]) -> None:
    manifest = Manifest(folder)
    manifest.append(*entries)
    manifest.close()


def test_a_manifest_torn_at_any_byte_keeps_every_whole_line(tmp_path: Path) -> None:
    written(tmp_path, CALL, {"event": "queued", "log": "/a", "folder": "a"}, END)
    data = (tmp_path / NAME).read_bytes()
    lines = data.splitlines(keepends=True)
    for cut in range(len(lines[0]), len(data) + 1):
        folder = tmp_path / str(cut)
        folder.mkdir()
        (folder / NAME).write_bytes(data[:cut])
        manifest = Manifest(folder)
        assert ("/a" in manifest.books.ends) == (cut == len(data))
        manifest.append({**END, "log": "/b"})
        manifest.close()
        assert "/b" in read_manifest(folder).ends


def test_a_manifest_torn_in_its_first_line_is_begun_again(tmp_path: Path) -> None:
    (tmp_path / NAME).write_text('{"event": "fle')
    written(tmp_path, CALL, END)
    assert read_manifest(tmp_path).ends.keys() == {"/a"}


@pytest.mark.parametrize(
    "content", ["no manifest\nat all\n", "[1]\n[2]\n", '{"event": "fleet", "schema": "x"}\n']
)
def test_what_is_no_manifest_is_left_alone(content: str, tmp_path: Path) -> None:
    (tmp_path / NAME).write_text(content)
    with pytest.raises(LogError):
        Manifest(tmp_path)
    with pytest.raises(LogError):
        read_manifest(tmp_path)
    assert (tmp_path / NAME).read_text() == content


def test_entries_that_do_not_fit_on_the_disk_are_not_there_at_all(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path)
    manifest.append(CALL)
    size = (tmp_path / NAME).stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 30, hard))
    try:
        with pytest.raises(ExportError, match="free some space"):
            manifest.append(END)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    assert (tmp_path / NAME).stat().st_size == size
    assert manifest.books.ends == {}
    manifest.append(END)
    manifest.close()
    assert read_manifest(tmp_path).ends.keys() == {"/a"}


def test_a_held_folder_is_told(tmp_path: Path) -> None:
    assert not is_held(tmp_path)
    manifest = Manifest(tmp_path)
    assert is_held(tmp_path)
    manifest.close()
    assert not is_held(tmp_path)
