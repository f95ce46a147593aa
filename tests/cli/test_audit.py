"""`istc-replay audit` as a user calls it."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import polars as pl

from ..support.commands import TURN_FIRST, Command, altered


def test_audit_of_a_log_finds_the_collision_and_writes_it(call: Command, tmp_path: Path) -> None:
    done = call("audit", TURN_FIRST, "-o", tmp_path, "--format", "parquet,json,md,junit")
    assert done.returncode == 1, done.stderr
    assert "critical" in done.stdout
    assert {"findings.parquet", "audit.json", "audit.md", "audit.junit.xml"} <= {
        f.name for f in tmp_path.iterdir()
    }
    findings = pl.read_parquet(tmp_path / "findings.parquet")
    assert "critical" in findings["severity"].to_list()
    told = call("audit", TURN_FIRST, "--json")
    assert told.returncode == 1
    assert (
        json.loads(told.stdout)["findings"] == json.loads((tmp_path / "audit.json").read_text())["findings"]
    )


def test_audit_of_a_log_with_nothing_wrong_finds_nothing(call: Command, tmp_path: Path) -> None:
    log = altered(tmp_path, lambda states: states.filter(pl.col("vehicle_id") == "1"))
    done = call("audit", log)
    assert done.returncode == 0, done.stdout


def test_audit_of_a_result_judges_its_recording_and_certifies_its_plans_anew(
    call: Command, replayed: tuple[subprocess.CompletedProcess[str], Path], tmp_path: Path
) -> None:
    done = call("audit", replayed[1] / TURN_FIRST.stem, "-o", tmp_path, "--format", "json,parquet")
    assert done.returncode == 1, done.stderr  # its vehicles collide as recorded
    assert "cubes_disjoint" in done.stdout
    told = json.loads((tmp_path / "audit.json").read_text())
    assert {row["verdict"] for row in told["certificates"]} == {"pass", "not_applicable"}
    assert {row["estimate"] for row in told["against_plan"]} == {"counterfactual estimate"}
    of_log = call("audit", TURN_FIRST, "-o", tmp_path / "log", "--format", "json")
    assert of_log.returncode == 1, of_log.stderr
    behaviour = [row for row in told["findings"] if row["rule"] != "off_corridor"]
    also = json.loads((tmp_path / "log" / "audit.json").read_text())["findings"]
    assert [row["finding_id"] for row in behaviour] == [row["finding_id"] for row in also]
