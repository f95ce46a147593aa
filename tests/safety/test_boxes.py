"""The box kernel against shapely, and against the hull of the Minkowski difference."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from istc_replay.geometry import box_corners
from istc_replay.safety.boxes import box_gap

Array = NDArray[np.float64]


def random_boxes(rng: np.random.Generator, n: int, spread: float) -> Array:
    return np.column_stack(
        [
            rng.uniform(-spread, spread, (n, 2)),
            rng.uniform(-7, 7, n),
            rng.uniform(0.3, 6.0, n),
            rng.uniform(0.2, 3.0, n),
        ]
    )


def pairs(kind: str, n: int = 4000) -> tuple[Array, Array]:
    rng = np.random.default_rng(sum(kind.encode()))
    a, b = random_boxes(rng, n, 5.0), random_boxes(rng, n, 5.0)
    if kind == "parallel":
        b[:, 2] = a[:, 2] + rng.integers(0, 2, n) * np.pi
    elif kind == "perpendicular":
        b[:, 2] = a[:, 2] + np.pi / 2
    elif kind == "axis aligned":
        a[:, 2], b[:, 2] = rng.integers(-4, 5, n) * np.pi / 2, rng.integers(-4, 5, n) * np.pi / 2
    elif kind == "nearly parallel":
        b[:, 2] = a[:, 2] + rng.normal(0, 1e-7, n)
    elif kind == "contained":
        b[:, :2] = a[:, :2] + rng.normal(0, 0.1, (n, 2))
        b[:, 3:] = a[:, 3:] * rng.uniform(0.01, 0.3, (n, 1))
    elif kind == "the same box":
        b = a.copy()
    elif kind == "far":
        b[:, :2] += rng.normal(0, 300, (n, 2))
    return a, b


def signed_distance_by_minkowski(a: Array, b: Array) -> Array:
    """Signed distance of the origin from the hull of all differences of corners."""
    differences = (box_corners(*a.T)[:, :, None] - box_corners(*b.T)[:, None, :]).reshape(-1, 16, 2)
    hulls = shapely.convex_hull(shapely.multipoints(differences))
    origin = shapely.points(np.zeros(2))
    depth = shapely.distance(shapely.boundary(hulls), origin)
    return np.where(shapely.intersects(hulls, origin), -depth, depth)


KINDS = [
    "any",
    "parallel",
    "perpendicular",
    "axis aligned",
    "nearly parallel",
    "contained",
    "the same box",
    "far",
]


@pytest.mark.parametrize("kind", KINDS)
def test_gaps_equal_shapelys_distance_where_boxes_are_disjoint(kind: str) -> None:
    a, b = pairs(kind)
    polygons = [shapely.polygons(box_corners(*boxes.T)) for boxes in (a, b)]
    np.testing.assert_allclose(np.maximum(box_gap(a, b), 0.0), shapely.distance(*polygons), rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_signs_and_depths_equal_those_of_the_minkowski_difference(kind: str) -> None:
    a, b = pairs(kind)
    gap, oracle = box_gap(a, b), signed_distance_by_minkowski(a, b)
    np.testing.assert_allclose(gap, oracle, rtol=0, atol=1e-9)
    assert (np.sign(gap) == np.sign(oracle))[np.abs(oracle) > 1e-9].all()


def test_gaps_are_symmetric_and_do_not_depend_on_the_frame() -> None:
    a, b = pairs("any")
    gap = box_gap(a, b)
    np.testing.assert_allclose(box_gap(b, a), gap, rtol=0, atol=1e-12)
    angle, c, s = 0.7, np.cos(0.7), np.sin(0.7)
    turned = []
    for boxes in (a, b):
        moved = boxes.copy()
        moved[:, 0], moved[:, 1] = c * boxes[:, 0] - s * boxes[:, 1], s * boxes[:, 0] + c * boxes[:, 1]
        moved[:, 2] += angle
        turned.append(moved)
    np.testing.assert_allclose(box_gap(*turned), gap, rtol=0, atol=1e-12)


def test_utm_sized_coordinates_cost_nothing() -> None:
    a, b = pairs("any")
    for boxes in (a, b):
        boxes[:, :2] = np.round(boxes[:, :2] * 1024) / 1024  # exact at a distance, too
    gap = box_gap(a, b)
    offset = np.array([691_608.0, 5_334_000.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(box_gap(a + offset, b + offset), gap)


@pytest.mark.parametrize("turn", [0.0, 0.3, np.pi / 4, np.pi / 2, -3.0])
def test_touching_boxes_have_a_gap_of_nothing(turn: float) -> None:
    side = [4.0 * np.cos(turn), 4.0 * np.sin(turn)]
    boxes = np.array([[0.0, 0.0, turn, 4.0, 2.0], [*side, turn, 4.0, 2.0]])
    assert box_gap(boxes[0], boxes[1]) == pytest.approx(0.0, abs=1e-15)


def test_a_corner_that_touches_a_side_has_a_gap_of_nothing() -> None:
    diamond = [1.0 + np.sqrt(2.0), 0.3, np.pi / 4, 2.0, 2.0]
    assert box_gap([0.0, 0.0, 0.0, 2.0, 2.0], diamond) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("column", range(5))
def test_what_is_not_finite_has_no_gap(value: float, column: int) -> None:
    box, other = np.array([0.0, 0.0, 0.1, 4.0, 2.0]), np.array([7.0, 1.0, 0.4, 4.0, 2.0])
    broken = box.copy()
    broken[column] = value
    assert np.isnan(box_gap(broken, other))
    assert np.isnan(box_gap(other, broken))
    assert np.isfinite(box_gap(box, other))


def test_shapes_broadcast_and_blocks_join() -> None:
    a, b = pairs("any", 200)
    table = box_gap(a[:, None], b[None, :])  # 40,000 pairs: more than two blocks
    assert table.shape == (200, 200)
    np.testing.assert_array_equal(np.diagonal(table), box_gap(a, b))
    assert box_gap(np.empty((0, 5)), np.empty((0, 5))).shape == (0,)
