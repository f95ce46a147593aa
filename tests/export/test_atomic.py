"""Outputs are written whole or not at all."""

from __future__ import annotations

import stat
import subprocess
import sys
from pathlib import Path

import pytest

from istc_replay.errors import ExportError
from istc_replay.export.atomic import atomic_file, prepare_folder


def test_a_written_file_is_there_and_nothing_else(tmp_path: Path) -> None:
    with atomic_file(tmp_path / "out.bin") as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".bin"
        temporary.write_bytes(b"whole")
        assert not (tmp_path / "out.bin").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["out.bin"]
    assert (tmp_path / "out.bin").read_bytes() == b"whole"


def test_a_written_file_has_the_modes_of_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "usual").touch()
    with atomic_file(tmp_path / "out"):
        pass
    assert stat.S_IMODE((tmp_path / "out").stat().st_mode) == stat.S_IMODE(
        (tmp_path / "usual").stat().st_mode
    )


@pytest.mark.parametrize("failure", [ValueError("no"), KeyboardInterrupt(), SystemExit(1)])
def test_any_failure_leaves_the_old_file_and_nothing_behind(tmp_path: Path, failure: BaseException) -> None:
    target = tmp_path / "out.bin"
    target.write_bytes(b"old")

    def fail_half_way() -> None:
        with atomic_file(target) as temporary:
            temporary.write_bytes(b"half")
            raise failure

    with pytest.raises(type(failure)):
        fail_half_way()
    assert [p.name for p in tmp_path.iterdir()] == ["out.bin"]
    assert target.read_bytes() == b"old"


def test_a_writer_that_removes_its_file_is_an_error_of_one_line(tmp_path: Path) -> None:
    with (
        pytest.raises(ExportError, match=r"out\.bin: cannot be written"),
        atomic_file(tmp_path / "out.bin") as file,
    ):
        file.unlink()
    assert list(tmp_path.iterdir()) == []


def test_a_path_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with (
        pytest.raises(ExportError, match="choose another folder"),
        atomic_file(tmp_path / "file" / "out.bin"),
    ):
        pytest.fail("there is nothing to write to")
    with pytest.raises(ExportError, match="choose another folder"):
        prepare_folder(tmp_path / "file" / "folder")


def test_a_folder_in_the_way_is_refused_and_kept(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "kept").touch()
    with pytest.raises(ExportError, match="remove that folder"), atomic_file(tmp_path / "out"):
        pytest.fail("there is nothing to write to")
    assert (tmp_path / "out" / "kept").exists()


def test_a_file_is_not_a_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ExportError, match="file: cannot be written: File exists"):
        prepare_folder(tmp_path / "file")


def test_a_symlink_is_replaced_not_followed(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").write_bytes(b"untouched")
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    with atomic_file(tmp_path / "out") as temporary:
        temporary.write_bytes(b"new")
    assert (tmp_path / "elsewhere").read_bytes() == b"untouched"
    assert (tmp_path / "out").read_bytes() == b"new"


def test_prepare_folder_makes_parents_and_leaves_nothing_in_them(tmp_path: Path) -> None:
    folder = prepare_folder(tmp_path / "a" / "b")
    assert folder.is_dir()
    assert list(folder.iterdir()) == []
    assert prepare_folder(folder) == folder


_FULL_DISK = """
import resource, signal, sys
from pathlib import Path
from istc_replay.errors import ExportError
from istc_replay.export.atomic import atomic_file

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    with atomic_file(Path(sys.argv[1]) / "out.bin") as temporary:
        temporary.write_bytes(b"x" * 5000)
except ExportError as error:
    print(error)
"""


def test_a_disk_that_fills_up_leaves_nothing_behind(tmp_path: Path) -> None:
    pytest.importorskip("resource", reason="file size limits are POSIX")
    run = subprocess.run(
        [sys.executable, "-c", _FULL_DISK, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert "out.bin: cannot be written: File too large; raise the limit" in run.stdout
    assert list(tmp_path.iterdir()) == []
