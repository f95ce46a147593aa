"""Frames and oriented boxes: pure functions on arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from istc_replay.datatypes import FloatArray, Frame

#: Corners of a unit box in the order front left, front right, rear right, rear left.
_CORNER_SIGNS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]]) / 2.0


def to_frame(points_m: ArrayLike, frame: Frame) -> FloatArray:
    """Turn map-frame points (..., 2) into the corridor frame [m]."""
    points = np.asarray(points_m, dtype=np.float64) - (frame.x_m, frame.y_m)
    return rotate(points, -frame.yaw_rad)


def to_map(points_m: ArrayLike, frame: Frame) -> FloatArray:
    """Turn corridor-frame points (..., 2) into the map frame [m]."""
    return rotate(points_m, frame.yaw_rad) + (frame.x_m, frame.y_m)


def rotate(points_m: ArrayLike, angle_rad: float) -> FloatArray:
    """Rotate points (..., 2) counter-clockwise about the origin."""
    points = np.asarray(points_m, dtype=np.float64)
    if angle_rad == 0.0:
        return points.copy()
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y = points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def box_corners(
    x_m: ArrayLike, y_m: ArrayLike, heading_rad: ArrayLike, length_m: ArrayLike, width_m: ArrayLike
) -> FloatArray:
    """Corners of oriented boxes about their centres.

    Parameters
    ----------
    x_m, y_m, heading_rad, length_m, width_m : array_like
        Centres [m], headings [rad] and sizes [m], broadcast to one shape (...).

    Returns
    -------
    ndarray
        (..., 4, 2) corners [m]: front left, front right, rear right, rear left.
    """
    x, y, heading, length, width = np.broadcast_arrays(x_m, y_m, heading_rad, length_m, width_m)
    along = _CORNER_SIGNS[:, 0] * np.asarray(length, dtype=np.float64)[..., None]
    across = _CORNER_SIGNS[:, 1] * np.asarray(width, dtype=np.float64)[..., None]
    c, s = np.cos(heading)[..., None], np.sin(heading)[..., None]
    return np.stack([x[..., None] + c * along - s * across, y[..., None] + s * along + c * across], axis=-1)


def box_poses(states: ArrayLike, rear_axle_to_centre_m: float) -> FloatArray:
    """Box centres and headings of a vehicle.

    Parameters
    ----------
    states : array_like
        (..., 3 or more): x, y, heading of the rear axle, whatever follows [m, m, rad].
    rear_axle_to_centre_m : float
        Distance from the rear axle forward to the box centre [m].

    Returns
    -------
    ndarray
        (..., 3): x, y of the box centre, and the heading as it is [m, m, rad].
    """
    x, y, heading = np.moveaxis(np.asarray(states, dtype=np.float64)[..., :3], -1, 0)
    return np.concatenate([shift_along(x, y, heading, rear_axle_to_centre_m), heading[..., None]], axis=-1)


def shift_along(x_m: ArrayLike, y_m: ArrayLike, heading_rad: ArrayLike, distance_m: ArrayLike) -> FloatArray:
    """Move points by a distance along their headings; (..., 2).

    From the rear axle to the box centre: `distance_m = rear_axle_to_centre_m`; back: its negative.
    """
    heading = np.asarray(heading_rad, dtype=np.float64)
    distance = np.asarray(distance_m, dtype=np.float64)
    return np.stack(
        [np.asarray(x_m) + distance * np.cos(heading), np.asarray(y_m) + distance * np.sin(heading)], axis=-1
    )
