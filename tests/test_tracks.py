"""What of a recorded track can be planned, and what it is in the way while it is not."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config, parse_config
from istc_replay.pipeline.replay import replay_read
from istc_replay.scenario import build_scenario

from .support.planning import FAST, first_part, replayed
from .support.tracks import driver, log_of


def test_roles_and_minimal_data_decide_who_is_planned() -> None:
    standing = np.zeros(41)
    rare = driver("rare", 16.0).gather_every(5)
    log = log_of(
        driver("1"),
        driver("2", 4.0),
        driver("parked", -6.0, 60.0, speed_mps=0.0),
        driver("back", -12.0, speed_mps=-2.0),
        driver("liar", 12.0, x_m=standing + np.arange(41) * 0.5),
        driver("walker", 20.0, 5.0, 1.0, role=["pedestrian"] * 41),
        rare,
    )
    config = Config.model_validate({"vehicles": {"by_id": {"2": {"cooperative": False}}}})
    scenario = build_scenario(first_part(log, config), config, 0.5)
    assert [p.vehicle_id for p in scenario.participants] == ["1"]
    assert {e.vehicle_id: e.reason for e in scenario.excluded} == {
        "2": "uncooperative",
        "parked": "parked",
        "back": "reversing",
        "liar": "speed_mismatch",
        "walker": "not_a_vehicle",
        "rare": "low_rate",
    }
    boxes = {o.obstacle_id: o.boxes_m for o in scenario.obstacles}
    assert set(boxes) == {"2", "parked", "back", "liar", "walker", "rare"}
    assert np.isfinite(boxes["2"]).all()
    width = boxes["2"][:, 1] - boxes["2"][:, 0]
    np.testing.assert_allclose(width, 4.5 + 12.0 * 0.5, atol=0.2)


def test_a_track_that_no_car_can_drive_is_an_obstacle() -> None:
    jump = np.where(np.arange(41) < 20, 6.0, 9.5)  # changes lanes within a tenth of a second
    done, window = replayed(log_of(driver("1"), driver("2", y_m=jump)))
    assert [(e["vehicle_id"], e["reason"]) for e in window["exclusions"]] == [("2", "undrivable_track")]
    assert (window["status"], window["vehicles_plannable"]) == ("certified", 1)
    assert done.result.obstacles["obstacle_id"].unique().to_list() == ["2"]


def test_a_turn_tighter_than_the_steering_allows_is_told_with_both_radii() -> None:
    # A U-turn with a radius of 1.6 m, as simulators drive it.
    way = np.arange(41) * 0.4
    angle = np.clip((way - 4.0) / 1.6, 0.0, np.pi)
    x = np.concatenate([[0.0], np.cumsum(0.4 * np.cos(angle[:-1]))])
    y = np.concatenate([[0.0], np.cumsum(0.4 * np.sin(angle[:-1]))])
    speed = np.full(41, 4.0)
    _, window = replayed(
        log_of(driver("1", 20.0), driver("2", x_m=x, y_m=y, heading_rad=angle, speed_mps=speed))
    )
    (entry,) = window["exclusions"]
    assert (entry["vehicle_id"], entry["reason"]) == ("2", "undrivable_track")
    assert "it turns with a radius of 1.6 m, where its steering allows 4.7 m" in entry["detail"]


def test_braking_as_hard_as_a_dry_road_allows_is_drivable() -> None:
    speed = np.clip(14.0 - 7.5 * np.maximum(np.arange(41) / 10.0 - 1.5, 0.0), 0.0, None)
    way = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 20.0)])
    _, window = replayed(log_of(driver("1", x_m=way, speed_mps=speed)))
    assert (window["status"], window["vehicles_certified"]) == ("certified", 1)


def test_a_vehicle_that_stays_for_one_unit_is_planned_in_it() -> None:
    brief = driver("2", 4.0).filter(pl.col("time_ns") >= 3_300_000_000)
    config = FAST.model_copy(update={"window": FAST.window.model_copy(update={"unit_s": 0.5})})
    done, window = replayed(log_of(driver("1"), brief), config)
    assert (window["vehicles_certified"], window["vehicles_present"]) == (2, 2)
    cubes = done.result.corridors.filter(pl.col("vehicle_id") == "2")
    assert cubes["k"].to_list() == [7]


def test_who_is_seen_at_a_windows_first_or_last_instant_alone_is_of_the_one_beside() -> None:
    horizon = "window = { horizon_s = 4.0, stride_s = 4.0, unit_s = 0.5 }"
    config = parse_config('corridors.mode = "fast"\n' + horizon)
    log = log_of(
        driver("stays", seconds=8.0),
        driver("leaves", 4.0, seconds=8.0).filter(pl.col("time_ns") <= 4 * 10**9),
        driver("enters", -4.0, seconds=8.0).filter(pl.col("time_ns") >= 4 * 10**9),
        driver("flash", 9.0, seconds=8.0).filter(pl.col("time_ns") == 4 * 10**9),
    )
    windows = replay_read(log, config).summary["windows"]
    here = [{v["id"] for v in w["vehicles"]} for w in windows]
    assert here == [{"stays", "leaves"}, {"stays", "enters"}]
    assert [[(e["vehicle_id"], e["reason"]) for e in w["exclusions"]] for w in windows] == [
        [("flash", "one_sample")]
    ] * 2
    assert [w["vehicles_present"] for w in windows] == [3, 3]


def test_who_enters_within_a_unit_is_an_obstacle_until_it_is_planned() -> None:
    late = driver("2", 4.0).filter(pl.col("time_ns") >= 700_000_000)
    log = log_of(driver("1"), late)
    scenario = build_scenario(first_part(log, Config()), Config(), 0.5)
    assert [(p.vehicle_id, p.first_unit) for p in scenario.participants] == [("1", 0), ("2", 2)]
    boxes = {o.obstacle_id: o.boxes_m for o in scenario.obstacles}
    assert set(boxes) == {"2"}
    assert np.isfinite(boxes["2"]).all(axis=1).tolist() == [False, True] + [False] * 6
    assert boxes["2"][1, 1] - boxes["2"][1, 0] == pytest.approx(4.5 + 12.0 * 0.3, abs=0.1)
