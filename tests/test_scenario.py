"""Scenarios: who takes part in a window, from where, and who is left out by which name."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config
from istc_replay.datatypes import (
    Dimensions,
    LaneLine,
    Log,
    MapBounds,
    SceneObstacle,
    StaticScene,
    VehicleInfo,
    read_only,
)
from istc_replay.errors import ScenarioError

from .support.planning import scenarios
from .support.tracks import log_of, track


def car(
    vehicle_id: str, first_s: float = 0.0, last_s: float = 10.0, hz: float = 10.0, **columns: Any
) -> pl.DataFrame:
    """A vehicle that drives east at 5 m/s on a line of its own."""
    times = np.linspace(first_s, last_s, round((last_s - first_s) * hz) + 1)
    line = 10.0 * int(vehicle_id) if vehicle_id.isdecimal() else 0.0
    values = {"x_m": 5.0 * times, "y_m": line, "speed_mps": 5.0} | columns
    return track(vehicle_id, times, **values)


def only(log: Log, **sections: Any) -> Any:
    """The one scenario of a log."""
    (scenario,) = scenarios(log, Config(**sections))
    return scenario


def test_a_short_log_is_one_window_of_whole_units() -> None:
    scenario = only(log_of(car("1", 0.0, 10.45), car("2")))
    assert (scenario.window.units, scenario.window.end_ns) == (10, 10_000_000_000)
    assert [(p.vehicle_id, p.first_unit, p.units) for p in scenario.participants] == [
        ("1", 0, 10),
        ("2", 0, 10),
    ]


def test_a_long_log_is_cut_into_windows() -> None:
    windows = [s.window for s in scenarios(log_of(car("1", 0.0, 30.0)), Config())]
    assert [window.start_ns // 10**9 for window in windows] == [0, 8, 16, 24]
    assert [window.units for window in windows] == [8, 8, 8, 6]


def test_start_states_are_interpolated_from_the_recording() -> None:
    scenario = only(log_of(car("1", 0.0, 10.0), car("2", 2.37, 9.4, hz=7.0)))
    late = scenario.participants[1]
    frame = scenario.window.frame
    assert (late.first_unit, late.units) == (3, 6)
    assert late.start.x_m + frame.x_m == pytest.approx(15.0)
    assert late.recording.times_s[0] == 3.0
    assert late.recording.times_s[-1] == 9.0


def test_the_frame_has_its_origin_amid_the_vehicles_in_whole_metres() -> None:
    far = car("1", x_m=5.0 * np.linspace(0.0, 10.0, 101) + 500_000.25)
    frame = only(log_of(far)).window.frame
    assert frame.x_m == 500_025.0
    assert frame.yaw_rad == 0.0


def test_dimensions_come_from_the_log_then_the_config_then_the_defaults() -> None:
    told = car("1", length_m=[5.0] * 101, width_m=[1.8] * 101)
    in_scene = StaticScene(vehicles=(VehicleInfo("2", 0.3, Dimensions(4.5, 1.9, 2.8, 1.3)),))
    config = {"by_id": {"3": {"length_m": 6.0, "width_m": 2.5}, "1": {"length_m": 9.0, "priority": 0.7}}}
    scenario = only(log_of(told, car("2"), car("3"), car("4"), scene=in_scene), vehicles=config)
    by_id = {p.vehicle_id: p for p in scenario.participants}
    assert by_id["1"].dimensions == Dimensions(5.0, 1.8, pytest.approx(3.375), pytest.approx(1.6875))
    assert by_id["2"].dimensions == Dimensions(4.5, 1.9, 2.8, 1.3)
    assert (by_id["3"].dimensions.length_m, by_id["3"].dimensions_source) == (6.0, "config")
    assert (by_id["4"].dimensions.length_m, by_id["4"].dimensions_source) == (4.0, "default")
    assert [by_id[v].priority for v in "1234"] == [0.7, 0.3, 1.0, 1.0]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"heading_rad": [None] * 101}, "missing_heading"),
        ({"x_m": [None] * 101}, "missing_position"),
        ({"speed_mps": [None] * 101}, "missing_speed"),
        ({"y_m": [math.nan] * 100 + [1.0]}, "one_sample"),
    ],
)
def test_what_is_not_usable_is_named_and_left_out(changes: dict[str, Any], reason: str) -> None:
    scenario = only(log_of(car("1"), car("2", **changes)))
    assert [p.vehicle_id for p in scenario.participants] == ["1"]
    assert [(e.vehicle_id, e.reason) for e in scenario.excluded] == [("2", reason)]
    assert scenario.vehicles_present == 2


def test_one_sample_a_short_stay_and_a_hole_are_named() -> None:
    single = car("2").head(1)
    brief = car("3", 1.2, 1.9)
    holed = car("4").filter(~pl.col("time_ns").is_between(3 * 10**9, 5 * 10**9))
    scenario = only(log_of(car("1"), single, brief, holed))
    assert {e.vehicle_id: e.reason for e in scenario.excluded} == {
        "2": "one_sample",
        "3": "short_presence",
        "4": "hole",
    }


def test_pedestrians_are_obstacles_that_move_as_recorded() -> None:
    walker = car(
        "w",
        2.0,
        8.0,
        x_m=np.linspace(0.0, 6.0, 61),
        role=["pedestrian"] * 61,
        length_m=[0.6] * 61,
        width_m=[0.6] * 61,
    )
    scenario = only(log_of(car("1"), walker))
    obstacle = scenario.obstacles[0]
    x, y = scenario.window.frame.x_m, scenario.window.frame.y_m
    assert np.isnan(obstacle.boxes_m[[0, 1, 8, 9]]).all()
    np.testing.assert_allclose(obstacle.boxes_m[2] + (x, x, y, y), [-0.3, 1.3, -0.3, 0.3], atol=1e-9)
    assert [e.reason for e in scenario.excluded] == ["not_a_vehicle"]


@pytest.mark.parametrize("hz", [0.8, 1.0, 100.0])
def test_a_moving_obstacle_is_swept_at_any_rate(hz: float) -> None:
    count = round(10 * hz) + 1
    walker = car("w", hz=hz, x_m=np.linspace(0.0, 10.0, count), role=["bicycle"] * count)
    boxes = only(log_of(car("1"), walker), window={"unit_s": 0.25}).obstacles[0].boxes_m
    assert np.isfinite(boxes).all()
    np.testing.assert_allclose(boxes[:, 1] - boxes[:, 0], 1.25, atol=1e-6)


def test_standing_obstacles_and_bounds_are_moved_into_the_frame() -> None:
    scene = StaticScene(
        obstacles=(SceneObstacle("block", 30.0, 12.0, math.pi / 2, 4.0, 2.0),),
        bounds=MapBounds(-10.0, 90.0, -20.0, 40.0),
        lane_lines=(LaneLine("l", read_only([[0.0, 10.0], [60.0, 10.0]]), "1"),),
    )
    scenario = only(log_of(car("1"), scene=scene))
    frame = scenario.window.frame
    shift = (frame.x_m, frame.x_m, frame.y_m, frame.y_m)
    np.testing.assert_allclose(scenario.obstacles[0].boxes_m[0] + shift, [29.0, 31.0, 10.0, 14.0], atol=1e-9)
    np.testing.assert_allclose(np.add(scenario.bounds_m, shift), [-10.0, 90.0, -20.0, 40.0])
    np.testing.assert_allclose(
        scenario.participants[0].lane_m + (frame.x_m, frame.y_m), scene.lane_lines[0].points_m
    )


def test_vehicles_sampled_in_turn_all_start_with_the_window() -> None:
    scenario = only(log_of(car("1", 0.0, 10.0), car("2", 0.03, 10.03), car("3", 0.07, 10.07)))
    assert [p.first_unit for p in scenario.participants] == [0, 0, 0]
    assert scenario.window.start_ns == 70_000_000


def test_vehicle_ids_sort_as_people_count() -> None:
    scenario = only(log_of(car("10"), car("2"), car("a")))
    assert [p.vehicle_id for p in scenario.participants] == ["2", "10", "a"]


def test_a_log_without_vehicles_and_one_too_short_are_errors() -> None:
    with pytest.raises(ScenarioError, match="no vehicle states"):
        scenarios(log_of(), Config())
    with pytest.raises(ScenarioError, match="less than one time unit"):
        scenarios(log_of(car("1", 0.0, 0.5)), Config())
