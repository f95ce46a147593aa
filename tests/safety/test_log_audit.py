"""The audit of whole logs: nothing wrong gives nothing, and what is planted is found, alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

from istc_replay.config import AuditConfig, Config, parse_config
from istc_replay.datatypes import Log, Verdict
from istc_replay.errors import LogError
from istc_replay.ingest.log import read_log
from istc_replay.safety.log_audit import Audit, audit_log
from istc_replay.safety.rules import CORRIDOR_RULE, PAIR_RULES, PET_RULE, VEHICLE_RULES
from istc_replay.states import (
    COVERAGE_SCHEMA,
    ENCOUNTERS_SCHEMA,
    FINDINGS_SCHEMA,
    PAIR_SAMPLES_SCHEMA,
    VEHICLE_SAMPLES_SCHEMA,
)

from ..support.encounters import AHEAD, T, bend, calm, drive, east, near_miss, north, recorded
from ..support.tracks import log_of

Array = NDArray[np.float64]
NS = 1_000_000_000
ROOT = Path(__file__).resolve().parents[2]


def findings(audit: Audit) -> list[tuple[str, str | None, list[str]]]:
    return audit.findings.select("rule", "severity", "vehicles").rows()


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


def test_a_crash_is_found_with_its_measures() -> None:
    stopping = np.where(T < 6.3, 10.0, 0.0)
    x, v = drive(stopping, -64.0)
    log = log_of(
        recorded("a", T, x_m=x, speed_mps=v),
        recorded("b", T, x_m=0.0, speed_mps=0.0),
        *calm()[7:9],
    )
    audit = audit_log(log, Config())
    by_rule = {
        row["rule"]: row for row in audit.findings.iter_rows(named=True) if row["vehicles"] == ["a", "b"]
    }
    assert by_rule["gap"]["severity"] == "critical"
    assert by_rule["gap"]["detail"].startswith("collision")
    assert by_rule["ttc"]["severity"] == "critical"
    assert by_rule["drac"]["severity"] == "critical"
    assert by_rule["required_deceleration"]["severity"] == "critical"
    assert by_rule["ttc"]["start_ns"] - log.start_ns == pytest.approx((5.95 - 3.0) * NS, abs=0.11 * NS)
    row = audit.encounters.row(0, named=True)
    assert row["conflict_type"] == "rear_end"
    assert row["delta_v_first_mps"] == pytest.approx(5.0)
    # From 3 s before contact on: TIT is half of 3 squared.
    assert row["tet_s"] == pytest.approx(3.0, abs=0.2)
    assert row["tit_s2"] == pytest.approx(4.5, abs=0.35)


def test_tailgating_and_danger_by_rss_are_found() -> None:
    log = log_of(east("a", 20.0, 0.0), east("b", 20.0, -4.5 - 14.0))
    found = findings(audit_log(log, Config()))
    assert found == [("rss", "minor", ["a", "b"]), ("thw", "serious", ["a", "b"])]


def test_only_grazing_is_no_time_to_collision() -> None:
    def passing(offset: float) -> list[tuple[str, str | None, list[str]]]:
        log = log_of(
            recorded("mover", T, x_m=10 * T - 60, y_m=offset, speed_mps=10.0),
            recorded("parked", T, x_m=0.0, speed_mps=0.0),
        )
        return [row for row in findings(audit_log(log, Config())) if row[0] not in ("rss", "thw")]

    assert passing(2.5) == []  # 0.6 m beside
    assert [rule for rule, _, _ in passing(2.3)] == ["gap"]  # 0.4 m
    assert [rule for rule, _, _ in passing(1.85)] == ["gap"]  # 5 cm of overlap: grazing
    assert {"ttc", "drac", "gap"} <= {rule for rule, _, _ in passing(1.5)}


@pytest.mark.parametrize(
    ("rule", "columns", "severity"),
    [
        ("braking", {"speed_mps": np.clip(20 - 5 * (T - 4), 0, 20)}, "serious"),
        ("braking", {"speed_mps": np.clip(20 - 8 * (T - 4), 0, 20)}, "critical"),
        ("jerk", {"speed_mps": 10 + 0.5 * np.sin(4 * T)}, "minor"),
    ],
)
def test_single_vehicles_are_judged(rule: str, columns: dict[str, Any], severity: str) -> None:
    x, v = drive(columns["speed_mps"])
    audit = audit_log(log_of(recorded("a", T, x_m=x, speed_mps=v)), Config())
    assert (rule, severity, ["a"]) in findings(audit)


def test_turning_is_judged_by_lateral_acceleration_yaw_rate_and_the_bicycle() -> None:
    assert findings(audit_log(log_of(bend("a", 40.0, 13.0)), Config())) == []
    fast = audit_log(log_of(bend("a", 40.0, 15.0)), Config())
    assert findings(fast) == [("lateral_acceleration", "minor", ["a"])]
    assert fast.findings["value"][0] == pytest.approx(15.0**2 / 40.0, rel=5e-3)
    tight = audit_log(log_of(bend("a", 2.5, 3.0)), Config())
    assert {rule for rule, _, _ in findings(tight)} == {"curvature", "yaw_rate"}
    steering = tight.vehicle_samples["steering_rad"].drop_nulls()
    assert steering.mean() == pytest.approx(np.arctan(2 * AHEAD / np.sqrt(2.5**2 - AHEAD**2)), rel=1e-2)


def test_speeds_are_judged_where_a_limit_is_given() -> None:
    log = log_of(east("a", 15.0, 0.0))
    assert findings(audit_log(log, Config())) == []
    limited = audit_log(log, parse_config("[audit]\nspeed_limit_mps = 13.9"))
    assert findings(limited) == [("speed_limit", "minor", ["a"])]
    assert limited.findings["value"][0] == pytest.approx(1.1)


def test_thresholds_are_those_of_the_configuration_and_say_so() -> None:
    log = log_of(*near_miss())
    config = parse_config("[audit]\npet_critical_s = 0.2\npet_serious_s = 0.3")
    found = audit_log(log, config).findings
    assert found["severity"].to_list() == ["minor"]
    assert found["threshold_source"].to_list() == ["SSAM"]
    moved = audit_log(log, parse_config("[audit]\npet_critical_s = 0.9")).findings
    assert moved["threshold_source"].to_list() == ["configured: audit.pet_critical_s"]
    assert moved["finding_id"].to_list() == found["finding_id"].to_list()


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


def test_recorded_traffic_is_audited_whole() -> None:
    folder = ROOT / ".." / "shared" / "logs" / "third_party"
    if not folder.exists():
        pytest.skip("the recorded traffic of others is not beside the repository")
    read = {
        path.stem: audit_log(read_log(path), Config())
        for path in sorted(folder.glob("*.mcap"))
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


def turning(name: str, start: float, *, turns: bool) -> pl.DataFrame:
    """East at 8 m/s; at x = 0 straight on, or into a bend of 10 m to the north."""
    s = 8.0 * T + start
    angle = np.clip(s / 10.0, 0.0, np.pi / 2) * turns
    bent, rest = 10.0 * angle, np.maximum(s - 10.0 * np.pi / 2, 0.0) * turns
    x = np.where(s < 0, s, 10.0 * np.sin(angle) if turns else s)
    y = np.where(s < 0, 0.0, 10.0 * (1 - np.cos(angle)) + rest)
    assert bent.max() <= 10.0 * np.pi / 2
    return recorded(name, T, x_m=x, y_m=y, heading_rad=angle, speed_mps=8.0, rear_axle_to_centre_m=0.0)


def test_who_follows_and_then_turns_off_has_a_headway_and_no_encroachment() -> None:
    log = log_of(turning("a", -40.0, turns=False), turning("b", -40.0 - 20.0, turns=True))
    rules = {rule for rule, _, who in findings(audit_log(log, Config())) if len(who) == 2}
    assert "pet" not in rules
    # Apart from where it turns, it keeps 15.5 m at 8 m/s.
    assert "thw" not in rules


def test_a_queue_that_closes_up_gently_is_no_finding_and_one_that_does_so_hard_is() -> None:
    def closing(speed: Array) -> set[str]:
        x, v = drive(speed)
        x = x - x[-1] - 4.5 - 0.9  # stops 0.9 m behind
        log = log_of(recorded("b", T, x_m=x, speed_mps=v), recorded("c", T, x_m=0.0, speed_mps=0.0))
        return {rule for rule, _, who in findings(audit_log(log, Config())) if len(who) == 2}

    assert closing(np.clip(4.0 - 1.5 * (T - 5), 0, 4)) == set()
    assert "drac" in closing(np.clip(4.0 - 8.0 * (T - 5), 0, 4))


def test_contact_is_one_encroachment_of_zero_and_the_encounter_tells_how_near_they_came() -> None:
    log = log_of(
        recorded("a", T, x_m=10 * T - 60, speed_mps=10.0),
        north("b", 10.0, -61.0),
        *calm()[7:9],
    )
    audit = audit_log(log, Config())
    pet = audit.findings.filter(pl.col("rule") == "pet")
    assert (pet.height, pet["value"][0], pet["severity"][0]) == (1, 0.0, "critical")
    row = audit.encounters.row(0, named=True)
    assert (row["least_pet_s"], row["least_gap_m"] < -0.5, row["severity"]) == (0.0, True, "critical")
    # Two of one size at right angles: half of 10 sqrt 2 each.
    assert row["delta_v_first_mps"] == pytest.approx(10 * np.sqrt(2) / 2)


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


def test_the_sign_of_an_encroachment_says_who_was_first() -> None:
    names = {"ann": "zoe", "bob": "abe"}
    told = []
    renamed = [part.with_columns(pl.col("vehicle_id").replace(names)) for part in near_miss()]
    for parts in (near_miss(), renamed):
        audit = audit_log(log_of(*parts), Config())
        row = audit.encounters.row(0, named=True)
        assert row["least_pet_s"] == row["event_pet_s"] == audit.findings["value"][0]
        # Positive: the first named was there first, and it is named in the detail.
        first = row["first"] if row["least_pet_s"] > 0 else row["second"]
        assert audit.findings["detail"][0].startswith(f"{first} first")
        told.append((first, abs(row["least_pet_s"])))
    assert told[0][1] == pytest.approx(told[1][1])
    assert names[told[0][0]] == told[1][0]


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


def test_every_level_of_every_rule_is_configurable_and_says_so() -> None:
    for rule in (*PAIR_RULES, PET_RULE, *VEHICLE_RULES, CORRIDOR_RULE):
        for level in rule.levels:
            if level is None or not isinstance(level[0], str):
                continue
            key = level[0]
            default = AuditConfig.model_fields[key].default or 10.0  # unset, or a limit of zero
            # A hair past the default, so that the order of the levels stands.
            changed = AuditConfig.model_validate({key: default * (1.0 + 1e-9)})
            sources = {value: source for _, value, source in rule.thresholds(changed)}
            assert sources[default * (1.0 + 1e-9)] == f"configured: audit.{key}", (rule.name, key)
