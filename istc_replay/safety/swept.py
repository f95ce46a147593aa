"""When boxes that keep their velocities meet: the swept separating-axis test, in closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from istc_replay.datatypes import FloatArray
from istc_replay.safety.boxes import box_gap

#: Pairs worked on at once: few enough that the temporaries stay in the processor's cache.
_BLOCK = 16_384
#: A relative speed below this along an axis is none [m/s].
_STILL_MPS = 1e-12


def time_to_collision(first: ArrayLike, second: ArrayLike, velocity: ArrayLike) -> FloatArray:
    """Time until pairs of oriented boxes touch, their velocities and headings kept.

    Along each of the four axes of the separating-axis test, |p + v t| <= r holds over one interval
    of time. The boxes touch from the latest of the starts to the earliest of the ends, where that
    is an interval at all. Boxes are closed: grazing counts.

    Parameters
    ----------
    first, second : array_like
        (..., 5) boxes, broadcast to one shape: centre x, y [m], heading [rad], length, width [m].
    velocity : array_like
        (..., 2) velocity of the second box less that of the first [m/s].

    Returns
    -------
    ndarray
        (...) times [s]: 0 where the boxes overlap, inf where they never touch, NaN where a value
        is NaN or infinite.
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    v = np.asarray(velocity, dtype=np.float64)
    shape = np.broadcast_shapes(a.shape[:-1], b.shape[:-1], v.shape[:-1])
    a, b = (np.broadcast_to(box, (*shape, 5)).reshape(-1, 5) for box in (a, b))
    v = np.broadcast_to(v, (*shape, 2)).reshape(-1, 2)
    times = np.empty(a.shape[0])
    for start in range(0, times.size, _BLOCK):
        block = slice(start, start + _BLOCK)
        # Columns that lie apart in memory are what the arithmetic is fast on.
        times[block] = _block_times(*(np.ascontiguousarray(part[block].T) for part in (a, b, v)))
    return times.reshape(shape)


def pair_measures(
    first: ArrayLike, second: ArrayLike, velocity: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gap [m], time to collision [s] and DRAC [m/s^2] of pairs of boxes.

    The deceleration to avoid a crash is that of the relative motion, |v| / (2 TTC). In one lane
    TTC = gap / |v|, which makes it the familiar v^2 / (2 gap). It is 0 where no contact is ahead
    and inf where the boxes overlap.

    Parameters
    ----------
    first, second, velocity : array_like
        As of `time_to_collision`.

    Returns
    -------
    gap, ttc, drac : ndarray
        Each (...), NaN where a value is NaN or infinite.
    """
    gap, ttc = box_gap(first, second), time_to_collision(first, second, velocity)
    # The gap rounds less than the four intervals do: where it says contact, it is contact.
    ttc = np.where((gap <= 0.0) & ~np.isnan(ttc), 0.0, ttc)
    velocity = np.asarray(velocity, dtype=np.float64)
    speed = np.sqrt(velocity[..., 0] ** 2 + velocity[..., 1] ** 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        drac = np.where(ttc == 0.0, np.inf, speed / (2.0 * ttc))
    return gap, ttc, drac


def silhouette_overlap(first: ArrayLike, second: ArrayLike, velocity: ArrayLike) -> FloatArray:
    """How far two boxes overlap as seen along their relative velocity.

    Negative where they pass each other, by the distance in between; little where they would graze.

    Parameters
    ----------
    first, second, velocity : array_like
        As of `time_to_collision`.

    Returns
    -------
    ndarray
        (...) overlaps [m]; NaN where the relative velocity is 0.
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    v = np.asarray(velocity, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        across = np.stack([-v[..., 1], v[..., 0]], axis=-1) / np.hypot(v[..., 0], v[..., 1])[..., None]
    offset = np.abs(((b[..., :2] - a[..., :2]) * across).sum(axis=-1))
    return np.asarray(_half_extent(a, across) + _half_extent(b, across) - offset)


def _half_extent(box: FloatArray, direction: FloatArray) -> FloatArray:
    """Half of a box's extent along a unit vector."""
    c, s = np.cos(box[..., 2]), np.sin(box[..., 2])
    along = np.abs(c * direction[..., 0] + s * direction[..., 1])
    across = np.abs(c * direction[..., 1] - s * direction[..., 0])
    return np.asarray((box[..., 3] * along + box[..., 4] * across) / 2.0)


def _block_times(a: FloatArray, b: FloatArray, v: FloatArray) -> FloatArray:
    """Times of (5, n) boxes and (2, n) velocities."""
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        dx, dy = b[0] - a[0], b[1] - a[1]
        ca, sa, cb, sb = np.cos(a[2]), np.sin(a[2]), np.cos(b[2]), np.sin(b[2])
        c, s = np.abs(ca * cb + sa * sb), np.abs(ca * sb - sa * cb)
        half_a, half_b = a[3:] / 2.0, b[3:] / 2.0
        start, end = np.full(dx.shape, -np.inf), np.full(dx.shape, np.inf)
        for cosine, sine, half, other in ((ca, sa, half_a, half_b), (cb, sb, half_b, half_a)):
            axes = (
                (cosine, sine, half[0] + other[0] * c + other[1] * s),
                (-sine, cosine, half[1] + other[0] * s + other[1] * c),
            )
            for nx, ny, reach in axes:
                _narrow(start, end, nx * dx + ny * dy, nx * v[0] + ny * v[1], reach)
        times = np.where((start <= end) & (end >= 0.0), np.maximum(start, 0.0), np.inf)
        known = np.isfinite(a.sum(axis=0) + b.sum(axis=0) + v.sum(axis=0))
        return np.where(known, times, np.nan)


def _narrow(start: FloatArray, end: FloatArray, p: FloatArray, v: FloatArray, reach: FloatArray) -> None:
    """Narrow [start, end] to the times where |p + v t| <= reach."""
    still = np.abs(v) < _STILL_MPS
    middle = -p / v
    half = reach / np.abs(v)
    if still.any():
        # Standing still along an axis: within reach for ever, or never.
        middle = np.where(still, np.where(np.abs(p) <= reach, 0.0, np.inf), middle)
        half = np.where(still, np.where(np.abs(p) <= reach, np.inf, 0.0), half)
    np.maximum(start, middle - half, out=start)
    np.minimum(end, middle + half, out=end)
