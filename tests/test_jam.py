"""Plans that end with vehicles in each other's way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from istc_replay.datatypes import (
    Dimensions,
    Frame,
    Participant,
    Recording,
    Scenario,
    StartState,
    Trajectory,
    Window,
    WindowPlan,
    WindowStatus,
    read_only,
)
from istc_replay.jam import jammed

CAR = Dimensions(4.0, 2.0, 2.7, 1.35)
EAST, WEST, NORTH = 0.0, np.pi, np.pi / 2.0


Car = tuple[Participant, Trajectory]


def car(name: str, x_m: float, y_m: float, heading_rad: float, left_m: float = 30.0) -> Car:
    """A car that stands at a place and wants to go straight on for a while."""
    way = np.linspace(-10.0, left_m, 81)
    direction = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    poses = np.column_stack([np.array([x_m, y_m]) + way[:, None] * direction, np.full(81, heading_rad)])
    times, speeds = np.linspace(-2.0, 10.0, 81), np.full(81, 5.0)
    here = Recording(read_only(times[:20]), read_only(poses[:20]), read_only(speeds[:20]))
    whole = Recording(read_only(times), read_only(poses), read_only(speeds))
    start = StartState(x_m, y_m, heading_rad, 0.0)
    axle = np.array([x_m, y_m]) - CAR.rear_axle_to_centre_m * direction
    states = np.tile([*axle, heading_rad, 0.0, 0.0, 0.0], (2, 1))
    trajectory = Trajectory(
        name, CAR, read_only([0.0, 1.0]), read_only(states), read_only(np.zeros((1, 2))), 0.0
    )
    return Participant(name, CAR, 1.0, 0, 1, start, here, route=whole), trajectory


def plan_of(*cars: Car) -> WindowPlan:
    window = Window(0, 0, 1_000_000_000, 1.0, 1, Frame())
    scenario = Scenario(window, tuple(p for p, _ in cars), (), None)
    return WindowPlan(scenario, WindowStatus.NOT_CERTIFIED, trajectories=tuple(t for _, t in cars))


@pytest.mark.parametrize(
    ("cars", "stuck"),
    [
        ([car("1", 0, 0, EAST), car("2", 8, 0.5, WEST)], True),  # nose to nose
        ([car("1", 0, 0, EAST), car("2", 8, 4.0, WEST)], False),  # they pass each other
        ([car("1", 0, 0, EAST), car("2", 6, 0, EAST)], False),  # one goes first
        ([car("1", 0, 0, EAST), car("2", 6, -6, NORTH)], False),  # neither stands on the way of the other
        ([car("1", 0, 0, EAST), car("2", 3.5, -1.0, NORTH), car("3", 3.5, 6.0, -NORTH)], True),  # 2 and 3
        ([car("1", 0, 0, EAST, left_m=0.0), car("2", 8, 0, WEST)], False),  # 1 is where it wants to be
    ],
)
def test_who_waits_in_a_circle_is_jammed(cars: Any, stuck: bool) -> None:
    assert jammed(plan_of(*cars)) is stuck
    assert jammed(plan_of(*reversed(cars))) is stuck
