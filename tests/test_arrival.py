"""Who ends beside its goal, and the cube that has it end there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from istc_replay.arrival import distance_left_m, drawn_home, late_text
from istc_replay.datatypes import (
    ARRIVED_M,
    Corridor,
    Frame,
    Participant,
    Scenario,
    Trajectory,
    Window,
    read_only,
)
from istc_replay.geometry import box_corners

from .support.participants import straight_on

UNITS = 6


@pytest.fixture
def driver() -> Participant:
    """Drives 15 m at a heading of 0.3 rad, braking to stand."""
    times = np.linspace(0.0, UNITS, 10 * UNITS + 1)
    way = np.minimum(5.0 * times - times**2 * 5.0 / 12.0, 15.0)
    return straight_on("1", (2.0, -1.0, 0.3), times, way, np.maximum(5.0 - times * 5.0 / 6.0, 0.0), UNITS)


def ending(driver: Participant, x_m: float, y_m: float, heading_rad: float) -> Trajectory:
    """A trajectory whose box centre ends there."""
    back = driver.dimensions.rear_axle_to_centre_m
    states = np.zeros((2, 6))
    states[-1, :3] = x_m - back * np.cos(heading_rad), y_m - back * np.sin(heading_rad), heading_rad
    return Trajectory(
        vehicle_id="1",
        dimensions=driver.dimensions,
        times_s=read_only([0.0, 1.0]),
        states=read_only(states),
        controls=read_only(np.zeros((1, 2))),
        cost=0.0,
        costs={},
    )


def wide(pivot_m: tuple[float, float]) -> Corridor:
    cubes = np.tile([-50.0, 50.0, -50.0, 50.0], (2, 1))
    pivots = np.array([[0.0, 0.0], [1.0, 0.0], pivot_m])
    return Corridor("1", 0, read_only(cubes), read_only(pivots), read_only(pivots))


def test_the_distance_left_is_of_the_box_centre_from_where_it_was_recorded_to_stand(
    driver: Participant,
) -> None:
    x, y, heading = driver.recording.poses[-1]
    assert distance_left_m(driver, ending(driver, x, y, heading)) == pytest.approx(0.0, abs=1e-9)
    assert distance_left_m(driver, ending(driver, x + 3.0, y - 4.0, heading + 1.0)) == pytest.approx(5.0)


def test_who_goes_on_or_was_recorded_moving_has_no_goal(driver: Participant) -> None:
    away = ending(driver, 100.0, 0.0, 0.0)
    recording = driver.recording
    moving = replace(recording, speeds_mps=read_only(np.full(len(recording.speeds_mps), 5.0)))
    longer = replace(recording, times_s=read_only(recording.times_s + 5.0))
    assert distance_left_m(replace(driver, route=longer), away) == 0.0
    assert distance_left_m(replace(driver, recording=moving), away) == 0.0


def test_a_cube_drawn_home_holds_the_box_at_the_goal_and_no_box_that_is_late(driver: Participant) -> None:
    x, y, heading = driver.recording.poses[-1]
    home = drawn_home(wide((x + 0.4, y)), driver)
    assert home is not None
    np.testing.assert_array_equal(home.cubes_m[:-1], wide((x, y)).cubes_m[:-1])
    low, high = home.cubes_m[-1, ::2], home.cubes_m[-1, 1::2]
    size = driver.dimensions

    def inside(x_m: float, y_m: float, heading_rad: float) -> bool:
        box = box_corners(x_m, y_m, heading_rad, size.length_m, size.width_m)
        return bool((box >= low).all() and (box <= high).all())

    assert inside(x, y, heading)
    for bearing in np.linspace(0.0, 2.0 * np.pi, 73):
        away = ARRIVED_M * np.array([np.cos(bearing), np.sin(bearing)])
        assert not inside(x + away[0], y + away[1], heading)


def test_a_cube_is_not_drawn_home_where_layer_1_does_not_lead_there(driver: Participant) -> None:
    x, y, _ = driver.recording.poses[-1]
    assert drawn_home(wide((x + 1.2, y)), driver) is None


def test_who_is_late_is_told_with_the_distance(driver: Participant) -> None:
    window = Window(0, 0, 6_000_000_000, 1.0, UNITS, Frame())
    scenario = Scenario(window, (driver,), (), None, (), 1)
    assert late_text({"1": 1.16}, scenario) == "goal not reached: 1 by 1.2 m"
    assert not late_text({}, scenario)
