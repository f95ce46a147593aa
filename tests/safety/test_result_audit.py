"""The audit of a result is that of its log, and the certificates of its plans."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest

import istc_replay
from istc_replay.config import Config
from istc_replay.datatypes import Result, Verdict
from istc_replay.ingest.log import read_log
from istc_replay.ingest.result import read_result
from istc_replay.pipeline.assembly import Replay
from istc_replay.pipeline.replay import replay_log
from istc_replay.safety.log_audit import audit_log
from istc_replay.safety.result_audit import audit_result

TURN_FIRST = Path(__file__).resolve().parents[2] / "sample_logs" / "intersection_turn_first.mcap"
OF_PLANS = ["off_corridor", "not_proven_optimal"]
SAME = ("finding_id", "rule", "verdict", "severity", "vehicles", "start_ns", "worst_ns", "end_ns", "value")


@pytest.fixture(scope="module")
def replayed() -> Replay:
    return replay_log(TURN_FIRST, Config.model_validate({"corridors": {"mode": "fast"}}))


def test_a_run_carries_the_findings_of_its_log_with_their_places_in_it(replayed: Replay) -> None:
    of_log = audit_log(read_log(TURN_FIRST), Config()).findings
    carried = read_result(replayed.mcap).findings
    behaviour = carried.filter(~pl.col("rule").is_in(OF_PLANS)).sort("finding_id")
    assert behaviour.equals(of_log.sort("finding_id"))
    assert set(carried["rule"]) - set(of_log["rule"]) == set(OF_PLANS)
    told = replayed.summary["audit"]
    assert told["verdict"] == "fail"
    assert sum(told["counts"].values()) == carried.height
    assert told["worst"][0]["severity"] == "critical"
    for vehicle in replayed.summary["windows"][0]["vehicles"]:
        assert vehicle["recorded_against_plan"]["estimate"] == "counterfactual estimate"


def test_a_result_audited_anew_finds_what_its_run_found(replayed: Replay) -> None:
    result = replayed.result
    again = istc_replay.audit(result)
    assert again.findings.select(SAME).equals(
        result.findings.sort("start_ns", "rule", "worst_ns", "finding_id").select(SAME)
    )
    assert again.of_result
    assert set(again.certificates["verdict"]) <= {"pass", "not_applicable"}
    assert again.certificates.drop("detail").equals(result.certificates.drop("detail"))
    assert again.against_plan.height == 3
    # Each finding names a message of the result's own topics, and the state that it is of.
    for row in again.findings.filter(pl.col("rule") != "not_proven_optimal").iter_rows(named=True):
        state = result.states.filter(
            pl.col("topic") == row["topic"], pl.col("message_index") == row["message_index"]
        ).row(0, named=True)
        assert state["source"] == "recorded"
        assert state["vehicle_id"] == row["vehicles"][0]
        assert abs(state["time_ns"] - row["worst_ns"]) < 100_000_001


def test_what_only_the_order_of_the_log_told_is_taken_over(replayed: Replay) -> None:
    result = replayed.result
    start = result.states["time_ns"].min()
    assert isinstance(start, int)
    none = pl.lit(None, dtype=pl.String)
    told = result.findings.head(1).with_columns(
        rule=pl.lit("data_clock_step"), verdict=pl.lit("inconclusive"), severity=none, unit=pl.lit("s"),
        vehicles=pl.lit(["1"]), start_ns=start, worst_ns=start + 1, end_ns=start + 10_000_000_000,
    )  # fmt: skip
    stepped = replace(result, findings=pl.concat([result.findings, told]))
    again = audit_result(stepped, Config())
    assert again.findings.filter(pl.col("rule") == "data_clock_step").height == 1
    doubted = again.findings.filter(pl.col("vehicles").list.contains("1"), pl.col("severity").is_not_null())
    assert set(doubted["verdict"]) == {Verdict.INCONCLUSIVE.value}


def test_a_broken_plan_fails_the_audit(replayed: Replay) -> None:
    result: Result = replayed.result
    planned = pl.col("source") == "planned"
    shifted = result.states.with_columns(x_m=pl.when(planned).then(pl.col("x_m") + 0.5).otherwise("x_m"))
    audit = istc_replay.audit(replace(result, states=shifted))
    assert "fail" in set(audit.certificates["verdict"])
    assert audit.verdict == Verdict.FAIL


def test_the_audit_takes_a_log_a_file_a_folder_and_a_result(replayed: Replay, tmp_path: Path) -> None:
    (tmp_path / "result.mcap").write_bytes(replayed.mcap)
    of_log = istc_replay.audit(TURN_FIRST)
    assert not of_log.of_result
    assert of_log.certificates.is_empty()
    found = [
        istc_replay.audit(source) for source in (tmp_path, str(tmp_path / "result.mcap"), replayed.result)
    ]
    for audit in found:
        assert audit.findings.drop("topic").equals(found[0].findings.drop("topic"))


def test_a_plan_that_is_feasible_but_not_proven_optimal_is_a_minor_finding(replayed: Replay) -> None:
    # In the fast mode nothing is proven.
    found = istc_replay.audit(replayed.result).findings.filter(pl.col("rule") == "not_proven_optimal")
    assert found.height == 1
    row = found.row(0, named=True)
    assert (row["severity"], row["verdict"], row["vehicles"], row["topic"]) == (
        "minor",
        "fail",
        [],
        "/istc/solves",
    )
    assert "not proven optimal" in row["detail"]
    window = replayed.result.summary["windows"][0]
    proven = {**window, "corridors": {**window["corridors"], "status": "optimal", "gap": 1e-6}}
    summary = {**replayed.result.summary, "windows": [proven]}
    told = istc_replay.audit(replace(replayed.result, summary=summary)).findings["rule"]
    assert "not_proven_optimal" not in set(told)
