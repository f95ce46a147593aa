"""What names a log: files, folders, globs, lists and URLs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from istc_replay.errors import LogError, UsageError
from istc_replay.fleet.inputs import find_logs, local_file, name_sources, stamp_of


@pytest.fixture
def night(tmp_path: Path) -> Path:
    """Logs of one night, by car."""
    for name in ("a/drive.mcap", "a/late.mcap", "b/drive.mcap", "b/notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    return tmp_path


def test_folders_globs_and_lists_name_each_log_once(night: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    every = [str(night / name) for name in ("a/drive.mcap", "a/late.mcap", "b/drive.mcap")]
    assert find_logs([str(night)]) == every
    assert find_logs([f"{night}/**/drive.mcap"]) == [every[0], every[2]]
    (night / "list").write_text(f"# the night\n\nb\na/*.mcap\n{every[0]}\n")
    assert find_logs([f"@{night}/list"]) == [every[2], every[0], every[1]]
    monkeypatch.chdir(night)
    assert find_logs(["a/late.mcap", "a"], [Path("list")]) == [every[1], every[0], every[2]]


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("absent.mcap", "no such file or folder"),
        ("*.absent", "no file matches"),
        ("@absent", "cannot be read"),
        ("empty", "no .mcap file"),
        ("nosuch://host/log.mcap", "fsspec reads"),
    ],
)
def test_what_names_nothing_is_refused(
    argument: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=message):
        find_logs([argument])


def test_what_a_fleet_wrote_is_no_log_of_the_next_call(night: Path) -> None:
    (night / "b/logs/drive").mkdir(parents=True)
    (night / "b/logs/drive/result.mcap").write_text("")
    every = find_logs([str(night)])
    assert len(every) == 4
    assert find_logs([str(night)], leave_out=night / "b") == every[:2]


def test_a_name_with_the_marks_of_a_glob_is_a_file_where_there_is_one(tmp_path: Path) -> None:
    odd = tmp_path / "run [1].mcap"
    odd.write_text("")
    assert find_logs([str(odd)]) == [str(odd)]


def test_logs_of_one_name_have_folders_of_their_own_and_keep_them(night: Path) -> None:
    logs = find_logs([str(night)])
    names = {source.location: source.name for source in name_sources(logs, {})}
    assert names[logs[0]] == "drive"
    assert names[logs[2]].startswith("drive-")
    assert len(set(names.values())) == 3
    other = name_sources(["/elsewhere/drive.mcap", *reversed(logs)], names)
    assert {s.location: s.name for s in other[1:]} == names
    assert other[0].name not in names.values()


@pytest.mark.parametrize("name", ["...mcap", ".mcap", ".hidden.mcap", "..", f"{'é' * 200}.mcap"])
def test_no_name_leads_out_of_the_folder_or_hides(name: str) -> None:
    (source,) = name_sources([f"/logs/{name}"], {})
    assert not source.name.startswith(".")
    assert "/" not in source.name
    assert 0 < len(os.fsencode(source.name)) <= 150


def test_urls_are_listed_and_fetched(night: Path) -> None:
    pytest.importorskip("fsspec")
    logs = find_logs([f"file://{night}/*/drive.mcap"])
    assert [log.rsplit("/", 2)[-2:] for log in logs] == [["a", "drive.mcap"], ["b", "drive.mcap"]]
    assert find_logs([f"file://{night}"])[1].endswith("a/late.mcap")
    with local_file(logs[1], None) as copy:
        assert copy.name == "drive.mcap"
        assert copy.read_text() == "b/drive.mcap"
    assert not copy.exists()
    before = stamp_of(logs[0])
    (night / "a/drive.mcap").write_text("longer than before")
    assert stamp_of(logs[0]) != before
    with (
        pytest.raises(LogError, match=r"absent\.mcap: cannot be"),
        local_file(f"file://{night}/absent.mcap", None),
    ):
        pass
