"""The audit of whole logs: nothing wrong gives nothing, however the world is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config
from istc_replay.datatypes import Log, Verdict
from istc_replay.errors import LogError
from istc_replay.ingest.log import read_log
from istc_replay.safety.log_audit import Audit, audit_log
from istc_replay.states import (
    COVERAGE_SCHEMA,
    ENCOUNTERS_SCHEMA,
    FINDINGS_SCHEMA,
    PAIR_SAMPLES_SCHEMA,
    VEHICLE_SAMPLES_SCHEMA,
)

from ..support.encounters import T, calm, east, findings, near_miss, recorded
from ..support.tracks import log_of

NS = 1_000_000_000


def test_a_log_with_nothing_wrong_has_no_finding() -> None:
    audit = audit_log(log_of(*calm()), Config())
    assert findings(audit) == []
    assert audit.encounters.is_empty()
    assert audit.verdict == Verdict.PASS
    assert audit.pair_samples.height > 900
    assert set(audit.coverage["verdict"]) == {"pass", "not_applicable"}


def test_a_planted_near_miss_is_found_and_nothing_else() -> None:
    log = log_of(*calm(), *near_miss())
    audit = audit_log(log, Config())
    assert audit.verdict == Verdict.FAIL
    assert audit.encounters.height == 1
    row = audit.encounters.row(0, named=True)
    assert (row["first"], row["second"], row["conflict_type"]) == ("ann", "bob", "crossing")
    assert row["verdict"] == "fail"
    assert row["least_pet_s"] == pytest.approx(0.6, abs=0.1001)
    assert row["event_pet_s"] == pytest.approx(0.6, abs=0.1001)
    assert {tuple(who) for _, _, who in findings(audit)} == {("ann", "bob")}
    assert set(audit.findings["rule"]) == {"pet"}
    assert set(audit.findings["severity"]) == {"critical"}
    found = audit.findings.row(0, named=True)
    assert found["threshold_source"] == "Varhelyi"
    assert found["encounter_id"] == row["encounter_id"]
    assert (found["topic"], found["message_index"]) == (
        "/ann",
        (found["worst_ns"] - log.start_ns) // (NS // 10),
    )


def transformed(log: Log, how: str) -> Log:
    states = log.states
    if how == "moved":
        states = states.with_columns(pl.col("x_m") + 448_000.0, pl.col("y_m") - 5_411_000.0)
    elif how == "turned":
        heading = (pl.col("heading_rad") + 0.6 + np.pi) % (2 * np.pi) - np.pi
        c, s = np.cos(0.6), np.sin(0.6)
        states = states.with_columns(
            (c * pl.col("x_m") - s * pl.col("y_m")).alias("x_m"),
            (s * pl.col("x_m") + c * pl.col("y_m")).alias("y_m"),
            heading.alias("heading_rad"),
        )
    elif how == "later":
        shift = 987_654_321_000
        states = states.with_columns(pl.col("time_ns", "log_time_ns", "publish_time_ns") + shift)
    elif how == "renamed":
        # The other way round in the alphabet: every pair is swapped.
        names = states["vehicle_id"].unique().sort().to_list()
        turned = {name: f"{len(names) - k:03d}" for k, name in enumerate(names)}
        states = states.with_columns(pl.col("vehicle_id").replace_strict(turned))
    return replace(log, states=states.sort("vehicle_id", "time_ns", maintain_order=True))


@pytest.mark.parametrize("how", ["moved", "turned", "later", "renamed"])
def test_findings_do_not_depend_on_how_the_world_is_told(how: str) -> None:
    log = log_of(
        *calm(),
        *near_miss(),
        east("x", 20.0, 0.0, y_m=200.0),
        east("y", 21.7, -24.0, y_m=200.5),
    )
    before, after = audit_log(log, Config()), audit_log(transformed(log, how), Config())

    def told(audit: Audit) -> list[tuple[Any, ...]]:
        rows = audit.findings.with_columns(
            pl.col("start_ns", "worst_ns", "end_ns") - audit.vehicle_samples["time_ns"].min(),
            pl.col("value").abs(),
        )
        return sorted(rows.select("rule", "severity", "start_ns", "worst_ns", "end_ns", "value").rows())

    assert len(told(before)) > 5
    for one, two in zip(told(before), told(after), strict=True):
        assert one[:-1] == two[:-1]
        assert one[-1] == pytest.approx(two[-1], rel=1e-5, abs=1e-6)


def test_the_same_log_gives_the_same_tables() -> None:
    log = log_of(*calm(), *near_miss())
    one, two = audit_log(log, Config()), audit_log(log, Config())
    for name in ("findings", "encounters", "pair_samples", "vehicle_samples", "coverage"):
        assert getattr(one, name).equals(getattr(two, name))


def test_vehicles_on_clocks_of_their_own_are_taken_to_common_times() -> None:
    a, b = near_miss()
    at = np.arange(0.037, 11.9, 0.07)
    shifted = recorded("bob", at, x_m=-600.0, y_m=10 * at + 27.6, speed_mps=10.0, heading_rad=np.pi / 2)
    one, two = audit_log(log_of(a, b), Config()), audit_log(log_of(a, shifted), Config())
    assert findings(two) == findings(one)
    assert two.encounters["least_gap_m"][0] == pytest.approx(one.encounters["least_gap_m"][0], abs=0.4)


def test_tables_have_their_schemas_even_of_an_empty_log() -> None:
    schemas = {
        "findings": FINDINGS_SCHEMA, "encounters": ENCOUNTERS_SCHEMA, "pair_samples": PAIR_SAMPLES_SCHEMA,
        "vehicle_samples": VEHICLE_SAMPLES_SCHEMA, "coverage": COVERAGE_SCHEMA,
    }  # fmt: skip
    full = log_of(*near_miss())
    lone = log_of(east("a", 5.0, 0.0).head(1))
    for log in (full, lone, replace(full, states=full.states.clear())):
        audit = audit_log(log, Config())
        for name, schema in schemas.items():
            assert getattr(audit, name).schema == schema
    assert audit.verdict == Verdict.INCONCLUSIVE  # nothing was judged


def test_what_is_not_known_is_not_judged_and_never_passes() -> None:
    a, b = near_miss()
    blind = b.with_columns(heading_rad=pl.lit(None, dtype=pl.Float64))
    audit = audit_log(log_of(a, blind), Config())
    assert findings(audit) == []
    of_bob = audit.coverage.filter(pl.col("vehicle_id") == "bob", pl.col("rule") == "ttc")
    assert of_bob["verdict"].to_list() == ["inconclusive"]
    assert of_bob["judged_s"].to_list() == [0.0]


def test_sizes_that_the_log_does_not_tell_are_said_to_be_assumed() -> None:
    a, b = (part.with_columns(length_m=pl.lit(None, dtype=pl.Float64)) for part in near_miss())
    audit = audit_log(log_of(a, b), Config())
    assert set(audit.coverage["dimensions_source"]) == {"default"}
    assert "size assumed: ann, bob" in audit.findings["detail"][0]


def test_recorded_traffic_is_audited_whole(shared_logs: Path) -> None:
    read = {
        path.stem: audit_log(read_log(path), Config())
        for path in sorted((shared_logs / "third_party").glob("*.mcap"))
        if "sumo" not in path.stem
    }
    walker = read["pedestrian"]
    assert set(walker.encounters["severity"]) == {"critical"}
    assert walker.encounters["conflict_type"].to_list() == ["crossing"]
    cut_in = read["alks_cut-in"].encounters.row(0, named=True)
    assert (cut_in["severity"], cut_in["consequence"]) == ("critical", None)
    # Recorded by cameras over a road: one pair of boxes overlaps as recorded.
    overlaps = {
        name: audit.findings.filter(pl.col("rule") == "gap", pl.col("value") < 0).height
        for name, audit in read.items()
    }
    assert {name for name, count in overlaps.items() if count} == {"USA_Lanker-1_1_T-1"}


def test_how_a_log_is_cut_into_chunks_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    log = log_of(*calm(), *near_miss(), east("x", 20.0, 0.0, y_m=200.0))
    whole = audit_log(log, Config())
    monkeypatch.setattr("istc_replay.safety.pair_samples._CHUNK_STATES", 150)
    cut = audit_log(log, Config())
    for name in ("findings", "encounters", "pair_samples", "vehicle_samples", "coverage"):
        assert getattr(whole, name).equals(getattr(cut, name))


@pytest.mark.parametrize("kind", ["nanoseconds", "years", "wild", "huge", "one instant"])
def test_odd_logs_are_audited_without_much_ado(kind: str) -> None:
    rng = np.random.default_rng(4)
    times = {
        "nanoseconds": np.concatenate([np.arange(200) * 1e-9, [3.0]]),
        "years": np.cumsum(rng.choice([0.1, 1e8], 60, p=[0.95, 0.05])),
        "one instant": np.zeros(50),
    }.get(kind, T)
    parts = []
    for name in ("a", "b", "c"):
        x = rng.normal(0, 5, times.size)
        if kind == "wild":
            x = rng.choice([0.0, 1e300, -1e300, np.nan, np.inf], times.size)
        speed = rng.normal(0, 1e308 if kind == "huge" else 5, times.size)
        parts.append(recorded(name, times, x_m=x, speed_mps=speed))
    audit = audit_log(log_of(*parts), Config())
    assert set(audit.findings["verdict"]) <= {"fail", "inconclusive"}
    assert audit.findings["finding_id"].n_unique() == audit.findings.height


def test_a_crowd_too_dense_for_the_memory_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("istc_replay.safety.broad_phase._MOST_PAIRS", 100)
    with pytest.raises(LogError, match="pairs of bodies are near each other"):
        audit_log(log_of(*calm()), Config())


def test_late_starts_and_early_ends_are_in_the_coverage_and_in_the_findings_that_touch_them() -> None:
    a, b = east("a", 20.0, 0.0), east("b", 20.0, -4.5 - 14.0)
    start = int(a["time_ns"].min())  # type: ignore[arg-type]
    short = b.filter(pl.col("time_ns").is_between(start + 2 * NS, start + 7 * NS))
    audit = audit_log(log_of(a, short), Config())
    row = audit.coverage.filter(pl.col("vehicle_id") == "b", pl.col("rule") == "thw").row(0, named=True)
    assert row["late_start_s"] == pytest.approx(2.0)
    assert row["early_end_s"] == pytest.approx(T[-1] - 7.0)
    assert (row["recorded_s"], row["judged_s"]) == (pytest.approx(5.0), pytest.approx(5.0, abs=0.11))
    detail = audit.findings.filter(pl.col("rule") == "thw")["detail"][0]
    assert "under way when a track begins" in detail
    assert "cut off by the end of a track" in detail
