"""A path for one vehicle past the obstacles of its map: the shortest that Dubins words offer."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from istc_replay.datatypes import Dimensions, FloatArray, read_only
from istc_replay.geometry import box_corners
from istc_replay.guidance.curves import Curve, Pose, smooth_curve, smooth_to_goal
from istc_replay.guidance.dubins import Word, dubins_words
from istc_replay.samples.drive import box_centres
from istc_replay.samples.sceneform import Box

#: Turning radii in the order of trying; the first is comfortable at 5 m/s.
_RADII_M = (6.0, 7.0, 8.0, 5.0)
_RAMP_M = 4.0
_CHECK_STEP_M = 0.2
_CLEARANCE_M = 0.3
_VIA_DISTANCE_M = 0.7  # beyond half the width: between a via point's box and its obstacle
_VIA_HEADINGS = 8
_OBSTACLES_PASSED = 4
_SHARP_RAMP_M = 0.01
_SMOOTHING_MOVES_M = 0.9


def find_route(
    start: Pose, goal: Pose, car: Dimensions, least_radius_m: float, bounds: Box, obstacles: Sequence[Box]
) -> Curve | None:
    """Find a path of continuous curvature from start to goal, or None where none is found.

    By turning radius, the shortest Dubins word that keeps the box within the bounds and 0.3 m
    clear of the obstacles; else the shortest through one point beside one of four obstacles,
    those in the way first.

    Parameters
    ----------
    start, goal : Pose
        Poses of the rear axle [m, rad].
    car : Dimensions
        The vehicle's box.
    least_radius_m : float
        Radii below are not tried, this one comes last [m].
    bounds, obstacles : Box, sequence of Box
        What the box must stay in, and clear of.
    """
    radii = [radius for radius in _RADII_M if radius > least_radius_m] + [least_radius_m]
    in_the_way_first: dict[Box, None] = {}
    for radius in radii:
        for curve in _direct(start, goal, radius):
            in_the_way = obstacles_on(curve, car, obstacles)
            if not in_the_way and stays_within(curve, car, bounds):
                return curve
            in_the_way_first |= dict.fromkeys(in_the_way)
    beside = list(in_the_way_first | dict.fromkeys(obstacles))[:_OBSTACLES_PASSED]
    vias = list(_via_poses(start, goal, car, beside))
    for radius in radii:
        for via, before, after in _words_through(start, goal, radius, vias):
            # Most are ruled out unsmoothed, which is much cheaper; smoothing hardly moves them further.
            rough = _joined(_sharp(before, start), _sharp(after, via))
            if obstacles_on(rough, car, obstacles, -_SMOOTHING_MOVES_M):
                continue
            first, second = _smoothed(before, start, via), _smoothed(after, via, goal)
            if first is None or second is None:
                continue
            curve = _joined(first, second)
            if stays_within(curve, car, bounds) and not obstacles_on(curve, car, obstacles):
                return curve
    return None


def stays_within(curve: Curve, car: Dimensions, bounds: Box) -> bool:
    """Tell whether the box stays within the bounds all along the path."""
    _, corners = _swept(curve, car)
    low, high = (bounds.x_min_m, bounds.y_min_m), (bounds.x_max_m, bounds.y_max_m)
    return bool(((corners >= low) & (corners <= high)).all())


def obstacles_on(
    curve: Curve, car: Dimensions, obstacles: Sequence[Box], clearance_m: float = _CLEARANCE_M
) -> list[Box]:
    """Return the obstacles that the box comes nearer to than the clearance on the path [m]."""
    poses, corners = _swept(curve, car)
    return [box for box in obstacles if _touches(poses, corners, car, box, clearance_m)]


def _swept(curve: Curve, car: Dimensions) -> tuple[FloatArray, FloatArray]:
    """Poses (S, 3) of the box centre along the path, and the corners (S, 4, 2) there."""
    along = np.linspace(0.0, curve.length_m, math.ceil(curve.length_m / _CHECK_STEP_M) + 1)
    poses = curve.poses(along)
    poses[:, :2] = box_centres(poses, car)
    return poses, box_corners(poses[:, 0], poses[:, 1], poses[:, 2], car.length_m, car.width_m)


def _touches(poses: FloatArray, corners: FloatArray, car: Dimensions, box: Box, clearance_m: float) -> bool:
    """Whether no axis separates the boxes: neither one of the map's, nor one of the car's."""
    least = np.array([box.x_min_m, box.y_min_m]) - clearance_m
    most = np.array([box.x_max_m, box.y_max_m]) + clearance_m
    near = ((corners.max(axis=1) > least) & (corners.min(axis=1) < most)).all(axis=1)
    if not near.any():
        return False
    outline = itertools.product((box.x_min_m, box.x_max_m), (box.y_min_m, box.y_max_m))
    offsets = np.array(list(outline)) - poses[near, None, :2]  # (near, 4, 2)
    c, s = np.cos(poses[near, 2])[:, None], np.sin(poses[near, 2])[:, None]
    along, across = c * offsets[..., 0] + s * offsets[..., 1], c * offsets[..., 1] - s * offsets[..., 0]
    half_length, half_width = car.length_m / 2.0 + clearance_m, car.width_m / 2.0 + clearance_m
    beside = (along.min(axis=1) > half_length) | (along.max(axis=1) < -half_length)
    beside |= (across.min(axis=1) > half_width) | (across.max(axis=1) < -half_width)
    return not beside.all()


def _direct(start: Pose, goal: Pose, radius_m: float) -> Iterator[Curve]:
    """The smoothed words, shortest first."""
    for word in dubins_words(start, goal, radius_m):
        curve = _smoothed(word, start, goal)
        if curve is not None:
            yield curve


def _words_through(
    start: Pose, goal: Pose, radius_m: float, vias: Iterable[Pose]
) -> list[tuple[Pose, Word, Word]]:
    """The shortest words to and from each of the poses, the shortest sum first."""
    pairs = [
        (via, dubins_words(start, via, radius_m)[0], dubins_words(via, goal, radius_m)[0]) for via in vias
    ]
    return sorted(pairs, key=lambda pair: pair[1].length_m + pair[2].length_m)


def _sharp(word: Word, start: Pose) -> Curve:
    return smooth_curve(start, word.lengths_m, word.curvatures_1pm, _SHARP_RAMP_M)


def _smoothed(word: Word, start: Pose, goal: Pose) -> Curve | None:
    """Smooth the word so that the steering turns no faster than at a change from straight to an arc."""
    for ramp_m in (_RAMP_M, 2.0 * _RAMP_M):
        curve = smooth_to_goal(start, goal, word.lengths_m, word.curvatures_1pm, ramp_m)
        sharpest = 1.0 / (word.radius_m * _RAMP_M)
        if curve is not None and np.abs(curve.sharpness(curve.breaks_m)).max() < 1.001 * sharpest:
            return curve
    return None


def _via_poses(start: Pose, goal: Pose, car: Dimensions, obstacles: Sequence[Box]) -> Iterator[Pose]:
    """Poses of the rear axle around each obstacle that head for the goal, more or less."""
    bearing = math.atan2(goal.y_m - start.y_m, goal.x_m - start.x_m)
    away_m = car.width_m / 2.0 + _VIA_DISTANCE_M
    for box in obstacles:
        middle = ((box.x_min_m + box.x_max_m) / 2.0, (box.y_min_m + box.y_max_m) / 2.0)
        reach = ((box.x_max_m - box.x_min_m) / 2.0 + away_m, (box.y_max_m - box.y_min_m) / 2.0 + away_m)
        for east, north, eighth in itertools.product((-1, 0, 1), (-1, 0, 1), range(_VIA_HEADINGS)):
            heading = 2.0 * math.pi * eighth / _VIA_HEADINGS
            if (east, north) == (0, 0) or math.cos(heading - bearing) < 0.0:
                continue
            ahead = car.rear_axle_to_centre_m
            yield Pose(
                middle[0] + east * reach[0] - ahead * math.cos(heading),
                middle[1] + north * reach[1] - ahead * math.sin(heading),
                heading,
            )


def _joined(first: Curve, second: Curve) -> Curve:
    """Both curves as one; their curvature is zero where they meet."""
    breaks = np.concatenate([first.breaks_m, first.length_m + second.breaks_m[1:]])
    return Curve(
        first.start, read_only(breaks), read_only([*first.curvatures_1pm, *second.curvatures_1pm[1:]])
    )
