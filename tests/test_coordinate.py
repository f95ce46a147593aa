"""One window through both layers, wherever, whenever and under which names it was recorded."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config
from istc_replay.datatypes import Log, WindowPlan, WindowStatus

from .support.planning import FAST, map_motion, planned, replayed
from .support.tracks import BUSY, driver, log_of, turned


@pytest.fixture(scope="module")
def busy_plan() -> WindowPlan:
    """The plan of the busy log: all four are planned."""
    plan = planned(BUSY)
    assert [t.vehicle_id for t in plan.trajectories] == ["1", "2", "3", "4"]
    return plan


@pytest.mark.parametrize("angle_deg", [23.0, 45.0, 131.0, -78.0])
def test_a_turned_and_shifted_log_has_the_same_plan(angle_deg: float, busy_plan: WindowPlan) -> None:
    angle, shift = np.radians(angle_deg), (3_000.0, -7_000.0)
    original, other = map_motion(busy_plan), map_motion(planned(turned(BUSY, angle, shift)))
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    assert original.keys() == other.keys() == {"1", "2", "3", "4"}
    for vehicle, motion in original.items():
        np.testing.assert_allclose(other[vehicle], motion @ turn.T + shift, atol=0.02)


def test_a_window_is_planned_about_its_own_origin_wherever_it_was_recorded(busy_plan: WindowPlan) -> None:
    far = (4.0e7, -3.0e7)
    here, there = busy_plan, planned(turned(BUSY, 0.0, far))
    frames = [plan.scenario.window.frame for plan in (here, there)]
    assert (frames[1].x_m - frames[0].x_m, frames[1].y_m - frames[0].y_m) == far
    for plan in (here, there):
        assert max(np.abs(p.recording.poses[:, :2]).max() for p in plan.scenario.participants) < 60.0
    for one, other in zip(here.trajectories, there.trajectories, strict=True):
        np.testing.assert_allclose(other.states, one.states, atol=1e-5)


def test_a_log_recorded_at_another_time_under_other_names_has_the_same_plan(busy_plan: WindowPlan) -> None:
    names = {"1": "car a", "2": "car b", "3": "car c", "4": "car d"}
    states = BUSY.states.with_columns(
        time_ns=pl.col("time_ns") + 1_700_000_000_123_456_789, vehicle_id=pl.col("vehicle_id").replace(names)
    )
    other = planned(replace(BUSY, states=states))
    for one, same in zip(busy_plan.trajectories, other.trajectories, strict=True):
        assert same.vehicle_id == names[one.vehicle_id]
        np.testing.assert_allclose(same.states, one.states, atol=1e-6)


def test_where_nothing_needs_to_change_the_plan_is_the_recording() -> None:
    plan = planned(log_of(driver("1"), driver("2", 4.0, 3.0)))
    for trajectory, participant in zip(plan.trajectories, plan.scenario.participants, strict=True):
        recorded = participant.recording
        at = np.stack([np.interp(trajectory.times_s, recorded.times_s, c) for c in recorded.poses.T], axis=-1)
        ahead = trajectory.dimensions.rear_axle_to_centre_m
        heading = trajectory.states[:, 2]
        centres = trajectory.states[:, :2] + ahead * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        np.testing.assert_allclose(centres, at[:, :2], atol=0.05)


def crossing_log() -> Log:
    """Two cars to the east and two to the north, whose ways cross at the same time."""
    north = np.arange(41) / 10.0
    tracks = [driver("1", 0.0, -20.0, 10.0), driver("2", 0.0, -35.0, 10.0)]
    for name, behind in (("3", 20.0), ("4", 36.0)):
        track = driver(name, speed_mps=10.0, heading_rad=np.full(41, np.pi / 2))
        tracks.append(track.with_columns(x_m=pl.lit(0.0), y_m=pl.Series(10.0 * north - behind)))
    return log_of(*tracks)


def with_corridors(**changes: Any) -> Config:
    """Fast settings with changes of layer 1."""
    return FAST.model_copy(update={"corridors": FAST.corridors.model_copy(update=changes)})


@pytest.mark.parametrize("budget", [{"group_vehicles_max": 1}, {"tree_node_budget": 2}])
def test_a_group_past_the_budget_is_planned_one_against_the_other_and_told(budget: dict[str, int]) -> None:
    jointly = replayed(crossing_log())[1]
    done, window = replayed(crossing_log(), with_corridors(**budget))
    assert (jointly["status"], jointly["reason"]) == ("certified", "")
    assert (window["status"], window["vehicles_certified"]) == ("certified", 4)
    told = "too many to plan at once, planned one after the other: 1, 2, 3, 4"
    assert window["reason"] == window["corridors"]["reason"] == told
    tree = done.result.solves.filter(pl.col("stage") == "conflict tree")
    assert tree["detail"].to_list()[-1] == told
    assert window["certificate"]["verdict"] == "pass"


def test_of_a_group_past_the_budget_who_finds_no_place_stays_as_recorded_and_is_named() -> None:
    # Vehicle 9 drives bumper to bumper with vehicle 1: the others are planned around both or one of them.
    ghost = driver("9", 0.0, -15.45, 10.0)
    config = with_corridors(group_vehicles_max=1)
    _, window = replayed(replace(crossing_log(), states=pl.concat([crossing_log().states, ghost])), config)
    assert window["status"] == "partial"
    frozen = {entry["vehicle_id"]: entry["reason"] for entry in window["frozen"]}
    assert frozen == {"1": "no_relation", "9": "no_relation"}
    assert {v["id"] for v in window["vehicles"]} == {"2", "3", "4"}
    assert window["vehicles_certified"] == 3
    assert window["certificate"]["verdict"] == "pass"


def test_a_close_pair_is_planned_at_a_finer_time_unit_before_any_is_frozen() -> None:
    # 2.2 m between the bumpers at 12 m/s: a least cube is 6 m longer than the car at 0.5 s, 1.5 m at 0.125 s.
    plan = planned(log_of(driver("1"), driver("2", 0.0, 6.7), driver("3", 4.0)))
    assert plan.scenario.window.unit_s == 0.125
    assert (plan.frozen, len(plan.trajectories)) == ((), 3)


#: A car that stands, and at the end moves on by a metre.
CREEP = np.maximum(np.arange(41) / 10.0 - 3.0, 0.0)


def test_cars_that_pass_closely_at_an_angle_are_held_to_their_headings() -> None:
    # 0.03 m beside each other, one standing at 4 degrees: headings free by a degree leave no room.
    width_m = 1.8 * np.cos(np.radians(4.0)) / 2.0 + 4.5 * np.sin(np.radians(4.0)) / 2.0 + 0.9
    other = driver(
        "2", width_m + 0.03, 0.0, speed_mps=0.0, heading_rad=np.full(41, np.radians(4.0)), x_m=5.0 + CREEP
    )
    plan = planned(log_of(driver("1"), other))
    assert (plan.frozen, len(plan.trajectories)) == ((), 2)
    slack = {g.vehicle_id: np.degrees(np.asarray(g.slack_rad)) for g in plan.guidance}
    assert slack["2"].min() == pytest.approx(0.2)


def test_constant_speed_remains_a_choice_for_traffic() -> None:
    config = FAST.model_copy(update={"guidance": FAST.guidance.model_copy(update={"law": "constant"})})
    plan = planned(BUSY, config)
    assert plan.status is WindowStatus.NOT_CERTIFIED
    assert all(g.slack_rad is None for g in plan.guidance)
