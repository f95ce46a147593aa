"""Post-encroachment time: who was where another came to be, and how long before.

One vehicle's footprint at t_a and another's at t_b overlap: the place was left and taken within
|t_b - t_a|. No zone is drawn, as in SSAM. Footprints are those at the common times, so a time is
known to one step either way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.broad_phase import overlapping_pairs
from istc_replay.safety.relation import conflict_angle

IntArray = NDArray[np.int64]

#: Candidate pairs of footprints looked at in one go.
_BLOCK = 1_000_000
#: Times are differences of what was counted from another start.
_ROUNDING_S = 1e-9


def encroachments(
    boxes: FloatArray, times_s: FloatArray, *, longest_s: float, least_angle_rad: float, block_s: float = 1.0
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """For each footprint, the nearest later one of each other vehicle that overlaps it.

    Parameters
    ----------
    boxes : ndarray
        (T, V, 5) footprints, their headings turned to the courses; NaN where absent.
    times_s : ndarray
        (T,) increasing.
    longest_s : float
        Longer times are none.
    least_angle_rad : float
        Footprints whose courses differ by less follow each other: there headway is the measure.
    block_s : float
        Footprints are first looked at in blocks of this length.

    Returns
    -------
    earlier, later : ndarray
        Rows of `times_s`, earlier <= later; both in one instant is contact.
    first, second : ndarray
        Vehicle there first, and vehicle there second; sorted by first, second, earlier.
    """
    empty = np.empty(0, dtype=np.int64)
    if times_s.size == 0:
        return empty, empty, empty, empty
    half = _half_hull(boxes)
    low, high = boxes[..., :2] - half, boxes[..., :2] + half
    numbers = np.floor((times_s - times_s[0]) / block_s).astype(np.int64)
    starts = np.flatnonzero(np.diff(numbers, prepend=-1))
    with np.errstate(invalid="ignore"):
        block_low = np.fmin.reduceat(low, starts, axis=0)
        block_high = np.fmax.reduceat(high, starts, axis=0)
    numbers = numbers[starts]
    ends = np.append(starts[1:], times_s.size)
    found: list[IntArray] = []
    for lag in range(int(np.ceil(longest_s / block_s)) + 1):
        # Blocks may be missing where nobody was there: the lag is one of numbers, not of rows.
        target = np.searchsorted(numbers, numbers + lag)
        there = (target < numbers.size) & (numbers[np.minimum(target, numbers.size - 1)] == numbers + lag)
        rows = np.flatnonzero(there)
        other = target[rows]
        hulls = (block_low[rows], block_high[rows], block_low[other], block_high[other])
        block, first, second = _block_pairs(*hulls)
        spans = (starts[rows[block]], ends[rows[block]], starts[other[block]], ends[other[block]])
        found += _footprints(boxes, times_s, spans, (first, second), longest_s, least_angle_rad)
    if not found:
        return empty, empty, empty, empty
    return _nearest(np.concatenate(found, axis=1))


def _block_pairs(
    low: FloatArray, high: FloatArray, other_low: FloatArray, other_high: FloatArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Blocks and vehicles where the hull of one (b, V, 2) and that of another one overlap."""
    blocks, vehicles = low.shape[:2]
    lows = np.concatenate([low.reshape(-1, 2), other_low.reshape(-1, 2)])
    highs = np.concatenate([high.reshape(-1, 2), other_high.reshape(-1, 2)])
    own = blocks * vehicles
    one, two = overlapping_pairs(lows, highs, np.tile(np.repeat(np.arange(blocks), vehicles), 2))
    across = (one < own) & (two >= own)
    one, two = one[across], two[across] - own
    differ = one % vehicles != two % vehicles
    one, two = one[differ], two[differ]
    return one // vehicles, one % vehicles, two % vehicles


def _footprints(
    boxes: FloatArray,
    times_s: FloatArray,
    spans: tuple[IntArray, IntArray, IntArray, IntArray],
    vehicles: tuple[IntArray, IntArray],
    longest_s: float,
    least_angle_rad: float,
) -> list[IntArray]:
    """(4, m) overlapping footprints of candidate blocks: first, second, earlier, later."""
    found = []
    sizes = (spans[1] - spans[0]) * (spans[3] - spans[2])
    cuts = np.flatnonzero(np.diff(np.cumsum(sizes) // _BLOCK)) + 1
    for part in np.split(np.arange(sizes.size), cuts):
        if part.size == 0:
            continue
        row = np.repeat(part, sizes[part])
        place = np.arange(row.size) - np.repeat(np.cumsum(sizes[part]) - sizes[part], sizes[part])
        width = (spans[3] - spans[2])[row]
        earlier, later = spans[0][row] + place // width, spans[2][row] + place % width
        first, second = vehicles[0][row], vehicles[1][row]
        apart = times_s[later] - times_s[earlier]
        keep = (apart >= 0.0) & (apart <= longest_s + _ROUNDING_S)
        earlier, later, first, second = (x[keep] for x in (earlier, later, first, second))
        a, b = boxes[earlier, first], boxes[later, second]
        with np.errstate(invalid="ignore"):
            radii = (np.hypot(a[:, 3], a[:, 4]) + np.hypot(b[:, 3], b[:, 4])) / 2.0
            near = np.hypot(*(b[:, :2] - a[:, :2]).T) <= radii
            near &= conflict_angle(a[:, 2], b[:, 2]) >= least_angle_rad
        rows = np.flatnonzero(near)
        rows = rows[box_gap(a[rows], b[rows]) <= 0.0]
        found.append(np.stack([first[rows], second[rows], earlier[rows], later[rows]]))
    return found


def _nearest(rows: IntArray) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Of each first, second and earlier the row of the least later."""
    rows = rows[:, np.lexsort(rows[::-1])]
    fresh = (np.diff(rows[:3], axis=1, prepend=-1) != 0).any(axis=0)
    first, second, earlier, later = rows[:, fresh]
    return earlier, later, first, second


def _half_hull(boxes: FloatArray) -> FloatArray:
    """(..., 2) half sizes of the axis-aligned hulls of boxes."""
    c, s = np.abs(np.cos(boxes[..., 2])), np.abs(np.sin(boxes[..., 2]))
    length, width = boxes[..., 3], boxes[..., 4]
    return np.stack([length * c + width * s, length * s + width * c], axis=-1) / 2.0
