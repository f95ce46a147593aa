"""The road across a vehicle's way, against shapely's union of the same lanes."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from istc_replay.datatypes import LaneLine, RoadArea, RoadEdge, StaticScene, read_only
from istc_replay.polyline import beside, middle_line
from istc_replay.road import Road, scene_near


def lane(name: str, line: np.ndarray, left_m: float, right_m: float) -> LaneLine:
    """A lane between two distances to the left of a line."""
    left, right = beside(line, left_m), beside(line, right_m)
    return LaneLine(name, read_only(middle_line(left, right)), None, read_only(left), read_only(right))


def bend(first_rad: float = 0.0, last_rad: float = 2.0, count: int = 40) -> np.ndarray:
    """A left-hand bend of 60 m radius, far from the origin."""
    angle = np.linspace(first_rad, last_rad, count)
    return np.stack([60.0 * np.sin(angle) + 5e5, 60.0 - 60.0 * np.cos(angle) - 4e6], axis=-1)


def test_side_by_side_lanes_are_one_road_as_wide_as_shapely_says() -> None:
    lanes = [
        lane("1", bend(), 1.75, -1.75),
        lane("2", bend()[::-1], -1.75, -5.25),
        lane("3", bend(), -9.0, -12.0),
    ]
    road = Road.of(StaticScene(tuple(lanes)))
    assert road is not None
    polygons = [shapely.Polygon(np.vstack([each.left_m, each.right_m[::-1]])) for each in lanes]  # type: ignore[list-item,index]
    union = shapely.union_all(polygons[:2]).buffer(1e-6)
    rng = np.random.default_rng(5)
    angle, radius, turn = (
        rng.uniform(0.1, 1.9, 200),
        rng.uniform(54.0, 62.0, 200),
        rng.uniform(-0.3, 0.3, 200),
    )
    poses = np.stack([radius * np.sin(angle) + 5e5, 60 - radius * np.cos(angle) - 4e6, angle + turn], axis=-1)
    free = road.free_m(poses)
    assert np.isnan(free).any()  # some are off the road
    for pose, (left, right) in zip(poses, free, strict=True):
        centre = shapely.Point(pose[:2])
        if np.isnan(left):
            assert not union.buffer(-1e-3).contains(centre)
            continue
        across = np.array([-np.sin(pose[2]), np.cos(pose[2])])
        line = shapely.LineString([pose[:2] - 25.0 * across, pose[:2] + 25.0 * across])
        parts = shapely.get_parts(line.intersection(union))
        own = min(parts, key=lambda part: part.distance(centre))
        ends = (np.array(own.coords) - pose[:2]) @ across
        assert (ends.max(), -ends.min()) == pytest.approx((left, right), abs=1e-3)


def test_lanes_that_follow_each_other_leave_no_hole_and_the_nearest_edge_ends_the_road() -> None:
    first, second = np.array([[0.0, 0.0], [50.0, 0.0]]), np.array([[50.05, 0.0], [100.0, 0.0]])
    kerb = RoadEdge("kerb", read_only([[60.0, 1.2], [100.0, 1.2]]))
    far = RoadEdge("far", read_only([[0.0, 80.0], [100.0, 80.0]]))
    road = Road.of(
        StaticScene((lane("1", first, 2.0, -2.0), lane("2", second, 2.0, -2.0)), road_edges=(kerb, far))
    )
    assert road is not None
    at = np.column_stack([[1.0, 49.99, 50.02, 50.06, 70.0, 99.0, 120.0], np.zeros(7), np.zeros(7)])
    told = [[2.0, 2.0]] * 4 + [[1.2, 2.0]] * 2 + [[np.nan, np.nan]]
    np.testing.assert_allclose(road.free_m(at), told)
    alone = Road.of(StaticScene(road_edges=(kerb,)))
    assert alone is not None
    np.testing.assert_allclose(alone.free_m(at)[4], [1.2, np.nan])
    assert Road.of(StaticScene((LaneLine("line", read_only(first)),))) is None


def test_an_area_joins_the_lanes_that_lead_to_it() -> None:
    lanes = tuple(
        lane(str(k), np.array([[x, 0.0], [x + 40.0, 0.0]]), 2.0, -2.0) for k, x in enumerate((0.0, 60.0))
    )
    junction = RoadArea(
        "J", read_only([[40.0, -2.0], [40.0, 2.0], [45.0, 9.0], [55.0, 9.0], [60.0, 2.0], [60.0, -2.0]])
    )
    road = Road.of(StaticScene(lanes, road_areas=(junction,)))
    assert road is not None
    at = np.column_stack([[20.0, 50.0, 70.0, 110.0], np.zeros((4, 2))])
    np.testing.assert_allclose(road.free_m(at), [[2.0, 2.0], [9.0, 2.0], [2.0, 2.0], [np.nan, np.nan]])


def test_what_is_far_from_a_window_is_left_out_of_it() -> None:
    lanes = tuple(
        lane(str(k), np.array([[k * 1000.0, 0.0], [k * 1000.0 + 900.0, 0.0]]), 2.0, -2.0) for k in range(9)
    )
    intent = LaneLine("own", read_only([[8e3, 0.0], [9e3, 0.0]]), "7")
    scene = StaticScene((*lanes, intent), road_edges=(RoadEdge("kerb", read_only([[0.0, 2.0], [9.0, 2.0]])),))
    near = scene_near(scene, np.array([[2500.0, 0.0], [3100.0, 5.0], [np.nan, 0.0]]))
    assert [line.lane_id for line in near.lane_lines] == ["2", "3", "own"]
    assert near.road_edges == ()


def test_an_edge_of_many_points_is_found_as_one_of_two() -> None:
    x = np.linspace(-50.0, 50.0, 20_000)
    many = RoadEdge("many", read_only(np.column_stack([x, np.full_like(x, 3.0)])))
    few = RoadEdge("few", read_only([[-50.0, 3.0], [50.0, 3.0]]))
    poses = np.column_stack([np.linspace(-40.0, 40.0, 150), np.zeros((150, 2))])
    found = [Road((), (edge.points_m,)).free_m(poses) for edge in (many, few)]
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)
    assert (found[0][:, 0] == 3.0).all()
