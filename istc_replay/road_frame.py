"""The corridor frame turned to the road, and how far a car may turn from its guidance.

Axis-aligned cubes cost much where traffic runs at an angle: one yaw a window, under which the
recording itself is least in conflict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray
from istc_replay.geometry import rotate

_BIN_RAD = np.radians(2.0)
_BINS = 10
_REFINEMENTS_RAD = np.radians([0.0, -1.0, 1.0])
#: A car leaves its guidance's heading by what steering at this rate adds up to [rad/m], and by what
#: a sideways speed of this [m/s] in one second makes of its speed.
_TURN_PER_M = 0.22
_SIDEWAYS_MPS2 = 1.5
#: Where it matters, near a neighbour, a car is held this narrow.
_NEAR_RAD = np.radians(1.5)
_MOST_RAD, _LEAST_RAD = np.radians(25.0), np.radians(1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A road user's poses (K+1, 3) at the boundaries of its units from `first_unit` on, and its box [m].

    One that is not `planned` moves as recorded.
    """

    first_unit: int
    poses: FloatArray
    length_m: float
    width_m: float
    planned: bool = True


def heading_slack(poses: FloatArray, unit_s: float) -> FloatArray:
    """How far (K+1,) [rad] a car may turn from its guidance: little at speed, and just after the start."""
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    away = np.concatenate([[0.0], np.cumsum(steps)])
    speed = np.concatenate([steps, steps[-1:]]) / unit_s
    by_speed = np.arctan2(_SIDEWAYS_MPS2 * unit_s, np.maximum(speed, 1e-9))
    by_distance = _TURN_PER_M * (away + 0.5 * unit_s**2)
    return np.asarray(np.clip(np.minimum(by_speed, by_distance), _LEAST_RAD, _MOST_RAD))


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """The poses of all bodies one below the other, and the units and pairs to look at, for any yaw.

    `poses` (P, 3), `sizes_m` (P, 2) and `slack_rad` (P,) by pose; `begins` (U,) the poses at the start of
    each body's units; `place` (U, 2) body and unit of each; `pairs` (2, M) of bodies.
    """

    poses: FloatArray
    sizes_m: FloatArray
    slack_rad: FloatArray
    begins: NDArray[np.int64]
    place: tuple[NDArray[np.int64], NDArray[np.int64]]
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]]
    shape: tuple[int, int]

    @classmethod
    def of(cls, bodies: Sequence[Body], units: int, unit_s: float) -> _Row:
        counts = np.array([len(body.poses) for body in bodies], dtype=np.int64)
        body = np.repeat(np.arange(len(bodies)), counts)
        starts = np.cumsum(counts) - counts
        last = np.zeros(len(body), dtype=bool)
        last[starts + counts - 1] = True
        begins = np.flatnonzero(~last)
        first_units = np.array([b.first_unit for b in bodies], dtype=np.int64)
        unit = begins - starts[body[begins]] + first_units[body[begins]]
        planned = np.array([b.planned for b in bodies], dtype=bool)
        one, other = np.triu_indices(len(bodies), 1)
        concerned = planned[one] | planned[other]
        return cls(
            np.concatenate([b.poses for b in bodies]),
            np.array([(b.length_m, b.width_m) for b in bodies])[body],
            np.concatenate([np.minimum(heading_slack(b.poses, unit_s), _NEAR_RAD) for b in bodies]),
            begins,
            (body[begins], unit),
            (one[concerned], other[concerned]),
            (len(bodies), units),
        )

    def boxes(self, yaw_rad: float) -> FloatArray:
        """Least boxes (B, N, 4) in a frame of this yaw; NaN where a body is absent."""
        found = np.full((*self.shape, 4), np.nan)
        walls = _hulls(self.poses, self.sizes_m, self.slack_rad, yaw_rad)
        ends = np.stack([walls[self.begins], walls[self.begins + 1]])
        found[(*self.place, slice(0, None, 2))] = ends[..., 0::2].min(axis=0)
        found[(*self.place, slice(1, None, 2))] = ends[..., 1::2].max(axis=0)
        return found

    def conflicts(self, yaw_rad: float) -> tuple[int, int, float]:
        boxes = self.boxes(yaw_rad)
        a, b = boxes[self.pairs[0]], boxes[self.pairs[1]]  # (M, N, 4)
        apart = np.maximum(a[..., 0::2] - b[..., 1::2], b[..., 0::2] - a[..., 1::2]).max(axis=-1)  # (M, N)
        both = ~np.isnan(apart)
        overlap = both & (apart < 0.0)
        meeting = both.any(axis=1)
        met = overlap[np.flatnonzero(meeting), both[meeting].argmax(axis=1)]
        return int(met.sum()), int(overlap.sum()), float(-apart[overlap].sum())


def conflicts(bodies: Sequence[Body], units: int, unit_s: float, yaw_rad: float) -> tuple[int, int, float]:
    """What stands in the way of planning in a frame of this yaw.

    Returns
    -------
    tuple
        Pairs in conflict when they first meet, all conflicts of pairs and units, and the sum of
        their overlaps [m]; smaller is better, in this order.
    """
    return _Row.of(bodies, units, unit_s).conflicts(yaw_rad) if bodies else (0, 0, 0.0)


def road_yaw(bodies: Sequence[Body], units: int, unit_s: float) -> float:
    """Yaw [rad] of the corridor frame in which the recording is least in conflict.

    Candidates are the road users' headings modulo a right angle, the most frequent, and 0; the best
    is refined. The result lies within a quarter turn that the longest way of the traffic starts.
    """
    planned = [body for body in bodies if body.planned]
    if not planned:
        return 0.0
    headings = np.concatenate([body.poses[:, 2] for body in planned]) % (np.pi / 2)
    # Bins about the mean direction, so that a turned log has turned candidates.
    mean = float(np.angle(np.exp(4j * headings).mean())) / 4.0
    off = (headings - mean + np.pi / 4) % (np.pi / 2) - np.pi / 4
    bins, counts = np.unique(np.round(off / _BIN_RAD), return_counts=True)
    order = np.lexsort((np.abs(bins), -counts))[:_BINS]
    candidates = [mean + float(b) * _BIN_RAD for b in bins[order]]

    row = _Row.of(bodies, units, unit_s)

    def cost(yaw: float) -> tuple[int, int, float, float]:
        return (*row.conflicts(yaw), abs(yaw - mean))

    best = min(candidates, key=cost)
    return float(min((best + step for step in _REFINEMENTS_RAD), key=cost))


def least_boxes(body: Body, unit_s: float, yaw_rad: float) -> FloatArray:
    """Hulls (K, 4) of the car-boxes at both ends of each unit, in a frame of this yaw."""
    begin = replace(body, first_unit=0)
    return np.asarray(_Row.of([begin], len(body.poses) - 1, unit_s).boxes(yaw_rad)[0])


def _hulls(poses: FloatArray, sizes_m: FloatArray, slack_rad: FloatArray, yaw_rad: float) -> FloatArray:
    """Boxes (P, 4) that hold cars of these sizes (P, 2) at these poses, turned either way by the slack."""
    centres, heading = rotate(poses[:, :2], -yaw_rad), poses[:, 2] - yaw_rad
    length, width = sizes_m.T
    walls = np.empty((len(poses), 4))
    turned = np.stack([heading - slack_rad, heading + slack_rad])
    c, s = np.abs(np.cos(turned)), np.abs(np.sin(turned))
    for axis, extents in enumerate((length * c + width * s, length * s + width * c)):
        half = extents.max(axis=0) / 2.0
        walls[:, 2 * axis], walls[:, 2 * axis + 1] = centres[:, axis] - half, centres[:, axis] + half
    return walls
