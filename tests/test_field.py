"""Recorded traffic that cannot be planned as it is: gaps lowered, and who stays as recorded."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config
from istc_replay.field import Repairs, least_cover, prepare
from istc_replay.scenario import build_scenario
from istc_replay.trajectories.repair import RecordingRepairer
from istc_replay.windows import settled_config

from .support.planning import first_part, planned, replayed
from .support.tracks import BUSY, driver, log_of


def test_the_gap_is_lowered_to_what_was_recorded_and_the_certificate_holds_it() -> None:
    close = log_of(driver("1"), driver("2", 2.0))  # 0.2 m from side to side
    done, window = replayed(close)
    assert window["status"] == "certified"
    assert window["vehicle_gap_m"] == pytest.approx(0.15, abs=0.03)
    check = next(c for c in window["certificate"]["checks"] if c["check"] == "cubes_disjoint")
    assert f"promised {window['vehicle_gap_m']:g} m" in check["detail"]
    assert done.exit_code == 0


@pytest.mark.parametrize(
    ("lane_m", "ahead_m", "reason"),
    # Recorded through vehicle 1, and bumper to bumper with it at 12 m/s.
    [(0.5, 1.0, "overlap_at_start"), (0.0, 4.55, "no_relation")],
)
def test_a_pair_without_a_way_is_named_and_the_others_are_planned_around_it(
    lane_m: float, ahead_m: float, reason: str
) -> None:
    ghost = driver("9", lane_m, ahead_m)
    done, window = replayed(log_of(driver("1"), driver("2", 5.0), driver("3", -6.0), ghost))
    assert window["status"] == "partial"
    frozen = {entry["vehicle_id"]: entry for entry in window["frozen"]}
    assert set(frozen) == {"1", "9"}
    assert all(entry["reason"] == reason for entry in frozen.values())
    assert (window["vehicles_certified"], window["vehicles_plannable"], window["vehicles_present"]) == (
        2,
        4,
        4,
    )
    assert window["certificate"]["verdict"] == "pass"
    assert set(done.result.obstacles["obstacle_id"].unique()) == {"1", "9"}
    of_plans = done.result.states.filter(pl.col("source") == "planned")
    assert set(of_plans["vehicle_id"].unique()) == {"2", "3"}
    assert done.exit_code == 4


def test_the_fewest_vehicles_give_way() -> None:
    participants = planned(BUSY).scenario.participants
    assert least_cover([("1", "2"), ("2", "3"), ("2", "4")], participants) == ("2",)
    assert least_cover([("1", "wall"), ("1", "2")], participants) == ("1",)
    assert least_cover([], participants) == ()


def test_preparation_keeps_neighbours_narrow() -> None:
    log = log_of(driver("1"), driver("2", 2.2), driver("3", 12.0))
    config = settled_config(log, Config())
    scenario = build_scenario(first_part(log, config), config, 0.5)
    ready = prepare(scenario, config, Repairs(RecordingRepairer(config.trajectories)), 20.0)
    slack = {g.vehicle_id: np.degrees(np.asarray(g.slack_rad)) for g in ready.guidance}
    assert slack["1"].max() == pytest.approx(1.5, abs=0.05)
    assert slack["3"].max() > 3.0
