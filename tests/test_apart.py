"""How far a motion goes across a path, and what stands in the way of one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from istc_replay.apart import driven_through, lateral_excursion_m
from istc_replay.datatypes import Obstacle, Trajectory, read_only
from istc_replay.geometry import box_corners

from .support.planning import FAST, planned
from .support.tracks import driver, log_of


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


def test_a_goal_or_path_within_an_obstacle_is_named() -> None:
    scenario = planned(log_of(driver("1"))).scenario
    driven = scenario.participants[0]
    middle, goal = driven.recording.poses[len(driven.recording.poses) // 2], driven.recording.poses[-1]

    def told(*places: tuple[str, float, float]) -> str:
        outlines = {name: read_only(box_corners(x, y, 0.3, 2.0, 2.0)) for name, x, y in places}
        nowhere = read_only(np.full((scenario.window.units, 4), np.nan))
        obstacles = tuple(Obstacle(name, nowhere, outline) for name, outline in outlines.items())
        return driven_through(driven, replace(scenario, obstacles=obstacles))

    wall, post = ("wall", middle[0], middle[1]), ("post", goal[0], goal[1])
    assert told(("aside", middle[0], middle[1] + 6.0)) == ""
    assert told(wall) == "its recorded path leads through wall"
    assert told(post) == told(wall, post) == "its goal is within post"
