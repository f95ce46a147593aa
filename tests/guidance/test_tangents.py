"""Sharp paths along taut lines, driven arc by arc."""

from __future__ import annotations

import math

import numpy as np
import pytest

from istc_replay.datatypes import MapBounds, SceneObstacle
from istc_replay.guidance.clearance import Clearance
from istc_replay.guidance.curves import Pose, arc_poses
from istc_replay.guidance.dubins import word_lengths
from istc_replay.guidance.tangents import Sharp, inner_ends, sharp_paths
from istc_replay.guidance.ways import Way, ways_round

from ..support.participants import CAR

FIELD = MapBounds(0.0, 50.0, 0.0, 38.0)
RADIUS_M, RAMP_M = 4.0, 3.0


def end_of(path: Sharp) -> np.ndarray:
    arcs = path.lengths_m[None], path.bends_1pm[None]
    return arc_poses(path.start.as_array()[None], *arcs, np.array([[path.length_m]]))[0, 0]


def ways(start: Pose, goal: Pose, *obstacles: SceneObstacle) -> list[Way]:
    clearance = Clearance.of(CAR, FIELD, obstacles, 0.3, 0.0)
    return ways_round(start.as_array()[:2], goal.as_array()[:2], clearance)


def test_every_path_ends_at_the_goal_and_the_shortest_comes_first() -> None:
    start, goal = Pose(6.0, 20.0, 0.7), Pose(44.0, 17.0, -0.4)
    block = SceneObstacle("block", 25.0, 19.0, 0.2, 6.0, 8.0)
    paths = sharp_paths(ways(start, goal, block), start, goal, RADIUS_M, RAMP_M)
    assert len(paths) == 8  # two sides of the block, two ways round at either end
    for path in paths:
        end = end_of(path)
        np.testing.assert_allclose(end[:2], [goal.x_m, goal.y_m], atol=1e-9)
        assert math.remainder(end[2] - goal.heading_rad, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
        assert set(np.abs(path.bends_1pm)) == {0.0, 1.0 / RADIUS_M}
        assert path.lengths_m[[0, -1]] == pytest.approx(RAMP_M / 2.0)
        assert path.lengths_m.min() >= 0.0
    lengths = [path.length_m for path in paths]
    assert lengths == sorted(lengths)


def test_a_corner_is_passed_with_room() -> None:
    start, goal = Pose(6.0, 20.0, 0.0), Pose(44.0, 20.0, 0.0)
    path = sharp_paths(
        ways(start, goal, SceneObstacle("block", 25.0, 21.0, 0.0, 4.0, 6.0)), start, goal, RADIUS_M, RAMP_M
    )[0]
    points = path.poses(0.05)[:, :2]
    for corner in ((23.0, 18.0), (27.0, 18.0)):
        assert 1.3 <= np.hypot(*(points - corner).T).min() <= 2.0


def test_without_obstacles_the_shortest_is_that_of_dubins() -> None:
    start, goal = Pose(6.0, 20.0, 1.0), Pose(44.0, 25.0, 2.0)
    path = sharp_paths(ways(start, goal), start, goal, RADIUS_M, RAMP_M)[0]
    begin, end = inner_ends(start, goal, RAMP_M)
    words = word_lengths(begin.as_array(), end.as_array(), RADIUS_M)[:4]  # those with a straight
    assert path.length_m == pytest.approx(RAMP_M + float(words.sum(axis=1).min()), abs=1e-9)


def test_ends_too_near_for_the_radius_have_fewer_paths() -> None:
    start, goal = Pose(20.0, 20.0, 0.0), Pose(23.0, 21.0, math.pi)
    paths = sharp_paths(ways(start, goal), start, goal, 6.0, RAMP_M)
    assert 0 < len(paths) < 4
