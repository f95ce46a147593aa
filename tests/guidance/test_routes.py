"""Paths found past obstacles, judged by shapely and by their own curvature."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from istc_replay.config import GuidanceConfig
from istc_replay.datatypes import Dimensions, MapBounds, SceneObstacle
from istc_replay.errors import ScenarioError
from istc_replay.geometry import box_corners, shift_along
from istc_replay.guidance.curves import Curve, Pose
from istc_replay.guidance.dubins import word_lengths
from istc_replay.guidance.routes import Task, find_path, find_paths

from ..support.participants import CAR

FIELD = MapBounds(0.0, 50.0, 0.0, 38.0)
LEAST_RADIUS_M = 2.7 / math.tan(0.6)
SETTINGS = GuidanceConfig()


def block(x_min: float, x_max: float, y_min: float, y_max: float, heading: float = 0.0) -> SceneObstacle:
    middle = (x_min + x_max) / 2, (y_min + y_max) / 2
    return SceneObstacle("block", *middle, heading, x_max - x_min, y_max - y_min)


def outline(obstacle: SceneObstacle) -> Any:
    o = obstacle
    return shapely.Polygon(box_corners(o.x_m, o.y_m, o.heading_rad, o.length_m, o.width_m))


def boxes(curve: Curve, car: Dimensions = CAR, turned: float = 0.0) -> Any:
    poses = curve.spaced_poses(0.1)
    x, y = shift_along(poses[:, 0], poses[:, 1], poses[:, 2], car.rear_axle_to_centre_m).T
    return shapely.polygons(box_corners(x, y, poses[:, 2] + turned, car.length_m, car.width_m))


def assert_drivable(
    curve: Curve, start: Pose, goal: Pose, obstacles: list[SceneObstacle], margin_m: float = 0.29
) -> None:
    """Ends met, curvature bounded and continuous, box within the field and clear of the obstacles."""
    first, last = curve.poses([0.0, curve.length_m])
    np.testing.assert_allclose(first[:2], [start.x_m, start.y_m], atol=1e-9)
    np.testing.assert_allclose(last[:2], [goal.x_m, goal.y_m], atol=1e-8)
    assert math.remainder(last[2] - goal.heading_rad, 2 * math.pi) == pytest.approx(0.0, abs=1e-8)
    assert np.abs(curve.curvatures_1pm).max() <= 1.001 / LEAST_RADIUS_M
    assert np.abs(curve.curvatures_1pm[[0, -1]]).max() < 1e-9
    driven = boxes(curve)
    field = shapely.box(FIELD.x_min_m, FIELD.y_min_m, FIELD.x_max_m, FIELD.y_max_m).buffer(0.011)
    assert shapely.covers(field, driven).all()
    for obstacle in obstacles:
        assert shapely.distance(outline(obstacle), driven).min() >= margin_m


START, GOAL = Pose(7.75, 6.5, 0.0), Pose(46.25, 13.5, 0.0)


def shortest_word_m(radius_m: float) -> float:
    return float(word_lengths(START.as_array(), GOAL.as_array(), radius_m).sum(axis=1).min())


@pytest.mark.parametrize(
    "obstacles",
    [
        [],
        [block(22, 28, 6, 14)],
        [block(25, 30, 2, 12)],
        [block(20, 24, 9, 30)],
        [block(20, 28, 6, 9, math.pi / 4)],
        [block(18, 22, 0, 12), block(30, 34, 14, 38)],
    ],
)
def test_a_path_is_drivable_and_keeps_clear(obstacles: list[SceneObstacle]) -> None:
    curve = find_path(START, GOAL, CAR, FIELD, obstacles, SETTINGS)
    assert_drivable(curve, START, GOAL, obstacles)
    straight = math.hypot(GOAL.x_m - START.x_m, GOAL.y_m - START.y_m)
    assert curve.length_m >= straight
    assert curve.length_m >= shortest_word_m(LEAST_RADIUS_M)


def test_the_margin_holds_for_headings_within_the_slack() -> None:
    obstacle = block(22, 28, 6, 14)
    curve = find_path(START, GOAL, CAR, FIELD, [obstacle], SETTINGS)
    slack = SETTINGS.route_heading_slack_rad
    for turned in (-slack, -slack / 2, slack / 2, slack):
        assert shapely.distance(outline(obstacle), boxes(curve, turned=turned)).min() >= 0.27


def test_without_obstacles_the_path_is_nearly_the_shortest_there_is() -> None:
    curve = find_path(START, GOAL, CAR, FIELD, [], SETTINGS)
    assert curve.length_m <= shortest_word_m(6.0) + 0.2


def test_a_smaller_margin_gives_a_path_that_is_not_longer() -> None:
    obstacles = [block(22, 28, 6, 14)]
    near, far = (
        find_path(START, GOAL, CAR, FIELD, obstacles, GuidanceConfig(route_margin_m=margin))
        for margin in (0.1, 1.0)
    )
    assert near.length_m <= far.length_m + 0.05
    assert_drivable(far, START, GOAL, obstacles, 0.98)


def mirrored(pose: Pose) -> Pose:
    return Pose(pose.x_m, 38.0 - pose.y_m, -pose.heading_rad)


def turned(pose: Pose) -> Pose:
    return Pose(50.0 - pose.x_m, 38.0 - pose.y_m, pose.heading_rad + math.pi)


@pytest.mark.parametrize("change", [mirrored, turned])
def test_a_mirrored_or_turned_scene_has_a_path_of_the_same_length(change: Any) -> None:
    obstacle = block(22, 28, 6, 14)
    moved = change(Pose(obstacle.x_m, obstacle.y_m, 0.0))
    other = SceneObstacle("block", moved.x_m, moved.y_m, 0.0, obstacle.length_m, obstacle.width_m)
    here = find_path(START, GOAL, CAR, FIELD, [obstacle], SETTINGS)
    there = find_path(change(START), change(GOAL), CAR, FIELD, [other], SETTINGS)
    assert there.length_m == pytest.approx(here.length_m, rel=0.01)


def test_the_same_task_gives_the_same_path_bit_for_bit() -> None:
    obstacles = [block(22, 28, 6, 14)]
    first, second = (find_path(START, GOAL, CAR, FIELD, obstacles, SETTINGS) for _ in range(2))
    assert first.breaks_m.tobytes() == second.breaks_m.tobytes()
    assert first.curvatures_1pm.tobytes() == second.curvatures_1pm.tobytes()


@pytest.mark.parametrize(
    ("start", "goal", "car", "obstacles", "told"),
    [
        (START, GOAL, CAR, [block(44, 49, 11, 16)], "at its goal .* overlaps block"),
        (START, GOAL, CAR, [block(8, 9, 6, 7)], "at its start .* overlaps block"),
        (START, GOAL, CAR, [block(20, 24, 0, 38)], "no opening .* is wide enough"),
        (START, GOAL, CAR, [block(20, 24, 0, 18), block(20, 24, 19, 38)], "no opening .* is wide enough"),
        (START, GOAL, Dimensions(70.0, 2.0, 40.0, 0.0), [], "does not fit on a map"),
        (START, Pose(49.0, 13.5, 0.0), CAR, [], "at its goal .* sticks out of the map by 2.35 m"),
        (Pose(4.0, 20.0, math.pi), GOAL, CAR, [block(0, 1, 0, 38)], "at its start .* overlaps block"),
        (Pose(5.0, 20.0, math.pi), GOAL, CAR, [], "at its start .* cannot drive off forward"),
        (START, Pose(2.0, 20.0, 0.0), CAR, [], "at its goal .* cannot arrive forward"),
    ],
)
def test_what_cannot_be_is_named_at_once(
    start: Pose, goal: Pose, car: Dimensions, obstacles: list[SceneObstacle], told: str
) -> None:
    # A budget of one node: nothing is searched for.
    with pytest.raises(ScenarioError, match=told) as caught:
        find_path(start, goal, car, FIELD, obstacles, GuidanceConfig(route_node_budget=1))
    assert "\n" not in str(caught.value)


def test_an_opening_just_too_narrow_ends_within_the_budget() -> None:
    obstacles = [block(20, 24, 0, 18), block(20, 24, 20.3, 38)]
    with pytest.raises(ScenarioError, match=r"none within 300 nodes|every way is closed"):
        find_path(START, GOAL, CAR, FIELD, obstacles, GuidanceConfig(route_node_budget=300))


def test_an_opening_wide_enough_is_found() -> None:
    obstacles = [block(20, 24, 0, 18), block(20, 24, 21.6, 38)]
    curve = find_path(START, GOAL, CAR, FIELD, obstacles, SETTINGS)
    assert_drivable(curve, START, GOAL, obstacles)


def test_a_start_closer_to_an_obstacle_than_the_margin_is_driven_from() -> None:
    obstacles = [block(5, 30, 7.6, 9)]
    curve = find_path(START, GOAL, CAR, FIELD, obstacles, SETTINGS)
    assert_drivable(curve, START, GOAL, obstacles, 0.085)


def tasks(*pairs: tuple[Pose, Pose]) -> list[Task]:
    return [Task(str(index), start, goal, CAR) for index, (start, goal) in enumerate(pairs, start=1)]


def test_a_vehicle_without_a_path_is_named() -> None:
    jobs = tasks((START, GOAL), (START, Pose(49.0, 13.5, 0.0)))
    with pytest.raises(ScenarioError, match="vehicle 2: no path"):
        find_paths(jobs, FIELD, [], SETTINGS, 5.0)


def test_coordinated_vehicles_take_different_openings_at_the_same_time() -> None:
    # A wall with two openings at y = 12 .. 17 and 21 .. 26; both vehicles meet it at the same time.
    wall = [block(24, 26, 0, 12), block(24, 26, 17, 21), block(24, 26, 26, 38)]
    jobs = tasks((Pose(5, 17, 0.0), Pose(45, 17, 0.0)), (Pose(45, 18, math.pi), Pose(5, 18, math.pi)))
    crossings = {}
    for routing in ("independent", "coordinated"):
        paths = find_paths(jobs, FIELD, wall, GuidanceConfig(routing=routing), 5.0)
        for task, path in zip(jobs, paths, strict=True):
            assert_drivable(path, task.start, task.goal, wall)
        crossings[routing] = [
            float(np.interp(25.0, *poses[np.argsort(poses[:, 0])][:, :2].T))
            for poses in (path.spaced_poses(0.1) for path in paths)
        ]
    first, second = crossings["coordinated"]
    assert (first < 19.0) != (second < 19.0)
    assert crossings["independent"][0] == pytest.approx(first, abs=1e-9)


@pytest.fixture
def scene(shared_scenarios: Path) -> Callable[[str], dict[str, Any]]:
    """A function that reads a reference scene by its name."""
    return lambda name: dict(json.loads((shared_scenarios / f"{name}.json").read_text(encoding="utf-8")))


def pose(values: dict[str, float]) -> Pose:
    return Pose(values["x_m"], values["y_m"], values["heading_rad"])


@pytest.mark.parametrize("kind", ["", "_obstacles", "_row"])
def test_the_dense_crossings_are_driven_and_not_longer_than_the_peers(
    kind: str, scene: Callable[[str], dict[str, Any]]
) -> None:
    # The scenes of 4 and 6 vehicles are the first ones of the scene of 8.
    values = scene(f"dense_8{kind}")
    peers = {row["name"]: row["length_m"] for row in scene("peer_clcbs")["rows"]}
    obstacles = [block(o["x_min_m"], o["x_max_m"], o["y_min_m"], o["y_max_m"]) for o in values["obstacles"]]
    jobs = tasks(*((pose(v["start"]), pose(v["goal"])) for v in values["vehicles"]))
    paths = find_paths(jobs, FIELD, obstacles, SETTINGS, 5.0)
    for task, path in zip(jobs, paths, strict=True):
        assert_drivable(path, task.start, task.goal, obstacles)
    sums = list(itertools.accumulate(path.length_m for path in paths))
    for count in (4, 6, 8):
        assert sums[count - 1] <= peers[f"dense_{count}{kind}"]


@pytest.mark.parametrize(
    ("name", "unreachable"),
    [
        ("clcbs50_agents5_empty_ex26", []),
        ("clcbs50_agents5_empty_ex37", []),
        ("clcbs50_agents10_empty_ex54", ["8"]),
    ],
)
def test_open_benchmark_scenes_are_solved_but_for_goals_that_need_reversing(
    name: str, unreachable: list[str], scene: Callable[[str], dict[str, Any]]
) -> None:
    values = scene(f"clcbs/{name}")
    car = Dimensions(3.0, 2.0, 1.95, 0.5)
    field = MapBounds(0.0, 50.0, 0.0, 50.0)
    for vehicle in values["vehicles"]:
        start, goal = pose(vehicle["start"]), pose(vehicle["goal"])
        if vehicle["id"] in unreachable:
            with pytest.raises(ScenarioError, match="cannot arrive forward"):
                find_path(start, goal, car, field, [], SETTINGS, least_radius_m=3.0)
            continue
        curve = find_path(start, goal, car, field, [], SETTINGS, least_radius_m=3.0)
        assert np.abs(curve.curvatures_1pm).max() <= 1.001 / 3.0
        np.testing.assert_allclose(curve.end[:2], [goal.x_m, goal.y_m], atol=1e-8)
        assert shapely.covers(shapely.box(0, 0, 50, 50).buffer(0.011), boxes(curve, car)).all()
