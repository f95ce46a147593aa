"""Other routes of a vehicle of a crowded scene: about other corners, and farther off the obstacles."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.datatypes import Dimensions, FloatArray, MapBounds, SceneObstacle, read_only
from istc_replay.geometry import shift_along
from istc_replay.guidance.clearance import Clearance
from istc_replay.guidance.curves import Pose
from istc_replay.guidance.path_search import HOPELESS_M, pulled_taut
from istc_replay.guidance.tangents import sharp_paths
from istc_replay.guidance.taut import Limits
from istc_replay.guidance.ways import ways_round

if TYPE_CHECKING:
    from istc_replay.datatypes import Scenario

#: Room that others find near the obstacles, and with it to spare.
_MARGINS_M = (0.5, 1.2)
_SLACK_RAD = 0.1
#: Sharp paths pulled taut at each margin, and how much longer than the guidance's they may be.
_TRIES, _LONGER = 4, 1.2
#: Wide bends: a car-box needs little slack in them, so that layer 2 can follow.
_LEAST_RADIUS_M, _RADIUS_M = 5.0, 7.0
#: Change of curvature per metre, times the wheelbase.
_SHARPNESS = 0.135
_STEP_M, _COARSE_STEP_M = 0.25, 0.5
#: Routes whose points, so many, lie no farther apart are one.
_POINTS, _ALIKE_M = 12, 0.3
#: A map without bounds, and who drives less has no other way [m].
_ENDLESS_M, _STAYS_M = 1e3, 1.0


def standing_obstacles(scenario: Scenario) -> list[SceneObstacle]:
    """Boxes of what stands throughout, as corridors know them."""
    boxes = [o.boxes_m[0] for o in scenario.obstacles if (o.boxes_m == o.boxes_m[0]).all()]
    return [
        SceneObstacle(
            obstacle_id=str(number),
            x_m=float(x_min + x_max) / 2.0,
            y_m=float(y_min + y_max) / 2.0,
            heading_rad=0.0,
            length_m=float(x_max - x_min),
            width_m=float(y_max - y_min),
        )
        for number, (x_min, x_max, y_min, y_max) in enumerate(boxes)
    ]


def other_routes(
    poses: FloatArray,
    car: Dimensions,
    bounds_m: tuple[float, float, float, float] | None,
    obstacles: list[SceneObstacle],
) -> tuple[FloatArray, ...]:
    """Find smooth routes between the ends of a guidance, the shortest past other corners.

    Parameters
    ----------
    poses : (S, 3) array
        The guidance's, box centre [m, rad].
    car : Dimensions
        The vehicle's box.
    bounds_m : tuple, optional
        x_min, x_max, y_min, y_max of the map.
    obstacles : list of SceneObstacle
        What stands.

    Returns
    -------
    tuple of (S, 3) arrays
        Poses of the rear axle about 0.25 m apart [m, rad]; none for who hardly moves.
    """
    length_m = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    if length_m < _STAYS_M:
        return ()
    x, y, heading = poses[[0, -1]].T
    ends = np.column_stack([shift_along(x, y, heading, -car.rear_axle_to_centre_m), heading])
    far = (-_ENDLESS_M, _ENDLESS_M) * 2
    bounds = MapBounds(*(bounds_m or far))
    found: list[FloatArray] = []
    for margin_m in _MARGINS_M:
        clearance = Clearance.of(car, bounds, obstacles, margin_m, _SLACK_RAD).eased_at(ends)
        for route in _routes(ends, car, clearance, _LONGER * length_m):
            if not any(_alike(route, other) for other in found):
                found.append(route)
    return tuple(read_only(route) for route in found)


def _routes(
    ends: FloatArray, car: Dimensions, clearance: Clearance, longest_m: float
) -> Iterator[FloatArray]:
    """Routes (S, 3) of the rear axle at one clearance, at most as long."""
    start, goal = Pose(*ends[0]), Pose(*ends[1])
    limits = Limits(1.0 / _LEAST_RADIUS_M, 1.0 / _RADIUS_M, _SHARPNESS / car.wheelbase_m, clearance)
    ramp_m = limits.curvature_1pm / limits.sharpness_1pm2
    ways = ways_round(ends[0, :2], ends[1, :2], clearance)
    hopeful = (
        sharp
        for sharp in sharp_paths(ways, start, goal, _LEAST_RADIUS_M, ramp_m)
        if sharp.length_m <= longest_m and clearance.lacks(sharp.poses(_COARSE_STEP_M)).max() <= HOPELESS_M
    )
    for sharp in itertools.islice(hopeful, _TRIES):
        curve, _ = pulled_taut(sharp, goal, limits)
        if curve is not None:
            route = np.array(curve.spaced_poses(_STEP_M))
            route[:, 2] = np.unwrap(route[:, 2])
            yield route


def _alike(one: FloatArray, other: FloatArray) -> bool:
    """Whether two routes (S, 3) run nearly the same."""
    first, second = (
        route[np.linspace(0, len(route) - 1, _POINTS).round().astype(int), :2] for route in (one, other)
    )
    return bool(np.abs(first - second).max() < _ALIKE_M)
