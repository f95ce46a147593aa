"""Gaps between boxes against shapely, and their slopes against differences."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from istc_replay.datatypes import MapBounds, SceneObstacle
from istc_replay.geometry import box_corners, shift_along
from istc_replay.guidance.clearance import Clearance

from ..support.participants import CAR

FIELD = MapBounds(0.0, 20.0, 0.0, 15.0)
OBSTACLES = [SceneObstacle("one", 10.0, 10.0, 0.3, 6.0, 3.0), SceneObstacle("two", 15.0, 4.0, 0.0, 4.0, 4.0)]
FAR_M = 100.0


@pytest.fixture(scope="module")
def poses() -> np.ndarray:
    """Rear-axle poses all over the field."""
    random = np.random.default_rng(1)
    return np.column_stack(
        [random.uniform(0, 20, 1000), random.uniform(0, 15, 1000), random.uniform(-4, 8, 1000)]
    )


def boxes(poses: np.ndarray) -> np.ndarray:
    x, y = shift_along(*poses.T, CAR.rear_axle_to_centre_m).T
    return np.asarray(shapely.polygons(box_corners(x, y, poses[:, 2], CAR.length_m, CAR.width_m)))


def test_gaps_are_distances_or_less_and_negative_where_boxes_overlap(poses: np.ndarray) -> None:
    gaps = Clearance.of(CAR, FIELD, OBSTACLES, 0.0, 0.0).gaps(poses)
    for o, gap in zip(OBSTACLES, gaps.T, strict=True):
        outline = shapely.Polygon(box_corners(o.x_m, o.y_m, o.heading_rad, o.length_m, o.width_m))
        distance = shapely.distance(outline, boxes(poses))
        assert (gap <= distance + 1e-9).all()
        assert ((gap > 0.0) == (distance > 0.0)).all()
        assert (distance[gap > 0.0] <= np.sqrt(2.0) * gap[gap > 0.0] + 1e-9).all()


def test_slack_counts_the_box_turned_either_way(poses: np.ndarray) -> None:
    turned = [
        Clearance.of(CAR, FIELD, OBSTACLES, 0.0, 0.0).gaps(_turned(poses, by)) for by in (-0.14, 0.0, 0.14)
    ]
    slacked = Clearance.of(CAR, FIELD, OBSTACLES, 0.0, 0.14).gaps(poses)
    np.testing.assert_allclose(slacked, np.minimum.reduce(turned), atol=1e-9)


def _turned(poses: np.ndarray, by_rad: float) -> np.ndarray:
    """Poses with the box turned about its centre."""
    centres = shift_along(*poses.T, CAR.rear_axle_to_centre_m)
    back = shift_along(*centres.T, poses[:, 2] + by_rad, -CAR.rear_axle_to_centre_m)
    return np.column_stack([back, poses[:, 2] + by_rad])


def test_the_least_near_gap_is_what_is_lacking(poses: np.ndarray) -> None:
    clearance = Clearance.of(CAR, FIELD, OBSTACLES, 0.3, 0.14)
    who, gaps, _ = clearance.near_gaps(poses, FAR_M)
    least = [gaps[who == index].min() for index in range(len(poses))]
    np.testing.assert_allclose(least, -clearance.lacks(poses), atol=1e-12)
    near, close, _ = clearance.near_gaps(poses, 1.0)
    assert close.max() < 1.0
    assert len(near) == (gaps < 1.0).sum()


def test_slopes_are_those_of_the_gaps(poses: np.ndarray) -> None:
    clearance = Clearance.of(CAR, FIELD, OBSTACLES, 0.3, 0.14)
    who, _, slopes = clearance.near_gaps(poses, FAR_M)
    for axis, step in enumerate(np.eye(3) * 1e-6):
        after, before = (clearance.near_gaps(poses + sign * step, FAR_M)[1] for sign in (1.0, -1.0))
        measured = (after - before) / 2e-6
        # Where two axes or two turns change places the slope jumps.
        assert (np.abs(measured - slopes[:, axis]) < 1e-4).mean() > 0.999
    assert len(who) == 6 * len(poses)


@pytest.mark.parametrize("count", [2, 80])
@pytest.mark.parametrize("shift_m", [0.0, -1000.0])
def test_a_car_may_be_just_where_nothing_is_lacking(poses: np.ndarray, count: int, shift_m: float) -> None:
    # Of many obstacles those near a car are looked up in a raster.
    random = np.random.default_rng(count)
    centres = random.uniform(0.0, 1.0, (count, 2)) * (60.0, 40.0)
    obstacles = [
        SceneObstacle(str(k), x + shift_m, y + shift_m, angle, length, 1.0)
        for k, ((x, y), angle, length) in enumerate(
            zip(centres, random.uniform(-4.0, 4.0, count), random.uniform(0.5, 3.0, count), strict=True)
        )
    ]
    field = MapBounds(shift_m, 60.0 + shift_m, shift_m, 40.0 + shift_m)
    clearance = Clearance.of(CAR, field, obstacles, 0.3, 0.14)
    there = poses * (3.0, 40.0 / 15.0, 1.0) + (shift_m, shift_m, 0.0)
    expected = clearance.lacks(there) <= 1e-9
    assert 0.02 < expected.mean() < 0.9
    np.testing.assert_array_equal(clearance.free(there), expected)
    np.testing.assert_array_equal(clearance.free(there.reshape(10, 100, 3)), expected.reshape(10, 100))
