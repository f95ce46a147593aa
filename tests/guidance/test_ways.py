"""Taut lines past boxes, judged by shapely."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
import shapely

from istc_replay.datatypes import MapBounds, SceneObstacle
from istc_replay.geometry import box_corners
from istc_replay.guidance.clearance import Clearance
from istc_replay.guidance.ways import Way, ways_round

from ..support.participants import CAR

FIELD = MapBounds(0.0, 50.0, 0.0, 38.0)
ROOM_M = 1.3
START, GOAL = np.array([5.0, 19.0]), np.array([45.0, 19.0])


def block(x: float, y: float, length: float, width: float, heading: float = 0.0) -> SceneObstacle:
    return SceneObstacle(f"block at {x:g}, {y:g}", x, y, heading, length, width)


def ways(obstacles: list[SceneObstacle]) -> list[Way]:
    return ways_round(START, GOAL, Clearance.of(CAR, FIELD, obstacles, 0.3, 0.0))


def test_nothing_in_the_way_leaves_the_straight_line() -> None:
    assert ways([block(25.0, 30.0, 4.0, 4.0)])[0].points_m.shape == (0, 2)


def test_a_block_is_passed_on_either_side_the_shorter_one_first() -> None:
    near, far = ways([block(25.0, 20.0, 6.0, 8.0)])
    np.testing.assert_allclose(near.points_m, [[22.0, 16.0], [28.0, 16.0]])
    np.testing.assert_allclose(near.sides, 1.0)
    np.testing.assert_allclose(near.rooms_m, ROOM_M)
    assert near.headings_rad[0] < 0.0 < near.headings_rad[1]
    np.testing.assert_allclose(far.points_m, [[22.0, 24.0], [28.0, 24.0]])
    np.testing.assert_allclose(far.sides, -1.0)


def test_a_wall_from_edge_to_edge_leaves_no_way() -> None:
    assert ways([block(25.0, 19.0, 2.0, 38.0)]) == []


def test_an_opening_narrower_than_the_car_is_none() -> None:
    wall = [block(25.0, 9.0, 2.0, 18.0), block(25.0, 28.9, 2.0, 18.2)]
    assert ways(wall) == []


def test_a_turned_block_is_passed_at_its_own_corners() -> None:
    way = ways([block(25.0, 19.5, 6.0, 6.0, math.pi / 4)])[0]
    np.testing.assert_allclose(way.points_m, [[25.0, 19.5 - 3.0 * math.sqrt(2.0)]])


def test_of_many_obstacles_those_out_of_the_way_are_left_out() -> None:
    crowd = [block(x, y, 0.5, 0.5) for x in np.arange(2.0, 49.0, 1.5) for y in (1.0, 37.0)]
    way = ways([*crowd, block(25.0, 20.0, 6.0, 8.0)])[0]
    np.testing.assert_allclose(way.points_m, [[22.0, 16.0], [28.0, 16.0]])


def brute_force(obstacles: list[SceneObstacle], bends: int) -> tuple[float, list[Any]]:
    """The shortest line with at most so many bends at corners of boxes drawn larger, and its corners."""
    spread = 2.0 * ROOM_M * math.sqrt(0.5)
    drawn = [box_corners(o.x_m, o.y_m, 0.0, o.length_m + spread, o.width_m + spread) for o in obstacles]
    true = [box_corners(o.x_m, o.y_m, 0.0, o.length_m, o.width_m) for o in obstacles]
    boxes = shapely.MultiPolygon([shapely.Polygon(corners).buffer(-1e-4) for corners in drawn])
    nodes = list(zip(np.concatenate(drawn), np.concatenate(true), strict=True))
    nodes = [(node, corner) for node, corner in nodes if 1.0 <= node[1] <= 37.0]
    best: tuple[float, list[Any]] = (math.inf, [])
    for count in range(bends + 1):
        for chosen in itertools.permutations(nodes, count):
            line = shapely.LineString([START, *(node for node, _ in chosen), GOAL])
            if line.length < best[0] and not boxes.intersects(line):
                best = line.length, [corner for _, corner in chosen]
    return best


@pytest.mark.parametrize("seed", range(6))
def test_the_first_line_is_the_shortest_there_is(seed: int) -> None:
    random = np.random.default_rng(seed)
    obstacles = [block(x, random.uniform(15.0, 23.0), *random.uniform(2.0, 7.0, 2)) for x in (16.0, 32.0)]
    _, corners = brute_force(obstacles, 4)
    np.testing.assert_allclose(ways(obstacles)[0].points_m, np.reshape(corners, (-1, 2)), atol=1e-9)
