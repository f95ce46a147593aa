"""Which pairs can matter at all: sort and sweep over the hulls of what boxes may reach."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray
from istc_replay.errors import LogError

IntArray = NDArray[np.int64]

_MOST_PAIRS = 10_000_000


def reach_hulls(
    boxes: FloatArray, velocities: FloatArray, reach_s: float, least_m: FloatArray, near_m: float
) -> tuple[FloatArray, FloatArray]:
    """Axis-aligned hulls of boxes and of all they reach while they keep their velocities.

    Two boxes that touch within `reach_s`, or that are within `near_m` of each other now, have
    hulls that overlap.

    Parameters
    ----------
    boxes : ndarray
        (n, 5) boxes.
    velocities : ndarray
        (n, 2) velocities [m/s].
    reach_s : float
        How far ahead.
    least_m : ndarray
        (n,) the way ahead is no shorter than this.
    near_m : float
        Distance in which boxes are near.

    Returns
    -------
    low, high : ndarray
        (n, 2) corners [m]; NaN where a value is.
    """
    c, s = np.abs(np.cos(boxes[:, 2])), np.abs(np.sin(boxes[:, 2]))
    half = np.stack([boxes[:, 3] * c + boxes[:, 4] * s, boxes[:, 3] * s + boxes[:, 4] * c], axis=-1) / 2.0
    speed = np.hypot(velocities[:, 0], velocities[:, 1])
    way = np.maximum(speed * reach_s, least_m)
    ahead = velocities / np.maximum(speed, 1e-12)[:, None] * way[:, None]
    half = half + near_m / 2.0
    centres = boxes[:, :2]
    return np.minimum(centres, centres + ahead) - half, np.maximum(centres, centres + ahead) + half


def overlapping_pairs(low: FloatArray, high: FloatArray, groups: IntArray) -> tuple[IntArray, IntArray]:
    """Pairs of axis-aligned boxes of one group that overlap or touch.

    Sorted by their low ends, each box is compared with the next one, the one after, and so on,
    until the next begins behind its end: the work is that of the overlaps along one axis.

    Parameters
    ----------
    low, high : ndarray
        (n, 2) corners; boxes with a NaN are in no pair.
    groups : ndarray
        (n,) group of each box.

    Returns
    -------
    first, second : ndarray
        Rows, first < second, in order.

    Raises
    ------
    LogError
        If there are too many for the memory.
    """
    known = np.flatnonzero(np.isfinite(low.sum(axis=1) + high.sum(axis=1)))
    if known.size < 2:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    # Along the axis on which boxes are short beside what they are spread over.
    spread = (high[known].max(axis=0) - low[known].min(axis=0)) / (high - low)[known].mean(axis=0)
    axis = int(np.argmax(spread))
    order = known[np.lexsort((low[known, axis], groups[known]))]
    begin, end, other_low, other_high = (
        low[order, axis],
        high[order, axis],
        low[order, 1 - axis],
        high[order, 1 - axis],
    )
    group = groups[order]
    alive = np.arange(order.size)
    firsts, seconds, count = [], [], 0
    for step in range(1, order.size):
        alive = alive[alive + step < order.size]
        later = alive + step
        open_ = (group[later] == group[alive]) & (begin[later] <= end[alive])
        alive, later = alive[open_], later[open_]
        if alive.size == 0:
            break
        met = (other_low[later] <= other_high[alive]) & (other_low[alive] <= other_high[later])
        count += int(met.sum())
        if count > _MOST_PAIRS:
            raise LogError(
                f"more than {_MOST_PAIRS} pairs of bodies are near each other at once; "
                "audit fewer vehicles, or with smaller audit.horizon_s and audit.near_m"
            )
        firsts.append(order[alive[met]])
        seconds.append(order[later[met]])
    one = np.concatenate(firsts) if firsts else np.empty(0, dtype=np.int64)
    two = np.concatenate(seconds) if seconds else np.empty(0, dtype=np.int64)
    first, second = np.minimum(one, two), np.maximum(one, two)
    sorting = np.lexsort((second, first))
    return first[sorting], second[sorting]
