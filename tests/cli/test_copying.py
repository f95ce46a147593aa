"""`clip`, `merge` and `recover` as a user calls them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from istc_replay.ingest.log import read_log

SAMPLE = Path(__file__).resolve().parents[2] / "sample_logs/intersection_osi.mcap"


def test_a_clip_is_written_and_told(call: Any, tmp_path: Path) -> None:
    out = tmp_path / "clip.mcap"
    done = call("clip", SAMPLE, out, "--from", "2", "--to", "4")
    assert (done.returncode, done.stderr) == (0, "")
    assert "20 messages on 1 channels" in done.stdout
    assert read_log(out).complete


def test_a_span_must_be_told_in_one_way(call: Any, tmp_path: Path) -> None:
    for options in ((), ("--from", "1", "--around", "2"), ("--around", "2", "--audit", "x")):
        done = call("clip", SAMPLE, tmp_path / "clip.mcap", *options)
        assert done.returncode == 2
        assert done.stderr.startswith("istc-replay: ")
        assert done.stderr.count("\n") == 1
    assert not (tmp_path / "clip.mcap").exists()


def test_clips_merge_into_the_whole_again(call: Any, tmp_path: Path) -> None:
    parts = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    assert call("clip", SAMPLE, parts[0], "--to", "3").returncode == 0
    assert call("clip", SAMPLE, parts[1], "--from", "3").returncode == 0
    whole = tmp_path / "whole.mcap"
    done = call("merge", *parts, "-o", whole)
    assert done.returncode == 0
    assert "is in 2 logs" in done.stdout
    assert read_log(whole).states.equals(read_log(SAMPLE).states)


def test_a_damaged_log_is_recovered_and_its_loss_told(call: Any, tmp_path: Path) -> None:
    data = SAMPLE.read_bytes()
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    cut.write_bytes(data[:-30])
    done = call("recover", cut, out)
    assert done.returncode == 0
    assert "truncated at byte" in done.stdout
    assert call("info", out).returncode == 0
    assert call("clip", cut, tmp_path / "clip.mcap", "--from", "1").returncode == 3
    cut.write_bytes(b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    done = call("recover", cut, out)
    assert done.returncode == 3
    assert "git-lfs" in done.stderr
