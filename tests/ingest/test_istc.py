"""Scenes of istc.v1: what is sound is read, and each part that is not is left out by its name."""

from __future__ import annotations

from typing import Any

import pytest

from istc_replay.config import VehiclesConfig
from istc_replay.datatypes import Dimensions, MapBounds, StaticScene, VehicleInfo
from istc_replay.ingest.istc import SceneReader
from istc_replay.ingest.payload import PayloadError
from istc_replay.ingest.problems import Problems
from istc_replay.ingest.scene import SceneParts
from istc_replay.messages import message

NAN, INF = float("nan"), float("inf")
LINE = [{"x_m": 0.0, "y_m": 0.0}, {"x_m": 9.0, "y_m": 1.0}]
POINT, BENT = LINE[:1], [*LINE, {"x_m": NAN, "y_m": 0.0}]
BOX = {"length_m": 4.0, "width_m": 2.0}


def read(**parts: Any) -> tuple[StaticScene, list[str]]:
    """The scene of one message, and what is told of it."""
    found, problems = SceneParts(), Problems()
    SceneReader(found, VehiclesConfig(), problems).read(message("Scene")(**parts).SerializeToString())
    return found.scene(), [problem.detail for problem in problems.found()]


@pytest.mark.parametrize("points", [[], POINT, BENT])
@pytest.mark.parametrize(
    ("part", "name", "what"),
    [
        ("lane_lines", "lane_id", "lane line 'x'"),
        ("road_edges", "edge_id", "road edge 'x'"),
        ("road_areas", "area_id", "road area 'x'"),
    ],
)
def test_a_line_that_is_none_is_left_out_by_name(
    part: str, name: str, what: str, points: list[dict[str, float]]
) -> None:
    triangle = [*LINE, {"x_m": 0.0, "y_m": 9.0}]
    scene, told = read(**{part: [{name: "x", "points": points}, {name: "y", "points": triangle}]})
    assert [getattr(each, name) for each in getattr(scene, part)] == ["y"]
    (detail,) = told
    assert detail.startswith(f"{what} of the scene is left out: it needs at least ")


def test_an_area_has_three_points_at_least() -> None:
    scene, told = read(road_areas=[{"area_id": "x", "points": LINE}])
    assert scene.road_areas == ()
    assert "three finite points" in told[0]


@pytest.mark.parametrize("right", [[], POINT, BENT])
def test_a_lane_whose_edges_are_not_both_told_is_a_line_without_edges(right: list[dict[str, float]]) -> None:
    lanes = [{"lane_id": "x", "points": LINE, "left": LINE, "right": right}]
    scene, told = read(lane_lines=lanes)
    (line,) = scene.lane_lines
    assert (line.left_m, line.right_m) == (None, None)
    assert told[0].startswith("edges of lane line 'x' of the scene is left out: of both sides")


@pytest.mark.parametrize(
    "values",
    [
        {"x_min_m": 1.0, "x_max_m": 1.0, "y_min_m": 0.0, "y_max_m": 1.0},
        {"x_min_m": 0.0, "x_max_m": 1.0, "y_min_m": 2.0, "y_max_m": 1.0},
        {"x_min_m": NAN, "x_max_m": 1.0, "y_min_m": 0.0, "y_max_m": 1.0},
        {"x_min_m": 0.0, "x_max_m": INF, "y_min_m": 0.0, "y_max_m": 1.0},
    ],
)
def test_bounds_that_hold_nothing_are_left_out(values: dict[str, float]) -> None:
    scene, told = read(bounds=values)
    assert scene.bounds is None
    assert told[0].startswith("the map's bounds of the scene is left out")
    sound = {"x_min_m": -1.0, "x_max_m": 1.0, "y_min_m": -2.0, "y_max_m": 2.0}
    assert read(bounds=sound) == (StaticScene(bounds=MapBounds(-1.0, 1.0, -2.0, 2.0)), [])


@pytest.mark.parametrize("priority", [0.0, -1.0, NAN, INF])
def test_a_priority_that_orders_nobody_is_left_out(priority: float) -> None:
    scene, told = read(vehicles=[{"vehicle_id": "x", "priority": priority}])
    assert scene.vehicles == (VehicleInfo("x"),)
    assert told == ["priority of vehicle 'x' of the scene is left out: it must be above 0"]


@pytest.mark.parametrize(
    "box",
    [
        {"length_m": 4.0},
        {**BOX, "width_m": -2.0},
        {**BOX, "length_m": INF},
        {**BOX, "wheelbase_m": 0.0},
        {**BOX, "rear_axle_to_centre_m": NAN},
    ],
)
def test_a_size_that_no_vehicle_has_is_left_out(box: dict[str, float]) -> None:
    scene, told = read(vehicles=[{"vehicle_id": "x", "priority": 0.5, "dimensions": box}])
    assert scene.vehicles == (VehicleInfo("x", 0.5),)
    assert told == ["size of vehicle 'x' of the scene is left out: it must be finite and above 0"]


def test_a_size_without_axles_has_those_of_the_settings() -> None:
    scene, told = read(vehicles=[{"vehicle_id": "x", "dimensions": BOX}])
    wheelbase_m = VehiclesConfig().wheelbase_ratio * 4.0
    assert scene.vehicles == (VehicleInfo("x", None, Dimensions(4.0, 2.0, wheelbase_m, wheelbase_m / 2.0)),)
    assert told == []


@pytest.mark.parametrize("values", [{"length_m": 0.0}, {"x_m": NAN}, {"heading_rad": INF}])
def test_an_obstacle_without_a_place_or_a_size_is_left_out(values: dict[str, float]) -> None:
    whole = {"obstacle_id": "x", "x_m": 1.0, "y_m": 2.0, "heading_rad": 0.5, **BOX}
    scene, told = read(obstacles=[whole | values, whole | {"obstacle_id": "y"}])
    assert [obstacle.obstacle_id for obstacle in scene.obstacles] == ["y"]
    assert told == ["obstacle 'x' of the scene is left out: it needs finite numbers and a size above 0"]


def test_bytes_that_are_no_scene_are_told() -> None:
    with pytest.raises(PayloadError, match=r"not an istc\.v1\.Scene"):
        SceneReader(SceneParts(), VehiclesConfig(), Problems()).read(b"\xff\xff")
