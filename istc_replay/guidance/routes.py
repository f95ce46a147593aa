"""A drivable path for one vehicle past the obstacles of its map, or several vehicles in turn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.datatypes import Dimensions, FloatArray, MapBounds, SceneObstacle
from istc_replay.errors import ScenarioError
from istc_replay.geometry import shift_along
from istc_replay.guidance.clearance import Clearance
from istc_replay.guidance.curves import Curve, Pose
from istc_replay.guidance.dubins import word_lengths
from istc_replay.guidance.grid import DistanceGrid, distances_to
from istc_replay.guidance.hybrid_astar import is_dead_end
from istc_replay.guidance.path_search import along_taut_lines, searched
from istc_replay.guidance.taut import Limits
from istc_replay.guidance.traffic import Traffic

if TYPE_CHECKING:
    from istc_replay.config import GuidanceConfig

#: A path this much longer than the shortest without obstacles is compared with a search's.
_LONG = 1.2
#: Change of curvature per metre, times the wheelbase: 0.68 rad/s of steering at 5 m/s.
_SHARPNESS = 0.135
#: Where no path is found: the same with sharper steering, and without slack for the heading.
_EASINGS = (1.0, 4.0)
_STEERING_MAX_RAD = 0.6


def find_path(
    start: Pose,
    goal: Pose,
    car: Dimensions,
    bounds: MapBounds,
    obstacles: Sequence[SceneObstacle],
    settings: GuidanceConfig,
    *,
    least_radius_m: float | None = None,
    traffic: Traffic | None = None,
) -> Curve:
    """Find a short path of continuous, bounded curvature from start to goal.

    Taut lines past the obstacles, or else forward hybrid A*, give sharp paths; one of them is pulled
    taut to a smooth one.

    Parameters
    ----------
    start, goal : Pose
        Poses of the rear axle, met exactly [m, rad].
    car : Dimensions
        The vehicle's box and axles.
    bounds : MapBounds
        What the box stays in.
    obstacles : sequence of SceneObstacle
        Oriented boxes that the car-box, turned by `route_heading_slack_rad` either way, keeps
        `route_margin_m` from; less where start or goal leave less.
    settings : GuidanceConfig
        Turning radius, margins and node budget.
    least_radius_m : float, optional
        Least turning radius; otherwise that of a steering angle of 0.6 rad [m].
    traffic : Traffic, optional
        Other vehicles, avoided softly.

    Raises
    ------
    ScenarioError
        If there is no path, or none within the node budget; the message says which, and why.
    """
    ends = np.array([start.as_array(), goal.as_array()])
    clearance = Clearance.of(
        car, bounds, obstacles, settings.route_margin_m, settings.route_heading_slack_rad
    )
    _refuse_impossible_ends(ends, clearance, obstacles)
    clearance = clearance.eased_at(ends)
    least = car.wheelbase_m / math.tan(_STEERING_MAX_RAD) if least_radius_m is None else least_radius_m
    shortest = float(word_lengths(ends[0], ends[1], least).sum(axis=1).min())
    grid, exhausted = None, True
    for easing in _EASINGS:
        limits = Limits(
            1.0 / least,
            1.0 / max(settings.route_radius_m, least),
            easing * _SHARPNESS / car.wheelbase_m,
            clearance if easing == 1.0 else clearance.unslacked(),
        )
        best = along_taut_lines(ends, limits, traffic)
        if best is not None and best.length_m <= _LONG * shortest:
            return best
        if best is None and grid is None:
            grid = _grid(ends, clearance)
            _refuse_dead_ends(ends, least, clearance.unslacked())
        best, ended = searched(ends, limits, grid, settings.route_node_budget, best)
        if best is not None:
            return best
        exhausted &= ended
    why = "every way is closed" if exhausted else f"none within {settings.route_node_budget} nodes"
    raise ScenarioError(
        f"no path to the goal for a turning radius of {least:.3g} m or more and "
        f"{settings.route_margin_m:g} m beside the {len(obstacles)} obstacles: {why}; "
        "give start and goal more room, or move an obstacle"
    )


@dataclass(frozen=True, slots=True)
class Task:
    """What one vehicle wants: from a pose of its rear axle to another, with its least turning radius."""

    vehicle_id: str
    start: Pose
    goal: Pose
    car: Dimensions
    least_radius_m: float | None = None


def find_paths(
    tasks: Sequence[Task],
    bounds: MapBounds,
    obstacles: Sequence[SceneObstacle],
    settings: GuidanceConfig,
    speed_mps: float,
) -> tuple[Curve, ...]:
    """Find a path for every vehicle: each alone, or with `routing = "coordinated"` each in its turn.

    In turn, a vehicle prefers ways that those before it do not use at the same time at this speed
    [m/s]; standing vehicles and later ones it does not know.

    Raises
    ------
    ScenarioError
        If a vehicle has no path; the message begins with its name.
    """
    paths: list[Curve] = []
    taken: list[FloatArray] = []
    for task in tasks:
        traffic = Traffic.of(taken, speed_mps)
        try:
            path = find_path(
                task.start,
                task.goal,
                task.car,
                bounds,
                obstacles,
                settings,
                least_radius_m=task.least_radius_m,
                traffic=traffic,
            )
        except ScenarioError as error:
            raise ScenarioError(f"vehicle {task.vehicle_id}: {error}") from None
        paths.append(path)
        if settings.routing == "coordinated":
            taken.append(path.points(np.arange(0.0, path.length_m, Traffic.spacing_m(speed_mps))))
    return tuple(paths)


def _grid(ends: FloatArray, clearance: Clearance) -> DistanceGrid | None:
    """Distances to the goal; none are needed where nothing is in the way."""
    if not len(clearance.obstacles):
        return None
    start, goal = shift_along(ends[:, 0], ends[:, 1], ends[:, 2], clearance.car.rear_axle_to_centre_m)
    grid = distances_to(goal, clearance)
    if np.isinf(grid.at(start)):
        raise ScenarioError(
            f"no path to the goal: no opening between the obstacles is wide enough for a car of "
            f"{clearance.car.width_m:g} m; move an obstacle"
        )
    return grid


def _refuse_impossible_ends(
    ends: FloatArray, clearance: Clearance, obstacles: Sequence[SceneObstacle]
) -> None:
    """Raise where the car cannot even stand at its start or goal."""
    car, bounds = clearance.car, clearance.bounds
    sides = (bounds.x_max_m - bounds.x_min_m, bounds.y_max_m - bounds.y_min_m)
    if car.width_m > min(sides) or car.length_m > math.hypot(*sides):
        raise ScenarioError(
            f"no path: a car of {car.length_m:g} m x {car.width_m:g} m does not fit on a map of "
            f"{sides[0]:g} m x {sides[1]:g} m; give a larger map"
        )
    rooms = clearance.rooms(ends)
    gaps = clearance.unslacked().gaps(ends)
    for name, pose, room, row in zip(("start", "goal"), ends, rooms, gaps, strict=True):
        where = f"no path: at its {name} ({pose[0]:g}, {pose[1]:g}) the car"
        if room < -1e-6:
            raise ScenarioError(f"{where} sticks out of the map by {-room:.2f} m; move the {name}")
        if len(row) and row.min() <= 0.0:
            name_of = obstacles[int(np.argmin(row))].obstacle_id
            raise ScenarioError(f"{where} overlaps {name_of}; move the {name} or the obstacle")


def _refuse_dead_ends(ends: FloatArray, radius_m: float, clearance: Clearance) -> None:
    """Raise where the car can stand but neither drive off nor arrive, which it does forward only."""
    for name, pose, arriving, does in (
        ("start", ends[0], False, "drive off forward"),
        ("goal", ends[1], True, "arrive forward"),
    ):
        if is_dead_end(pose, radius_m, clearance, arriving=arriving):
            raise ScenarioError(
                f"no path: at its {name} ({pose[0]:g}, {pose[1]:g}) the car cannot {does} with a turning "
                f"radius of {radius_m:.3g} m; turn the {name} or give it more room"
            )
