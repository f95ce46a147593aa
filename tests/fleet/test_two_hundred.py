"""Two hundred logs, ten of them bad: the good are done as if alone, the bad are named."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import polars as pl
import pytest

from istc_replay.fleet.cell import Limits
from istc_replay.fleet.execute import do_job
from istc_replay.fleet.inputs import stamp_of
from istc_replay.fleet.jobs import Job, version
from istc_replay.fleet.report import write_report

from .conftest import FAST, RunFleet, outputs


@pytest.mark.slow
def test_of_two_hundred_logs_the_good_are_done_and_the_bad_named(
    run_fleet: RunFleet, fleet_logs: ModuleType, with_faults: None, tmp_path: Path
) -> None:
    logs = tmp_path / "logs"
    fleet_logs.write_logs(logs, 190)
    bad = {
        "truncated_1": fleet_logs.truncated_log(1),
        "truncated_2": fleet_logs.truncated_log(2)[:500],
        "bomb_1": fleet_logs.bomb_log(),
        "bomb_2": fleet_logs.bomb_log()[:-30],
        "empty_1": fleet_logs.empty_log(),
        "empty_2": b"",
        "crash_1": fleet_logs.varied_log(1),
        "crash_2": fleet_logs.varied_log(2),
        "abort_1": fleet_logs.varied_log(3),
        "hungry_1": fleet_logs.varied_log(4),
    }
    for name, data in bad.items():
        (logs / f"{name}.mcap").write_bytes(data)
    folder = tmp_path / "fleet"
    summary = run_fleet(folder, logs, jobs=2, limits=Limits(700.0, 600.0))
    assert summary.counts["done"] == 190
    assert {Path(entry["log"]).stem for entry in summary.named} == set(bad)
    assert all(entry["error"] for entry in summary.named)
    write_report(folder)
    found = pl.scan_parquet(folder / "report/tables/logs/*.parquet").collect()
    assert found.height == 200
    assert found["outcome"].value_counts().filter(pl.col("outcome") == "done")["count"].item() == 190
    made = outputs(folder)
    for log in sorted(logs.glob("log_*.mcap")):
        folder = tmp_path / "alone" / log.stem
        job = Job(str(log), log.stem, stamp_of(str(log)), str(folder), FAST, version(), ())
        assert do_job(job).status == "done"
        for name, data in outputs(folder).items():
            assert made[name] == data, name
