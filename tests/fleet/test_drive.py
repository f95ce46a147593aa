"""Fleets on one machine: nothing is lost, what is done stays done, and every fault has its log's name."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from types import ModuleType

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from istc_replay.config import parse_config
from istc_replay.errors import UsageError
from istc_replay.fleet.cell import Limits
from istc_replay.fleet.manifest import Manifest, read_manifest
from istc_replay.fleet.status import fleet_status, status_lines
from istc_replay.pipeline.run import run_log
from istc_replay.pipeline.tables import export_tables

from .conftest import FAST, RunFleet, outputs


def test_a_fleet_gives_what_single_runs_give(done: Path, four_logs: Path, tmp_path: Path) -> None:
    for log in sorted(four_logs.iterdir())[:1]:
        alone = run_log(log, tmp_path / log.stem, parse_config(FAST))
        export_tables(
            tmp_path / log.stem / "result.mcap", tmp_path / "tables", ["parquet"], parse_config(FAST)
        )
        assert (done / "logs" / log.stem / "result.mcap").read_bytes() == alone.mcap
        for table in (tmp_path / "tables").iterdir():
            made = pl.read_parquet(done / "logs" / log.stem / "tables" / table.name)
            # Wall-clock times are in summary.json, since tables repeat; the export names its own topics.
            other = ("wall_s", "topic", "message_index")
            assert_frame_equal(
                made.drop(other, strict=False), pl.read_parquet(table).drop(other, strict=False)
            )
    assert len({name.split("/")[1] for name in outputs(done)}) == 4


def test_the_manifest_says_what_became_of_each_log(done: Path, four_logs: Path) -> None:
    books = read_manifest(done)
    assert set(books.ends) == {str(log) for log in four_logs.iterdir()}
    for end in books.ends.values():
        assert end["event"] == "done"
        assert end["seconds"] > 0.0
        assert end["peak_mb"] > 50.0
        assert len(end["log_sha256"]) == len(end["receipt_sha256"]) == 64
        assert end["tries"] == 1
    assert books.end is not None
    assert "4 of 4 logs (4 done)" in (done / "fleet.log").read_text()


def test_a_second_call_does_what_is_not_whole_and_nothing_else(
    run_fleet: RunFleet, again: Path, four_logs: Path
) -> None:
    folder, wanted = again, outputs(again)
    damaged, gone, untouched, touched = sorted((folder / "logs").iterdir())
    data = bytearray((damaged / "result.mcap").read_bytes())
    data[len(data) // 2] ^= 1
    (damaged / "result.mcap").write_bytes(data)
    shutil.rmtree(gone)
    kept = (untouched / "receipt.json").stat().st_ino
    summary = run_fleet(folder, four_logs)
    assert summary.counts["done"] == 4
    assert {e["folder"] for e in read_manifest(folder).ended_now} == {damaged.name, gone.name}
    assert outputs(folder) == wanted
    assert (untouched / "receipt.json").stat().st_ino == kept
    assert touched.exists()


def test_a_changed_log_or_configuration_is_done_again(
    run_fleet: RunFleet, fleet_logs: ModuleType, tmp_path: Path
) -> None:
    logs, folder = tmp_path / "logs", tmp_path / "fleet"
    first, second = fleet_logs.write_logs(logs, 2)
    run_fleet(folder, logs)
    before = outputs(folder)
    first.write_bytes(fleet_logs.varied_log(7))
    os.utime(second)  # touched, not changed
    run_fleet(folder, logs)
    assert [e["folder"] for e in read_manifest(folder).ended_now] == [first.stem]
    assert outputs(folder) != before
    run_fleet(folder, second, config_toml=FAST + "vehicle_gap_m = 0.4\n")
    assert [e["event"] for e in read_manifest(folder).ended_now] == ["done"]


def test_finished_outputs_that_a_killed_driver_could_not_enter_are_taken_as_they_are(
    run_fleet: RunFleet, again: Path, four_logs: Path
) -> None:
    folder, wanted = again, outputs(again)
    lines = (folder / "fleet.jsonl").read_bytes().splitlines(keepends=True)
    ends = [i for i, line in enumerate(lines) if b'"event": "done"' in line]
    # The driver was killed while it wrote the third ending, and a worker just before it moved its folder.
    (folder / "fleet.jsonl").write_bytes(b"".join(lines[: ends[2]]) + lines[ends[2]][:40])
    last = json.loads(lines[ends[3]])["folder"]
    (folder / "logs" / last).rename(folder / "logs" / f".istc-job-{last}-x1")
    half = folder / "logs" / ".istc-job-log_00009-x2"
    half.mkdir()
    (half / "result.mcap").write_bytes(b"half")
    inodes = {file.parent.name: file.stat().st_ino for file in (folder / "logs").rglob("receipt.json")}
    summary = run_fleet(folder, four_logs)
    assert summary.counts["done"] == 4
    assert outputs(folder) == wanted
    assert not list((folder / "logs").glob(".*"))
    found = {file.parent.name: file.stat().st_ino for file in (folder / "logs").rglob("receipt.json")}
    assert set(found.values()) == set(inodes.values())
    assert fleet_status(folder)["torn_lines"] == 1


def test_a_log_that_kills_its_worker_is_named_and_every_other_is_done(
    run_fleet: RunFleet, fleet_logs: ModuleType, with_faults: None, tmp_path: Path
) -> None:
    logs, folder = tmp_path / "logs", tmp_path / "fleet"
    fleet_logs.write_logs(logs, 2)
    for name in ("crash", "hungry", "abort"):
        (logs / f"{name}.mcap").write_bytes(fleet_logs.varied_log(1))
    summary = run_fleet(folder, logs, limits=Limits(600.0, 300.0))
    assert summary.counts == {"done": 2, "inconclusive": 0, "failed": 3}, summary.named
    errors = {Path(entry["log"]).stem: entry["error"] for entry in summary.named}
    assert "SIGSEGV: Fatal Python error: Segmentation fault (tried 2 times)" in errors["crash"]
    assert "more than the limit of 600 MB" in errors["hungry"] or "out of memory" in errors["hungry"]
    assert "SIGABRT" in errors["abort"]
    assert summary.worst_code == 4
    assert sorted(p.name for p in (folder / "logs").iterdir()) == ["log_00000", "log_00001"]


def test_a_log_that_hangs_its_worker_is_stopped_and_named(
    run_fleet: RunFleet, fleet_logs: ModuleType, with_faults: None, tmp_path: Path
) -> None:
    log = tmp_path / "hang.mcap"
    log.write_bytes(fleet_logs.varied_log(1))
    summary = run_fleet(tmp_path / "fleet", log, limits=Limits(4000.0, 1.0))
    assert [entry["error"] for entry in summary.named] == ["emergency stop after 1 s (tried 2 times)"]
    assert summary.worst_code == 4


WINDOWS = FAST + "[window]\nwhole_log_s = 5.0\nhorizon_s = 4.0\nstride_s = 3.0\n"


def test_a_long_log_cut_into_ranges_gives_the_same_bytes(
    run_fleet: RunFleet, four_logs: Path, tmp_path: Path
) -> None:
    log = min(four_logs.iterdir())
    for cut in (0, 2):
        summary = run_fleet(tmp_path / f"cut_{cut}", log, cut=cut, config_toml=WINDOWS)
        assert sum(summary.counts.values()) == 1
        assert not list((tmp_path / f"cut_{cut}" / "parts").glob("*"))
    assert outputs(tmp_path / "cut_0") == outputs(tmp_path / "cut_2")
    told = (tmp_path / "cut_2" / "fleet.log").read_text()
    assert told.count("cut: ") == 1
    begun = [json.loads(line) for line in (tmp_path / "cut_2/fleet.jsonl").read_text().splitlines()]
    ranges = [entry["windows"] for entry in begun if entry["event"] == "begun" and "windows" in entry]
    assert len(ranges) == 2
    whole = json.loads((tmp_path / "cut_2/logs/log_00000/summary.json").read_text())
    done_apart = sorted(index for first, end in ranges for index in range(first, end))
    assert done_apart == list(range(whole["totals"]["windows"]))


def test_failed_logs_wait_for_retry_failed(
    run_fleet: RunFleet, fleet_logs: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs, folder = tmp_path / "logs", tmp_path / "fleet"
    fleet_logs.write_logs(logs, 1)
    (logs / "text.mcap").write_text("no log")
    summary = run_fleet(folder, logs)
    assert summary.counts == {"done": 1, "inconclusive": 0, "failed": 1}
    (entry,) = summary.named
    assert entry["error"].startswith("not an MCAP log")
    assert summary.worst_code == 3
    assert run_fleet(folder, logs).counts["failed"] == 1
    assert read_manifest(folder).ended_now == []
    run_fleet(folder, logs, retry_failed=True)
    assert [e["folder"] for e in read_manifest(folder).ended_now] == ["text"]


def test_a_damaged_log_is_inconclusive_and_keeps_its_outputs(
    run_fleet: RunFleet, fleet_logs: ModuleType, tmp_path: Path
) -> None:
    log = tmp_path / "cut.mcap"
    data = fleet_logs.varied_log(3)
    log.write_bytes(data[: len(data) - 400])
    summary = run_fleet(tmp_path / "fleet", log)
    assert summary.counts["inconclusive"] == 1
    assert "the log is incomplete" in summary.named[0]["error"]
    assert (tmp_path / "fleet/logs/cut/result.mcap").exists()
    assert summary.worst_code == 3


def test_two_fleets_do_not_share_a_folder(tmp_path: Path, run_fleet: RunFleet, four_logs: Path) -> None:
    holder = Manifest(tmp_path)
    try:
        with pytest.raises(UsageError, match="another fleet is at work"):
            run_fleet(tmp_path, four_logs)
    finally:
        holder.close()


def test_the_status_tells_of_a_fleet_that_was_killed(done: Path, tmp_path: Path) -> None:
    assert next(status_lines(fleet_status(done))).startswith("finished: 4 of 4 logs (4 done)")
    lines = (done / "fleet.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "fleet.jsonl").write_bytes(
        b"".join(line for line in lines[:-1] if b"00003" not in line or b"queued" in line)
    )
    facts = fleet_status(tmp_path)
    assert (facts["state"], facts["left"], facts["counts"]["done"]) == ("killed", 1, 3)
    assert "call the fleet again" in next(status_lines(facts))


def test_workers_that_do_not_start_stop_the_fleet_and_blame_no_log(
    run_fleet: RunFleet, four_logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "broken" / "istc_replay"
    broken.mkdir(parents=True)
    (broken / "__init__.py").write_text("raise ImportError('it is broken')")
    monkeypatch.setenv("PYTHONPATH", str(broken.parent))
    summary = run_fleet(tmp_path / "fleet", four_logs)
    assert "no worker starts" in summary.stopped
    assert "ImportError: it is broken" in summary.stopped
    assert summary.counts == {"done": 0, "inconclusive": 0, "failed": 0}
