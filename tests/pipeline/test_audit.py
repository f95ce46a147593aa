"""Clips of the log about serious findings: whose, how long, how many, and of which clock."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import polars as pl

from istc_replay.config import Config
from istc_replay.ingest.log import read_log
from istc_replay.pipeline.audit import audit_path, audit_read, clip_spans, write_clips

ROOT = Path(__file__).resolve().parents[2]
TURN_FIRST = ROOT / "sample_logs" / "intersection_turn_first.mcap"
NS = 1_000_000_000


def test_every_serious_encounter_has_a_clip_with_three_seconds_to_either_side(tmp_path: Path) -> None:
    audit = audit_path(TURN_FIRST, Config())
    clips = write_clips(audit, TURN_FIRST, tmp_path, 20)
    severe = audit.encounters.filter(pl.col("severity").is_in(["serious", "critical"]))
    assert set(clips) == set(severe["encounter_id"])
    whole = read_log(TURN_FIRST).states
    for row in severe.iter_rows(named=True):
        states = read_log(tmp_path / clips[row["encounter_id"]]).states
        near = whole.filter(pl.col("time_ns").is_between(row["start_ns"] - 3 * NS, row["end_ns"] + 3 * NS))
        # Nothing is missing, and what is there is as it was.
        assert states.select("vehicle_id", "time_ns", "x_m", "y_m").equals(
            near.select("vehicle_id", "time_ns", "x_m", "y_m")
        )


def test_no_more_clips_than_wanted_and_the_worst_first() -> None:
    audit = audit_path(TURN_FIRST)
    assert clip_spans(audit, 0) == {}
    (first,) = clip_spans(audit, 1)
    assert first == next(iter(clip_spans(audit, 20)))
    calm = audit.findings.filter(pl.col("severity") == "minor")
    assert set(clip_spans(audit, 99)).isdisjoint(calm["finding_id"])


def test_spans_are_those_of_the_logs_clock_not_of_the_states() -> None:
    audit = audit_path(TURN_FIRST)
    shifted = audit.log.states.with_columns(log_time_ns=pl.col("log_time_ns") + 100 * NS)
    before = clip_spans(audit, 1)

    after = clip_spans(replace(audit, log=replace(audit.log, states=shifted)), 1)
    for (start, end), (later, last) in zip(before.values(), after.values(), strict=True):
        assert (later - start, last - end) == (100 * NS, 100 * NS)


def test_the_files_tell_of_the_clips(tmp_path: Path) -> None:
    text, code, files = audit_read(TURN_FIRST, Config(), tmp_path, ["html"], "serious", clips=2)
    assert code == 1
    assert text.startswith("# Audit of")
    assert [path.suffix for path in files] == [".html", ".mcap", ".mcap"]
    report = files[0].read_text(encoding="utf-8")
    for path in files[1:]:
        assert f'href="clips/{path.name}"' in report


def test_reading_a_log_is_told_by_its_bytes() -> None:
    told: list[tuple[int, int]] = []
    audit_path(TURN_FIRST, Config(), lambda done, total: told.append((done, total)))
    size = TURN_FIRST.stat().st_size
    assert {total for _, total in told} == {size}
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert 0 < told[-1][0] <= size
