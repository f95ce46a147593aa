"""One path past obstacles: along a taut line where one leads to it, else from hybrid A*."""

from __future__ import annotations

import heapq
import math
from dataclasses import replace

import numpy as np

from istc_replay.datatypes import FloatArray
from istc_replay.guidance.curves import Curve, Pose
from istc_replay.guidance.grid import DistanceGrid
from istc_replay.guidance.hybrid_astar import search
from istc_replay.guidance.links import Space
from istc_replay.guidance.shorten import arcs_of, shortest_chain
from istc_replay.guidance.tangents import Sharp, inner_ends, sharp_paths, with_ramps
from istc_replay.guidance.taut import Limits, pull_taut
from istc_replay.guidance.traffic import Traffic
from istc_replay.guidance.ways import ways_round

#: Sharp paths along taut lines pulled taut at most, and how far into obstacles they may lead.
_TRIES = 4
HOPELESS_M = 2.0
#: Turning radii of the search between the preferred one and the least.
_RADII_M = (5.0, 4.6)
#: The search asks for this much more room than the path needs: smoothing takes some.
_WIDER_M = 0.1
_DETOURS = 2
_COARSE_STEP_M = 0.5
_CHECK_STEP_M = 0.15
_TOLERANCE_M = 0.01
_PULLS, _BETWEEN_M = 2, 0.1
_LOOK_STEP_M = 3.0
_EVERY = 20  # poses of the check, 3 m
_ASIDE_M = 8.0  # obstacles farther aside of a path are left out
_OVER = 1.001  # of a limit


def along_taut_lines(ends: FloatArray, limits: Limits, traffic: Traffic | None) -> Curve | None:
    """Find the best path along a taut line past the obstacles.

    Sharp paths along the lines are pulled taut in the order of their lengths and what traffic adds,
    until none that is left is shorter than what was found.

    Parameters
    ----------
    ends : ndarray
        (2, 3) poses of the rear axle at start and goal [m, rad].
    limits : Limits
        What the path keeps to.
    traffic : Traffic, optional
        Other vehicles, avoided softly.

    Returns
    -------
    Curve or None
        The path; None where those tried do not keep to the limits.
    """
    start, goal = Pose(*ends[0]), Pose(*ends[1])
    ways = ways_round(ends[0, :2], ends[1, :2], limits.clearance)
    ramp_m = limits.curvature_1pm / limits.sharpness_1pm2
    paths = sharp_paths(ways, start, goal, 1.0 / limits.curvature_1pm, ramp_m)
    # By length until looked at, then by length and what traffic adds.
    queue: list[tuple[float, int, float | None]] = [(path.length_m, n, None) for n, path in enumerate(paths)]
    best: Curve | None = None
    least_m, tried = math.inf, 0
    while queue and queue[0][0] < least_m and tried < _TRIES:
        _, number, extra_m = heapq.heappop(queue)
        path = paths[number]
        if extra_m is None:
            poses = path.poses(_COARSE_STEP_M)
            if limits.clearance.lacks(poses).max() <= HOPELESS_M:
                extra_m = 0.0 if traffic is None else traffic.cost_m(poses[:, :2], _COARSE_STEP_M)
                heapq.heappush(queue, (path.length_m + extra_m, number, extra_m))
            continue
        tried += 1
        curve, _ = pulled_taut(path, goal, limits)
        if curve is not None and curve.length_m + extra_m < least_m:
            best, least_m = curve, curve.length_m + extra_m
    return best


def searched(
    ends: FloatArray, limits: Limits, grid: DistanceGrid | None, node_budget: int, known: Curve | None
) -> tuple[Curve | None, bool]:
    """Find a path by hybrid A*, shorter than a known one if there is.

    Returns
    -------
    tuple
        The path, and whether all there is was seen where none was found.
    """
    best, exhausted = known, True
    least_m = 1.0 / limits.curvature_1pm
    for radius_m in dict.fromkeys(
        (1.0 / limits.preferred_1pm, *(max(least_m, radius_m) for radius_m in _RADII_M), least_m)
    ):
        limit_m = math.inf if best is None else best.length_m
        curve, ended = _searched_at(radius_m, ends, limits, grid, node_budget, limit_m)
        exhausted &= ended
        if curve is not None and curve.length_m < limit_m:
            return curve, False
    return best, exhausted


def _searched_at(
    radius_m: float,
    ends: FloatArray,
    limits: Limits,
    grid: DistanceGrid | None,
    node_budget: int,
    limit_m: float,
) -> tuple[Curve | None, bool]:
    """What a search at one radius leads to."""
    start, goal = Pose(*ends[0]), Pose(*ends[1])
    space = Space(radius_m, limits.clearance)
    wide = space.widened(_WIDER_M)
    # Half a ramp of the steering lies before the first bend and after the last.
    ramp_m = 1.0 / (radius_m * limits.sharpness_1pm2)
    inner = np.stack([pose.as_array() for pose in inner_ends(start, goal, ramp_m)])
    if not space.clearance.free(inner).all():
        ramp_m, inner = 0.0, ends
    for _ in range(_DETOURS):
        found = search(inner[0], inner[1], wide, grid, node_budget, limit_m - ramp_m)
        if found.poses is None:
            return None, found.exhausted
        chain = shortest_chain(found.poses, inner[1], space)
        if chain is None:
            break
        path = with_ramps(start, *arcs_of(chain, space), ramp_m)
        curve, worst = pulled_taut(path, goal, limits)
        if curve is not None:
            return curve, False
        if worst is None:
            break
        # The sharp path is free but cannot be steered here: the next one must pass elsewhere.
        wide = replace(wide, clearance=wide.clearance.closed_at(worst))
    return None, False


def pulled_taut(path: Sharp, goal: Pose, limits: Limits) -> tuple[Curve | None, FloatArray | None]:
    """A path pulled taut if it can be driven; else the pose (3,) where it comes too near, if that is why."""
    nearby = limits.clearance.near(path.poses(_LOOK_STEP_M), _ASIDE_M)
    worst = None
    for _ in range(_PULLS):
        curve = pull_taut(path, goal, replace(limits, clearance=nearby))
        if curve is None or not _is_steerable(curve, limits):
            break
        poses = curve.spaced_poses(_CHECK_STEP_M)
        lacks = limits.clearance.near(poses[::_EVERY], _ASIDE_M).lacks(poses)
        lack, worst = float(lacks.max()), poses[int(np.argmax(lacks))]
        if lack <= _TOLERANCE_M:
            return curve, None
        if lack > _BETWEEN_M:
            break
        # Something came nearer between the poses that were looked at: once more with that to spare.
        nearby = nearby.widened(lack)
    return None, worst


def _is_steerable(curve: Curve, limits: Limits) -> bool:
    return bool(
        np.abs(curve.curvatures_1pm).max() <= _OVER * limits.curvature_1pm
        and np.abs(curve.sharpness(curve.breaks_m)).max() <= _OVER * limits.sharpness_1pm2
    )
