"""Guidance: paths by arc length, the paper's constant speed, lanes and recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from istc_replay.config import GuidanceConfig
from istc_replay.datatypes import (
    Frame,
    Participant,
    Recording,
    Scenario,
    StartState,
    Window,
    read_only,
)
from istc_replay.guidance.build import build_guidance, recorded_speed_mps
from istc_replay.guidance.path import Path, constant_speed_then_stop, eased, standing_in_the_end

from ..support.participants import CAR


def recorded(poses: np.ndarray, speeds: np.ndarray, lane: np.ndarray | None = None) -> Scenario:
    """One vehicle recorded at 10 Hz over whole seconds."""
    units = (len(poses) - 1) // 10
    x, y, heading = poses[0]
    participant = Participant(
        "1",
        CAR,
        1.0,
        0,
        units,
        StartState(float(x), float(y), float(heading), float(speeds[0])),
        Recording(read_only(np.arange(len(poses)) / 10.0), read_only(poses), read_only(speeds)),
        None if lane is None else read_only(lane),
    )
    window = Window(0, 0, units * 1_000_000_000, 1.0, units, Frame())
    return Scenario(window, (participant,), (), None, (), 1)


def circle(radius: float, arc: np.ndarray) -> np.ndarray:
    """Poses on a circle to the left that starts at the origin heading east."""
    angle = arc / radius
    return np.stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), angle], axis=-1)


def test_the_recorded_path_is_driven_at_the_recorded_mean_speed() -> None:
    times = np.arange(61) / 10.0
    arc = 4.0 * times + 0.5 * np.sin(times)  # uneven speed along a circle
    guide = build_guidance(recorded(circle(20.0, arc), np.gradient(arc, times)), GuidanceConfig())[0]
    mean = arc[-1] / times[-1]
    assert guide.speed_mps == pytest.approx(mean, rel=1e-3)
    np.testing.assert_allclose(guide.points_m, circle(20.0, mean * np.arange(7))[:, :2], atol=0.02)
    np.testing.assert_allclose(guide.headings_rad, mean * np.arange(7) / 20.0, atol=5e-3)


def test_a_set_speed_goes_on_straight_beyond_the_recorded_path() -> None:
    times = np.arange(31) / 10.0
    poses = np.stack([3.0 * times, np.zeros(31), np.zeros(31)], axis=-1)
    guide = build_guidance(recorded(poses, np.full(31, 3.0)), GuidanceConfig(speed_mps=6.0))[0]
    np.testing.assert_allclose(guide.points_m[:, 0], [0.0, 6.0, 12.0, 18.0], atol=1e-9)


def test_a_vehicle_that_stands_at_the_end_is_guided_to_stand_there() -> None:
    times = np.arange(101) / 10.0
    arc = constant_speed_then_stop(times, 5.0, 25.0, 2.0)
    poses = np.stack([arc, np.zeros(101), np.zeros(101)], axis=-1)
    speeds = np.gradient(arc, times)
    guide = build_guidance(recorded(poses, speeds), GuidanceConfig())[0]
    assert guide.points_m[-1, 0] == pytest.approx(25.0, abs=1e-6)
    assert np.all(np.diff(guide.points_m[:, 0]) >= -1e-9)


def test_braking_ends_at_the_end_and_never_exceeds_the_deceleration() -> None:
    times = np.linspace(0.0, 12.0, 2401)
    arc = constant_speed_then_stop(times, 5.0, 30.0, 2.0)
    speed = np.gradient(arc, times)
    assert arc[-1] == pytest.approx(30.0)
    assert speed.max() <= 5.0 + 1e-6
    assert np.gradient(speed, times).min() >= -2.0 - 1e-3


def test_a_path_too_short_to_reach_the_speed_stops_at_its_end() -> None:
    arc = constant_speed_then_stop(np.linspace(0.0, 5.0, 51), 10.0, 4.0, 2.0)
    assert arc[-1] == pytest.approx(4.0)


def test_a_vehicle_that_never_moves_is_guided_to_stand() -> None:
    poses = np.tile([3.0, 4.0, 0.5], (31, 1))
    scenario = recorded(poses, np.zeros(31))
    assert recorded_speed_mps(scenario.participants[0].recording) == 0.0
    guide = build_guidance(scenario, GuidanceConfig())[0]
    np.testing.assert_allclose(guide.points_m, np.tile([3.0, 4.0], (4, 1)))


def test_a_lane_line_is_followed_from_the_place_beside_the_start() -> None:
    lane = circle(15.0, np.linspace(0.0, 60.0, 241))[:, :2] + (0.0, 0.4)
    times = np.arange(31) / 10.0
    poses = np.stack([5.0 * times, np.zeros(31), np.zeros(31)], axis=-1)
    scenario = recorded(poses, np.full(31, 5.0), lane)
    guide = build_guidance(scenario, GuidanceConfig())[0]
    assert guide.kind == "lane"
    np.testing.assert_allclose(guide.points_m[0], [0.0, 0.0])
    np.testing.assert_allclose(
        guide.points_m[1:], circle(15.0, 5.0 * np.arange(1, 4))[:, :2] + (0.0, 0.4), atol=0.02
    )
    assert build_guidance(scenario, GuidanceConfig(source="recorded"))[0].kind == "recorded"


def test_a_lane_line_far_away_is_not_followed() -> None:
    lane = np.array([[0.0, 50.0], [100.0, 50.0]])
    times = np.arange(31) / 10.0
    poses = np.stack([5.0 * times, np.zeros(31), np.zeros(31)], axis=-1)
    assert build_guidance(recorded(poses, np.full(31, 5.0), lane), GuidanceConfig())[0].kind == "recorded"


def test_standing_still_adds_no_length_and_no_direction() -> None:
    points = np.array([[0.0, 0.0], [0.0, 0.0], [1e-5, 0.0], [3.0, 0.0], [3.0, 4.0]])
    path = Path.through(points)
    assert path.length_m == pytest.approx(7.0)
    arc, distance = path.project(np.array([1.0, 1.0]))
    assert (arc, distance) == (pytest.approx(1.0), pytest.approx(1.0))


def test_guidance_of_a_vehicle_that_enters_later_has_its_own_times() -> None:
    times = np.arange(31) / 10.0
    poses = np.stack([5.0 * times, np.zeros(31), np.zeros(31)], axis=-1)
    scenario = recorded(poses, np.full(31, 5.0))
    late = replace(scenario.participants[0], first_unit=4)
    guide = build_guidance(replace(scenario, participants=(late,)), GuidanceConfig())[0]
    assert (guide.times_s[0], guide.times_s[-1]) == (4.0, 7.0)


@pytest.mark.parametrize("length_m", [0.5, 4.0, 40.0])
def test_a_car_stands_at_the_end_however_short_the_path(length_m: float) -> None:
    times = np.arange(0.0, 40.0, 0.01)
    arc = constant_speed_then_stop(times, 5.0, length_m, 2.0)
    speed, most = np.diff(arc) / 0.01, min(5.0, np.sqrt(2.0 * 2.0 * length_m))
    assert arc[-1] == pytest.approx(length_m)
    assert speed[0] == pytest.approx(most, rel=0.01)
    assert (speed >= -1e-9).all()
    assert np.diff(speed).min() / 0.01 >= -2.0 - 1e-6


@pytest.mark.parametrize("start_mps", [0.0, 3.0, 8.0])
@pytest.mark.parametrize("length_m", [9.0, 60.0])
def test_a_car_that_is_handed_over_comes_to_its_speed_and_brakes_to_stand_at_the_end(
    start_mps: float, length_m: float
) -> None:
    times = np.arange(0.0, 60.0, 0.05)
    arc = eased(times, start_mps, 5.0, length_m, 2.0)
    speed = np.diff(arc) / 0.05
    # It never drives faster than it could brake from by the path's end.
    left = length_m - arc[:-1]
    assert (speed <= np.sqrt(2.0 * 2.0 * np.maximum(left, 0.0)) + 0.05).all()
    assert speed.max() <= max(start_mps, 5.0) + 1e-9
    assert arc[-1] == pytest.approx(length_m, abs=0.05)
    assert (np.diff(speed) / 0.05 <= 1.0 + 0.05).all()
    if length_m > 50.0:
        assert np.interp(30.0, arc[:-1], speed) == pytest.approx(5.0, abs=0.05)


def test_who_has_to_stand_in_the_end_brakes_as_late_as_it_can() -> None:
    times = np.linspace(0.0, 6.0, 61)
    arc = standing_in_the_end(times, 5.0 * times, 3.0)
    speeds = np.diff(arc) / 0.1
    assert np.allclose(speeds[:43], 5.0)  # 5/3 s before the end
    assert np.allclose(np.diff(speeds[44:]), -0.3)
    assert speeds[-1] == pytest.approx(0.15)
    assert np.array_equal(standing_in_the_end(times, np.zeros(61), 3.0), np.zeros(61))
