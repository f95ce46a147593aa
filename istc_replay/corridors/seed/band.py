"""Drawing a path clear: the shortest smooth one beside it whose car-boxes miss the obstacles' boxes."""

from __future__ import annotations

import daqp
import numpy as np

from istc_replay.corridors.blocks import car_box_m
from istc_replay.datatypes import Dimensions, FloatArray
from istc_replay.geometry import shift_along

_STEP_M = 1.0
_ROUNDS = 3
_ASIDE_M = 6.0  # most that a round moves a point
_NEAR_M = 4.0  # obstacles farther than this from every car-box are left out
_SLACK_RAD = 0.05
_CURVATURE_1PM = 0.17
_DAMPING, _BENDING, _MISS = 0.02, 20.0, 500.0
_ALONG = 0.2  # a side of the map is kept where the path runs this much along it
_PIECES = 4
_DONE_M = 0.05


def drawn_clear(
    poses: FloatArray,
    car: Dimensions,
    boxes_m: FloatArray,
    bounds_m: tuple[float, float, float, float] | None,
    room_m: float,
) -> FloatArray:
    """Move a path (S, 3) sideways until its axis-aligned car-boxes keep room [m] from boxes (O, 4).

    Each round finds offsets along the normals by a convex QP: least length and bending, within
    what the obstacles leave on the path's own side of each. What they do not leave is violated as
    little as possible.
    """
    for _ in range(_ROUNDS):
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
        s = np.linspace(0.0, arc[-1], max(8, int(np.ceil(arc[-1] / _STEP_M))) + 1)
        x, y, heading = (np.interp(s, arc, poses[:, axis]) for axis in range(3))
        normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        half = car_box_m(heading, _SLACK_RAD, car.length_m, car.width_m) / 2.0
        points = np.stack([x, y], axis=-1)
        centres = shift_along(x, y, heading, car.rear_axle_to_centre_m)
        low, high = _room(centres, normal, half, boxes_m, bounds_m, room_m)
        offsets = _offsets(low, high, np.gradient(heading, s), float(s[1]))
        poses = _spline(points + offsets[:, None] * normal, poses[0, 2], poses[-1, 2])
        if np.abs(offsets).max() < _DONE_M:
            break
    return poses


def _room(
    points: FloatArray,
    normal: FloatArray,
    half: FloatArray,
    boxes_m: FloatArray,
    bounds_m: tuple[float, float, float, float] | None,
    room_m: float,
) -> tuple[FloatArray, FloatArray]:
    """Least and largest offset (S,) along the normals (S, 2) that obstacles and the map leave."""
    low, high = np.full(len(points), -_ASIDE_M), np.full(len(points), _ASIDE_M)
    steep = np.where(np.abs(normal) < 1e-9, 1e-9, normal)
    for x_min, x_max, y_min, y_max in boxes_m:
        away = points - ((x_min + x_max) / 2.0, (y_min + y_max) / 2.0)
        reach = half + np.array([x_max - x_min, y_max - y_min]) / 2.0 + room_m
        apart = (np.abs(away) - reach).max(axis=1)
        nearest = int(np.argmin(apart))
        if apart[nearest] > _NEAR_M:
            continue
        ends = np.sort(np.stack([(-reach - away) / steep, (reach - away) / steep]), axis=0)
        first, last = ends[0].max(axis=1), ends[1].min(axis=1)  # inside the grown box between these
        crosses = (first < last) & (first < _ASIDE_M) & (last > -_ASIDE_M)
        if away[nearest] @ normal[nearest] >= 0.0:
            low = np.where(crosses, np.maximum(low, np.minimum(last, _ASIDE_M)), low)
        else:
            high = np.where(crosses, np.minimum(high, np.maximum(first, -_ASIDE_M)), high)
    if bounds_m is not None:
        for side, wall in enumerate(bounds_m):
            sign, axis = (1.0, -1.0)[side % 2], side // 2
            slope = sign * normal[:, axis]
            left = half[:, axis] - sign * (points[:, axis] - wall)
            least = left / np.where(np.abs(slope) > _ALONG, slope, np.inf)
            low = np.where(slope > _ALONG, np.maximum(low, least), low)
            high = np.where(slope < -_ALONG, np.minimum(high, least), high)
    return low, high


def _offsets(low: FloatArray, high: FloatArray, bend: FloatArray, step_m: float) -> FloatArray:
    """Offsets (S,) of least length and bending between soft bounds; none at both ends."""
    count = len(low)
    first = np.diff(np.eye(count), axis=0) / step_m
    second = np.diff(first, axis=0) / step_m
    hessian = np.zeros((count + 1, count + 1))
    hessian[:count, :count] = step_m * (
        _DAMPING * np.eye(count) + first.T @ first + _BENDING * second.T @ second
    )
    hessian[count, count] = 1e-3
    # To first order an offset towards the inside of a bend shortens the path.
    cost = np.append(-bend * step_m, _MISS)
    ones, none = np.ones((count, 1)), np.zeros((count - 2, 1))
    rows = np.vstack(
        [np.hstack([np.eye(count), ones]), np.hstack([np.eye(count), -ones]), np.hstack([second, none])]
    )
    ends = [0, 1, -2, -1]
    low[ends] = high[ends] = 0.0
    free = np.full(count, 1e30)
    kept = np.clip(bend[1:-1], -_CURVATURE_1PM, _CURVATURE_1PM)
    lower = np.concatenate([-free, [0.0], low, -free, -_CURVATURE_1PM - kept])
    upper = np.concatenate([free, [1e3], free, high, _CURVATURE_1PM - kept])
    solution, _, flag, _ = daqp.solve(hessian, cost, np.ascontiguousarray(rows), upper, lower)
    return np.asarray(solution[:count]) if flag > 0 else np.zeros(count)


def _spline(points: FloatArray, first_rad: float, last_rad: float) -> FloatArray:
    """Poses along the cubic spline through points (S, 2) with these headings at its ends."""
    count = len(points)
    chord = np.maximum(np.hypot(*np.diff(points, axis=0).T), 1e-9)
    inverse, inner = 1.0 / chord, np.arange(1, count - 1)
    matrix = np.zeros((count, count))
    matrix[0, 0] = matrix[-1, -1] = 1.0
    matrix[inner, inner - 1], matrix[inner, inner + 1] = inverse[:-1], inverse[1:]
    matrix[inner, inner] = 2.0 * (inverse[:-1] + inverse[1:])
    right = np.empty((count, 2))
    right[0], right[-1] = ((np.cos(a), np.sin(a)) for a in (first_rad, last_rad))
    slope = np.diff(points, axis=0) * inverse[:, None] ** 2
    right[1:-1] = 3.0 * (slope[:-1] + slope[1:])
    tangents = np.linalg.solve(matrix, right)
    a, b = points[:-1, None], points[1:, None]
    u, v = tangents[:-1, None] * chord[:, None, None], tangents[1:, None] * chord[:, None, None]
    t = (np.arange(_PIECES) / _PIECES)[None, :, None]
    at = (2 * t**3 - 3 * t**2 + 1) * (a - b) + b + (t**3 - 2 * t**2 + t) * u + (t**3 - t**2) * v
    along = (6 * t**2 - 6 * t) * (a - b) + (3 * t**2 - 4 * t + 1) * u + (3 * t**2 - 2 * t) * v
    at = np.vstack([at.reshape(-1, 2), points[-1:]])
    along = np.vstack([along.reshape(-1, 2), tangents[-1:]])
    return np.column_stack([at, np.unwrap(np.arctan2(along[:, 1], along[:, 0]))])
