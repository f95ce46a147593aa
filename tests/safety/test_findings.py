"""What is planted in recorded traffic is found by its rule, and what only looks like it is not."""

from __future__ import annotations

from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

from istc_replay.config import HARDEST_BRAKING_MPS2, Config, parse_config
from istc_replay.errors import ConfigError
from istc_replay.safety.log_audit import audit_log

from ..support.encounters import AHEAD, T, bend, calm, drive, east, findings, near_miss, north, recorded
from ..support.tracks import log_of

Array = NDArray[np.float64]
NS = 1_000_000_000


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


def test_braking_ends_at_what_a_car_can_do_however_near_contact_is() -> None:
    """8 m/s towards a car that stands, never braked: at the last instant contact is 1e-9 m away."""
    x = 8.0 * (T - T[-1]) - 4.5 - 1e-6
    moving = recorded("a", T, x_m=x, speed_mps=8.0)
    audit = audit_log(log_of(moving, recorded("b", T, x_m=0.0, speed_mps=0.0)), Config())
    gaps, drac = audit.pair_samples["gap_m"].to_numpy(), audit.pair_samples["drac_mps2"].to_numpy()
    far = 8.0**2 / (2.0 * gaps) < HARDEST_BRAKING_MPS2
    assert np.allclose(drac[far], 8.0**2 / (2.0 * gaps[far]))
    assert (drac[~far] == HARDEST_BRAKING_MPS2).all()
    assert (~far).sum() > 2
    found = {row["rule"]: row for row in audit.findings.iter_rows(named=True)}
    for rule in ("drac", "required_deceleration"):
        assert found[rule]["value"] == HARDEST_BRAKING_MPS2
        assert "no car brakes so hard" in found[rule]["detail"]
    # Its worst instant is the first from which braking comes too late: 2.5 m away.
    late = audit.pair_samples.filter(pl.col("drac_mps2") == HARDEST_BRAKING_MPS2)["time_ns"].min()
    assert found["drac"]["worst_ns"] == late
    assert audit.encounters["most_drac_mps2"].to_list() == [HARDEST_BRAKING_MPS2]
    assert audit.encounters["most_required_mps2"].to_list() == [HARDEST_BRAKING_MPS2]


def test_a_level_that_no_car_brakes_is_refused() -> None:
    with pytest.raises(ConfigError, match="drac_critical_mps2"):
        parse_config("[audit]\ndrac_critical_mps2 = 15.0")


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


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_braking_is_slowing_down_whichever_way_a_vehicle_drives(way: float) -> None:
    braking, starting = np.clip(14.0 - 7.0 * (T - 4.0), 0.0, 14.0), np.clip(7.0 * (T - 4.0), 0.0, 14.0)
    for speed, rules in ((braking, {"braking"}), (starting, set())):
        x, v = drive(way * speed)
        found = audit_log(log_of(recorded("a", T, x_m=x, speed_mps=v)), Config()).findings
        assert set(found["rule"]) & {"braking"} == rules
        if rules:
            assert found.filter(pl.col("rule") == "braking")["value"].max() == pytest.approx(7.0, abs=0.3)


@pytest.mark.parametrize(("overlap_m", "certain"), [(0.3, True), (0.005, False)])
def test_an_overlap_within_the_sampling_bound_is_a_possible_collision(
    overlap_m: float, certain: bool
) -> None:
    # 10 Hz: each is known to 10 * 0.1^2 / 8 = 0.0125 m between its samples.
    aside = 1.9 - overlap_m
    log = log_of(
        recorded("a", T, x_m=8.0 * T - 40.0, y_m=aside, speed_mps=8.0),
        recorded("b", T, x_m=0.0, speed_mps=0.0),
    )
    (detail,) = audit_log(log, Config()).findings.filter(pl.col("rule") == "gap")["detail"]
    assert ("collision: the boxes overlap by more than the sampling bound of 0.025 m" in detail) == certain
    assert ("possible collision: within the sampling bound" in detail) != certain


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


@pytest.mark.parametrize(("start", "heading", "rules"), [(45.0, 0.0, {"ttc"}), (9.0, np.pi, set())])
def test_who_backs_up_is_judged_by_where_it_drives_not_by_where_it_looks(
    start: float, heading: float, rules: set[str]
) -> None:
    # To the west it backs up to a standing car, to the east it backs away from one that it faces.
    course = np.pi + heading
    backing = recorded("a", T, x_m=start + 3.0 * np.cos(course) * T, speed_mps=-3.0, heading_rad=heading)
    standing = recorded("b", T, x_m=0.0, speed_mps=0.0)
    audit = audit_log(log_of(backing, standing), Config())
    assert {rule for rule, _, who in findings(audit) if len(who) == 2} >= rules
    assert bool(findings(audit)) == bool(rules)
    nearest = audit.pair_samples.filter(pl.col("ttc_s").is_finite()).sort("gap_m").head(1)
    told = nearest.select("gap_m", "ttc_s").rows()
    assert told == ([(pytest.approx(4.5, abs=0.01), pytest.approx(1.5, abs=0.01))] if rules else [])


def test_a_gap_is_as_uncertain_as_both_positions_between_their_samples() -> None:
    rare = np.arange(0, 12.01, 0.5)
    log = log_of(
        recorded("a", T, x_m=8.0 * T, speed_mps=8.0),
        recorded("b", rare, x_m=8.0 * rare, y_m=3.0, speed_mps=8.0),
    )
    samples = audit_log(log, Config()).pair_samples
    bound = Config().audit.acceleration_bound_mps2 / 8.0
    assert samples.height > 20
    np.testing.assert_allclose(samples["gap_bound_m"], bound * (0.1**2 + 0.5**2))
