"""Recorded traffic: every rule by which it is prepared, and who stays as recorded when a plan fails."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.apart import lateral_excursion_m
from istc_replay.config import Config, parse_config, render_config
from istc_replay.coordinate import Planners, plan_part, plan_window
from istc_replay.datatypes import Log, StaticScene, Trajectory, WindowPlan, WindowStatus
from istc_replay.field import Repairs, least_cover, prepare
from istc_replay.pipeline.replay import Replay, replay_read
from istc_replay.road_frame import Body, conflicts, heading_slack, road_yaw
from istc_replay.scenario import build_scenario, build_scenarios
from istc_replay.states import STATES_SCHEMA, conform
from istc_replay.trajectories.repair import RecordingRepairer
from istc_replay.windows import LogPart, log_parts, settled_config

FAST = Config.model_validate({"corridors": {"mode": "fast"}})


def driver(
    vehicle_id: str,
    lane_m: float = 0.0,
    ahead_m: float = 0.0,
    speed_mps: float = 12.0,
    seconds: float = 4.0,
    **columns: Any,
) -> pl.DataFrame:
    """A car that drives along its lane of a straight road to the east."""
    count = round(seconds * 10) + 1
    times = np.arange(count) / 10.0
    values = {
        "vehicle_id": [vehicle_id] * count,
        "time_ns": np.round(times * 1e9).astype(np.int64),
        "x_m": ahead_m + speed_mps * times,
        "y_m": np.full(count, lane_m),
        "heading_rad": np.zeros(count),
        "speed_mps": np.full(count, speed_mps),
        "length_m": np.full(count, 4.5),
        "width_m": np.full(count, 1.8),
        "role": ["vehicle"] * count,
    } | columns
    return conform(pl.DataFrame(values), STATES_SCHEMA)


def log_of(*tracks: pl.DataFrame) -> Log:
    """A log of field data: nothing of a scene is told."""
    states = pl.concat(tracks)
    return Log("field.mcap", "0" * 64, True, 0, 0, 0, 0, 0, 0, (), states, StaticScene(), ())


def turned(log: Log, angle_rad: float, shift_m: tuple[float, float]) -> Log:
    """The log turned about the origin and shifted."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y = pl.col("x_m"), pl.col("y_m")
    states = log.states.with_columns(
        x_m=c * x - s * y + shift_m[0],
        y_m=s * x + c * y + shift_m[1],
        heading_rad=pl.col("heading_rad") + angle_rad,
    )
    return replace(log, states=states)


def first_part(log: Log, config: Config) -> LogPart:
    """The part of the log's first window."""
    return next(log_parts(log, config))


def planned(log: Log, config: Config = FAST) -> WindowPlan:
    """The plan of the log's first window."""
    settled = settled_config(log, config)
    return plan_part(first_part(log, settled), settled, Planners(settled))


def replayed(log: Log, config: Config = FAST) -> tuple[Replay, dict[str, Any]]:
    """The replay of a log and its one window."""
    done = replay_read(log, config)
    assert len(done.summary["windows"]) == 1
    return done, done.summary["windows"][0]


def map_motion(plan: WindowPlan) -> dict[str, np.ndarray]:
    """Planned rear axles (S, 2) in the map frame."""
    frame = plan.scenario.window.frame
    c, s = np.cos(frame.yaw_rad), np.sin(frame.yaw_rad)
    turn = np.array([[c, -s], [s, c]])
    return {t.vehicle_id: t.states[:, :2] @ turn.T + (frame.x_m, frame.y_m) for t in plan.trajectories}


#: A car that stands, and at the end moves on by a metre.
CREEP = np.maximum(np.arange(41) / 10.0 - 3.0, 0.0)


# A slower car ahead of a faster one that swerves beside it, and one in the next lane.
BUSY = log_of(
    driver("1"), driver("2", 3.7, 2.0, 11.0), driver("3", 0.6, 14.0, 9.5), driver("4", 7.0, -3.0, 13.0)
)


def test_a_slow_log_is_a_scene_and_a_fast_one_traffic() -> None:
    slow, fast = log_of(driver("1", speed_mps=5.0)), log_of(driver("1"))
    assert [next(iter(build_scenarios(log, Config()))).traffic for log in (slow, fast)] == [False, True]
    told = replace(fast, scene=replace(fast.scene, bounds=None, vehicles=BUSY.scene.vehicles))
    assert (
        next(iter(build_scenarios(told, Config.model_validate({"window": {"rules": "scene"}})))).window.unit_s
        == 1.0
    )


def test_settings_of_traffic_are_taken_where_none_are_set_and_settled_ones_stay() -> None:
    log = log_of(driver("1"))
    config = parse_config("trajectories.deceleration_max_mps2 = 4.5")
    settled = settled_config(log, config)
    assert settled.trajectories.deceleration_max_mps2 == 4.5
    assert settled.trajectories.acceleration_max_mps2 == 5.0
    assert settled.corridors.milp_node_budget == 1000
    assert settled_config(log, parse_config(render_config(settled))) == settled
    own = parse_config("corridors.milp_node_budget = 5000")
    assert settled_config(log, own).corridors.milp_node_budget == 5000
    scene = log_of(driver("1", speed_mps=5.0))
    assert settled_config(scene, config) == config


def test_the_time_unit_is_long_only_where_the_recording_has_no_conflict_at_it() -> None:
    def unit_s(ahead_m: float, config: Config = FAST, lane_m: float = 0.0) -> float:
        """The time unit of two cars, 4.5 m long, at 12 m/s."""
        log = log_of(driver("1"), driver("2", lane_m, ahead_m))
        return next(iter(build_scenarios(log, config))).window.unit_s

    assert unit_s(0.0, lane_m=8.0) == 1.0
    assert unit_s(11.5) == 0.5  # 7 m between the bumpers, 6 m of way in half a second
    assert unit_s(9.0) == 0.25
    assert unit_s(6.7) == 0.5  # a conflict at any of them: half a second first
    assert unit_s(11.5, Config.model_validate({"window": {"unit_s": 0.25}})) == 0.25


def test_the_frame_turns_to_the_road() -> None:
    log = turned(BUSY, np.radians(41.0), (0.0, 0.0))
    yaw = next(iter(build_scenarios(log, Config()))).window.frame.yaw_rad
    assert np.degrees(yaw) % 90.0 == pytest.approx(41.0, abs=1.1)
    assert (
        next(
            iter(build_scenarios(log, Config.model_validate({"window": {"frame": "map"}})))
        ).window.frame.yaw_rad
        == 0.0
    )


def test_cars_side_by_side_at_an_angle_conflict_only_in_the_maps_frame() -> None:
    along = np.linspace(0.0, 40.0, 9)
    bodies = []
    for lane in (0.0, 3.0):
        points = (
            np.stack([along, np.full(9, lane)], axis=-1) @ np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2.0)
        )
        bodies.append(Body(0, np.column_stack([points, np.full(9, np.pi / 4)]), 4.5, 1.8))
    yaw = road_yaw(bodies, 8, 0.5)
    assert conflicts(bodies, 8, 0.5, 0.0)[0] == 1
    assert conflicts(bodies, 8, 0.5, yaw) == (0, 0, 0.0)


@pytest.mark.parametrize("angle_deg", [23.0, 45.0, 131.0, -78.0])
def test_a_turned_and_shifted_log_has_the_same_plan(angle_deg: float) -> None:
    angle, shift = np.radians(angle_deg), (3_000.0, -7_000.0)
    original, other = map_motion(planned(BUSY)), map_motion(planned(turned(BUSY, angle, shift)))
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    assert original.keys() == other.keys() == {"1", "2", "3", "4"}
    for vehicle, motion in original.items():
        np.testing.assert_allclose(other[vehicle], motion @ turn.T + shift, atol=0.02)


def test_a_window_is_planned_about_its_own_origin_wherever_it_was_recorded() -> None:
    far = (4.0e7, -3.0e7)
    here, there = planned(BUSY), planned(turned(BUSY, 0.0, far))
    frames = [plan.scenario.window.frame for plan in (here, there)]
    assert (frames[1].x_m - frames[0].x_m, frames[1].y_m - frames[0].y_m) == far
    for plan in (here, there):
        assert max(np.abs(p.recording.poses[:, :2]).max() for p in plan.scenario.participants) < 60.0
    for one, other in zip(here.trajectories, there.trajectories, strict=True):
        np.testing.assert_allclose(other.states, one.states, atol=1e-5)


def test_a_log_recorded_at_another_time_under_other_names_has_the_same_plan() -> None:
    names = {"1": "car a", "2": "car b", "3": "car c", "4": "car d"}
    states = BUSY.states.with_columns(
        time_ns=pl.col("time_ns") + 1_700_000_000_123_456_789, vehicle_id=pl.col("vehicle_id").replace(names)
    )
    original, other = planned(BUSY), planned(replace(BUSY, states=states))
    for one, same in zip(original.trajectories, other.trajectories, strict=True):
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


def test_headings_are_held_narrow_at_speed_and_after_the_start() -> None:
    at = np.arange(9)[:, None] * np.array([[1.0, 0.0, 0.0]])
    slow, fast = heading_slack(at * 2.0, 0.5), heading_slack(at * 10.0, 0.5)
    assert np.degrees(slow[0]) == pytest.approx(np.degrees(0.22 * 0.125))
    assert slow[-1] == pytest.approx(np.arctan(1.5 * 0.5 / 4.0))
    assert fast[-1] == pytest.approx(np.arctan(1.5 * 0.5 / 20.0))
    assert (np.diff(slow[:3]) >= 0.0).all()


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


def test_the_fewest_vehicles_give_way() -> None:
    participants = planned(BUSY).scenario.participants
    assert least_cover([("1", "2"), ("2", "3"), ("2", "4")], participants) == ("2",)
    assert least_cover([("1", "wall"), ("1", "2")], participants) == ("1",)
    assert least_cover([], participants) == ()


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


def test_a_noisy_recording_is_repaired_to_a_drivable_one() -> None:
    noise = np.random.default_rng(4).normal(0.0, 0.05, (2, 41))
    straight = driver("1")
    log = log_of(straight.with_columns(x_m=pl.col("x_m") + noise[0], y_m=pl.col("y_m") + noise[1]))
    scenario = build_scenario(first_part(log, Config()), Config(), 0.5)
    limits = settled_config(log, Config()).trajectories
    motion, record = RecordingRepairer(limits).repair(scenario.participants[0], 0.5, 20.0)
    assert motion is not None
    assert record.stage == "repair"
    assert motion.deviation_m < 0.25
    assert np.hypot(*(motion.poses[0, :2] - scenario.participants[0].recording.poses[0, :2])) < 0.04
    acceleration = motion.driven.states[:, 5]
    assert acceleration.max() <= limits.acceleration_max_mps2 + 1e-6
    assert acceleration.min() >= -limits.deceleration_max_mps2 - 1e-6


def test_an_excursion_is_measured_across_the_path_and_beyond_its_ends() -> None:
    plan = planned(log_of(driver("1")))
    trajectory, guide = plan.trajectories[0], plan.guidance[0]

    def moved(along: float, across: float) -> Trajectory:
        heading = trajectory.states[0, 2]
        c, s = np.cos(heading), np.sin(heading)
        states = trajectory.states.copy()
        states[:, 0] += along * c - across * s
        states[:, 1] += along * s + across * c
        return replace(trajectory, states=states)

    assert lateral_excursion_m(moved(0.0, 0.7), guide) == pytest.approx(0.7, abs=0.02)
    assert lateral_excursion_m(moved(30.0, 0.0), guide) == pytest.approx(0.0, abs=0.02)
    assert lateral_excursion_m(moved(-30.0, -2.0), guide) == pytest.approx(2.0, abs=0.02)


def test_a_plan_beyond_its_lateral_bound_is_not_accepted() -> None:
    # The car behind is too fast to stay behind: recorded to pass through, it could only swerve.
    log = log_of(driver("1", 0.0, 0.0, 14.0), driver("2", 0.0, 12.0, 4.0))
    for lateral in (1.5, 0.2):
        tight = FAST.model_copy(
            update={"corridors": FAST.corridors.model_copy(update={"lateral_m": lateral})}
        )
        plan = planned(log, tight)
        guides = {g.vehicle_id: g for g in plan.guidance}
        for trajectory in plan.trajectories:
            assert lateral_excursion_m(trajectory, guides[trajectory.vehicle_id]) <= lateral


def test_constant_speed_remains_a_choice_for_traffic() -> None:
    config = FAST.model_copy(update={"guidance": FAST.guidance.model_copy(update={"law": "constant"})})
    scenario = next(iter(build_scenarios(BUSY, config)))
    plan = plan_window(scenario, config, Planners(config).of(scenario))
    assert plan.status is WindowStatus.NOT_CERTIFIED
    assert all(g.slack_rad is None for g in plan.guidance)


def test_preparation_keeps_neighbours_narrow() -> None:
    log = log_of(driver("1"), driver("2", 2.2), driver("3", 12.0))
    config = settled_config(log, Config())
    scenario = build_scenario(first_part(log, config), config, 0.5)
    ready = prepare(scenario, config, Repairs(RecordingRepairer(config.trajectories)), 20.0)
    slack = {g.vehicle_id: np.degrees(np.asarray(g.slack_rad)) for g in ready.guidance}
    assert slack["1"].max() == pytest.approx(1.5, abs=0.05)
    assert slack["3"].max() > 3.0


def test_who_enters_within_a_unit_is_an_obstacle_until_it_is_planned() -> None:
    late = driver("2", 4.0).filter(pl.col("time_ns") >= 700_000_000)
    log = log_of(driver("1"), late)
    scenario = build_scenario(first_part(log, Config()), Config(), 0.5)
    assert [(p.vehicle_id, p.first_unit) for p in scenario.participants] == [("1", 0), ("2", 2)]
    boxes = {o.obstacle_id: o.boxes_m for o in scenario.obstacles}
    assert set(boxes) == {"2"}
    assert np.isfinite(boxes["2"]).all(axis=1).tolist() == [False, True] + [False] * 6
    assert boxes["2"][1, 1] - boxes["2"][1, 0] == pytest.approx(4.5 + 12.0 * 0.3, abs=0.1)
