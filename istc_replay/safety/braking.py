"""The braking that would have avoided contact, in closed form.

A vehicle that brakes along its own course is at distance s from where it was, and the other
vehicle keeps its velocity. Each axis of the separating-axis test then says that the boxes touch
between two parallel lines of the (t, s) plane, so all contacts together fill a convex polygon.
To pass through (t, s) the vehicle brakes by

    a(t, s) = 2 (v t - s) / t^2  while it moves (s >= v t / 2),  else  v^2 / (2 s).

More braking is less way at all times, so the braking that leads to contact is an interval, and
where no braking leads to contact its upper end is what is required: the largest a(t, s) of the
polygon. Points of equal braking form a concave curve: the largest lies in a corner of the
polygon, or where an edge s = c + m t touches a curve, at t = 2 c / (v - m).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from istc_replay.datatypes import FloatArray

_BLOCK = 8_192
#: Rounding allowed to a point of the polygon [m].
_SLACK_M = 1e-9
_PARALLEL = 1e-12


def required_deceleration(
    first: ArrayLike, second: ArrayLike, own: ArrayLike, other: ArrayLike
) -> FloatArray:
    """The smallest constant braking of the first vehicle, to a stop at most, that avoids contact.

    Parameters
    ----------
    first, second : array_like
        (n, 5) boxes: centre x, y [m], heading [rad], length, width [m].
    own, other : array_like
        (n, 2) velocities of the first and of the second vehicle [m/s]; the second keeps its own,
        the first brakes along its own.

    Returns
    -------
    ndarray
        (n,) decelerations [m/s^2]: 0 where no contact is ahead, inf where no braking avoids it,
        NaN where a value is NaN or infinite.
    """
    parts = [np.asarray(part, dtype=np.float64) for part in (first, second, own, other)]
    found = np.empty(parts[0].shape[0])
    for start in range(0, found.size, _BLOCK):
        block = slice(start, start + _BLOCK)
        found[block] = _block(*(part[block] for part in parts))
    return found


def _block(a: FloatArray, b: FloatArray, own: FloatArray, other: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        speed = np.hypot(own[:, 0], own[:, 1])
        moving = speed > 0.0
        course = np.where(moving[:, None], own / np.where(moving, speed, 1.0)[:, None], [1.0, 0.0])
        planes = _half_planes(a, b, course, other)
        t, s = _candidates(planes, speed)
        inside = np.ones(t.shape, dtype=bool)
        for on_t, on_s, most in np.moveaxis(planes, 1, 0):
            inside &= on_t[:, None] * t + on_s[:, None] * s <= most[:, None] + _SLACK_M
        v = speed[:, None]
        # What is met without moving at all, no braking avoids.
        stopped = np.where(s > _SLACK_M, v**2 / (2.0 * s), np.inf)
        needed = np.where(s >= v * t / 2.0, 2.0 * (v * t - s) / t**2, stopped)
        largest = np.max(np.where(inside & np.isfinite(t), needed, 0.0), axis=1, initial=0.0)
        hit = _hits_unbraked(planes, speed)
        known = np.isfinite(a.sum(axis=1) + b.sum(axis=1) + own.sum(axis=1) + other.sum(axis=1))
        return np.where(known, np.where(hit, np.where(moving, largest, np.inf), 0.0), np.nan)


def _half_planes(a: FloatArray, b: FloatArray, course: FloatArray, other: FloatArray) -> FloatArray:
    """(3, 10, n): the rows f t + g s <= h of four axes, both sides, and of t >= 0, s >= 0."""
    offset = b[:, :2] - a[:, :2]
    angles = np.stack([a[:, 2], a[:, 2] + np.pi / 2, b[:, 2], b[:, 2] + np.pi / 2])
    axes = np.stack([np.cos(angles), np.sin(angles)], axis=-1)  # (4, n, 2)
    reach = np.zeros(angles.shape)
    for box in (a, b):
        along = np.abs(np.cos(angles - box[:, 2]))
        across = np.abs(np.sin(angles - box[:, 2]))
        reach += (box[:, 3] * along + box[:, 4] * across) / 2.0
    # |n . (offset + other t - course s)| <= reach
    p, f, g = ((axes * vector).sum(axis=-1) for vector in (offset, other, -course))
    zero = np.zeros((1, a.shape[0]))
    return np.stack(
        [
            np.concatenate([f, -f, zero - 1.0, zero]),
            np.concatenate([g, -g, zero, zero - 1.0]),
            np.concatenate([reach - p, reach + p, zero, zero]),
        ]
    )


def _candidates(planes: FloatArray, speed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, m) points t, s: where two lines cross, and where a line touches a curve of equal braking."""
    f, g, h = planes
    i, j = np.triu_indices(f.shape[0], 1)
    cross = f[i] * g[j] - f[j] * g[i]
    cross = np.where(np.abs(cross) > _PARALLEL, cross, np.nan)
    t, s = (h[i] * g[j] - h[j] * g[i]) / cross, (f[i] * h[j] - f[j] * h[i]) / cross
    steep = np.where(np.abs(g) > _PARALLEL, g, np.nan)
    c, m = h / steep, -f / steep
    touch = 2.0 * c / (speed - m)
    t, s = np.concatenate([t, touch]), np.concatenate([s, c + m * touch])
    return np.where(t > 0.0, t, np.nan).T, s.T


def _hits_unbraked(planes: FloatArray, speed: FloatArray) -> FloatArray:
    """Whether the line s = v t meets the polygon."""
    f, g, h = planes
    slope = f + g * speed
    level = np.abs(slope) <= _PARALLEL
    bound = h / np.where(level, np.nan, slope)
    latest = np.min(np.where(~level & (slope > 0.0), bound, np.inf), axis=0)
    earliest = np.max(np.where(~level & (slope < 0.0), bound, -np.inf), axis=0)
    return np.asarray((earliest <= latest) & ~(level & (h < 0.0)).any(axis=0))
