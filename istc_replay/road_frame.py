"""The corridor frame turned to the road, and how far a car may turn from its guidance.

Axis-aligned cubes cost much where traffic runs at an angle: one yaw a window, under which the
recording itself is least in conflict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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


def conflicts(bodies: Sequence[Body], units: int, unit_s: float, yaw_rad: float) -> tuple[int, int, float]:
    """What stands in the way of planning in a frame of this yaw.

    Returns
    -------
    tuple
        Pairs in conflict when they first meet, all conflicts of pairs and units, and the sum of
        their overlaps [m]; smaller is better, in this order.
    """
    boxes = np.full((len(bodies), units, 4), np.nan)
    for row, body in enumerate(bodies):
        least = least_boxes(body, unit_s, yaw_rad)
        boxes[row, body.first_unit : body.first_unit + len(least)] = least
    first, second = np.triu_indices(len(bodies), 1)
    planned = np.array([body.planned for body in bodies], dtype=bool)
    concerned = planned[first] | planned[second]
    first, second = first[concerned], second[concerned]
    a, b = boxes[first], boxes[second]  # (P, N, 4)
    apart = np.maximum(a[..., 0::2] - b[..., 1::2], b[..., 0::2] - a[..., 1::2]).max(axis=-1)  # (P, N)
    both = ~np.isnan(apart)
    overlap = both & (apart < 0.0)
    meeting = both.any(axis=1)
    met = overlap[np.flatnonzero(meeting), both[meeting].argmax(axis=1)]
    return int(met.sum()), int(overlap.sum()), float(-apart[overlap].sum())


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

    def cost(yaw: float) -> tuple[int, int, float, float]:
        return (*conflicts(bodies, units, unit_s, yaw), abs(yaw - mean))

    best = min(candidates, key=cost)
    return float(min((best + step for step in _REFINEMENTS_RAD), key=cost))


def least_boxes(body: Body, unit_s: float, yaw_rad: float) -> FloatArray:
    """Hulls (K, 4) of the car-boxes at both ends of each unit, in a frame of this yaw."""
    centres = rotate(body.poses[:, :2], -yaw_rad)
    slack = np.minimum(heading_slack(body.poses, unit_s), _NEAR_RAD)
    heading = body.poses[:, 2] - yaw_rad
    half = 0.5 * np.stack(
        [
            np.maximum(*(_extent(heading + s, body.length_m, body.width_m)[axis] for s in (-slack, slack)))
            for axis in (0, 1)
        ],
        axis=-1,
    )
    low, high = centres - half, centres + half
    low, high = np.minimum(low[:-1], low[1:]), np.maximum(high[:-1], high[1:])
    return np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=-1)


def _extent(heading_rad: FloatArray, length_m: float, width_m: float) -> tuple[FloatArray, FloatArray]:
    c, s = np.abs(np.cos(heading_rad)), np.abs(np.sin(heading_rad))
    return length_m * c + width_m * s, length_m * s + width_m * c
