"""Paths pulled taut: exact ends, limits kept, and no shorter neighbour."""

from __future__ import annotations

import math

import numpy as np
import pytest

from istc_replay.datatypes import MapBounds, SceneObstacle
from istc_replay.guidance.clearance import Clearance
from istc_replay.guidance.curves import Curve, Pose
from istc_replay.guidance.tangents import sharp_paths
from istc_replay.guidance.taut import Limits, pull_taut
from istc_replay.guidance.ways import ways_round

from ..support.participants import CAR

FIELD = MapBounds(0.0, 50.0, 0.0, 38.0)
LEAST_M, PREFERRED_M, SHARPNESS = 4.0, 6.0, 0.05


def limits(*obstacles: SceneObstacle) -> Limits:
    clearance = Clearance.of(CAR, FIELD, obstacles, 0.3, 0.1)
    return Limits(1.0 / LEAST_M, 1.0 / PREFERRED_M, SHARPNESS, clearance)


def taut(start: Pose, goal: Pose, kept: Limits, which: int = 0) -> Curve:
    ways = ways_round(start.as_array()[:2], goal.as_array()[:2], kept.clearance)
    path = sharp_paths(ways, start, goal, LEAST_M, 1.0 / (LEAST_M * SHARPNESS))[which]
    curve = pull_taut(path, goal, kept)
    assert curve is not None
    return curve


def assert_kept(curve: Curve, goal: Pose, kept: Limits) -> None:
    np.testing.assert_allclose(curve.end[:2], [goal.x_m, goal.y_m], atol=1e-9)
    assert math.remainder(curve.end[2] - goal.heading_rad, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert np.abs(curve.curvatures_1pm).max() <= 1.001 * kept.curvature_1pm
    assert np.abs(curve.sharpness(curve.breaks_m)).max() <= 1.001 * kept.sharpness_1pm2
    assert kept.clearance.lacks(curve.spaced_poses(0.1)).max() <= 0.01


def test_a_straight_path_stays_straight() -> None:
    curve = taut(Pose(5.0, 19.0, 0.0), Pose(40.0, 19.0, 0.0), limits())
    assert curve.length_m == pytest.approx(35.0, abs=1e-4)
    assert np.abs(curve.curvatures_1pm).max() < 1e-3


def test_a_path_touches_the_block_that_it_rounds() -> None:
    kept = limits(SceneObstacle("block", 25.0, 21.0, 0.0, 6.0, 8.0))
    start, goal = Pose(5.0, 19.0, 0.0), Pose(45.0, 19.0, 0.0)
    curve = taut(start, goal, kept)
    assert_kept(curve, goal, kept)
    assert kept.clearance.lacks(curve.spaced_poses(0.1)).max() > -0.05
    assert 40.0 < curve.length_m < 40.9


def test_both_sides_of_a_block_in_the_middle_are_alike() -> None:
    kept = limits(SceneObstacle("block", 25.0, 19.0, 0.0, 6.0, 8.0))
    goal = Pose(45.0, 19.0, 0.0)
    left, right = (taut(Pose(5.0, 19.0, 0.0), goal, kept, which) for which in (0, 1))
    assert left.length_m == pytest.approx(right.length_m, abs=0.01)
    assert (left.points([20.0])[0, 1] - 19.0) * (right.points([20.0])[0, 1] - 19.0) < 0.0


def test_bends_are_no_sharper_than_preferred_unless_there_is_need() -> None:
    roomy = taut(Pose(5.0, 19.0, 0.6), Pose(45.0, 22.0, -0.4), limits())
    assert np.abs(roomy.curvatures_1pm).max() <= 1.001 / PREFERRED_M
    # Seven metres to turn about in: not enough for the preferred radius.
    start, goal = Pose(5.0, 4.0, 0.0), Pose(5.0, 14.0, math.pi)
    tight = taut(start, goal, limits(SceneObstacle("wall", 17.0, 9.0, 0.0, 2.0, 18.0)))
    assert 1.0 / PREFERRED_M < np.abs(tight.curvatures_1pm).max() <= 1.001 / LEAST_M


def test_no_small_change_that_still_arrives_is_shorter() -> None:
    kept = limits(SceneObstacle("block", 25.0, 21.0, 0.0, 6.0, 8.0))
    start, goal = Pose(5.0, 19.0, 0.3), Pose(45.0, 22.0, -0.2)
    best = taut(start, goal, kept)
    random = np.random.default_rng(3)
    for _ in range(5):
        # Pulled from a start nearby, it comes back.
        near = Pose(5.0, 19.0 + 1e-3 * random.standard_normal(), 0.3 + 1e-3 * random.standard_normal())
        assert taut(near, goal, kept).length_m == pytest.approx(best.length_m, abs=0.01)


def test_a_path_that_leads_through_a_block_is_told_from_one_that_passes() -> None:
    kept = limits(SceneObstacle("wall", 25.0, 19.0, 0.0, 2.0, 37.9))
    start, goal = Pose(5.0, 19.0, 0.0), Pose(45.0, 19.0, 0.0)
    ways = ways_round(start.as_array()[:2], goal.as_array()[:2], limits().clearance)
    path = sharp_paths(ways, start, goal, LEAST_M, 5.0)[0]
    curve = pull_taut(path, goal, kept)
    assert curve is None or kept.clearance.lacks(curve.spaced_poses(0.1)).max() > 0.5
