"""The lane that a recorded vehicle is in, and those that it goes on to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.datatypes import FloatArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from istc_replay.datatypes import LaneLine

#: A vehicle is in no lane whose line is farther from its box's centre, or heads more another way, than this.
_BESIDE_M, _APART_RAD = 2.5, np.radians(45.0)
#: A lane goes on in another that begins this near to its end [m].
_JOINT_M = 1.5
#: Lanes that are followed one after the other.
_MOST = 100


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """A lane's line (P, 2), and the headings (P-1,) and lengths (P-1,) of its steps."""

    lane: LaneLine
    points: FloatArray
    headings: FloatArray
    lengths: FloatArray

    @classmethod
    def of(cls, lane: LaneLine) -> _Line | None:
        points = lane.points_m
        if len(points) < 2 or not np.isfinite(points).all():
            return None
        moved = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-6])
        step = np.diff(points[moved], axis=0)
        if not len(step):
            return None
        return cls(lane, points[moved], np.arctan2(step[:, 1], step[:, 0]), np.hypot(*step.T))

    def beside(self, pose: FloatArray) -> tuple[float, float]:
        """Distance of the line from a pose (3,), inf where it heads elsewhere, and the way left on it."""
        offset = pose[:2] - self.points[:-1]
        step = np.diff(self.points, axis=0)
        share = np.clip((offset * step).sum(axis=1) / self.lengths**2, 0.0, 1.0)
        apart = np.hypot(*(offset - share[:, None] * step).T)
        apart = np.where(_turn(self.headings, pose[2]) <= _APART_RAD, apart, np.inf)
        nearest = int(np.argmin(apart))
        left = (1.0 - share[nearest]) * self.lengths[nearest] + self.lengths[nearest + 1 :].sum()
        return float(apart[nearest]), float(left)

    def follows(self, before: _Line) -> bool:
        """Whether it goes on where another ends."""
        gap = float(np.hypot(*(self.points[0] - before.points[-1])))
        return gap <= _JOINT_M and float(_turn(self.headings[0], before.headings[-1])) <= _APART_RAD


def lane_ahead(lanes: Sequence[LaneLine], poses: FloatArray, length_m: float) -> FloatArray | None:
    """The line (P, 2) of the lane that a vehicle is in, and of those that it goes on to.

    Where a lane goes on in several, the one nearest to the recorded path is taken.

    Parameters
    ----------
    lanes : sequence of LaneLine
        Lane lines, in the frame of the poses.
    poses : (S, 3) array
        Recorded box centres and headings; it is in a lane at the first.
    length_m : float
        Way ahead that is needed.

    Returns
    -------
    array or None
        None where it is in no lane.
    """
    lines = [line for lane in lanes if (line := _Line.of(lane)) is not None]
    beside = [line.beside(poses[0]) for line in lines]
    near = [row for row, (apart, left) in enumerate(beside) if apart <= _BESIDE_M and left > 0.0]
    if not near:
        return None
    first = min(near, key=lambda row: beside[row][0])
    chain, left = [lines[first]], beside[first][1]
    while left < length_m and len(chain) < _MOST:
        ahead = [
            line for line in lines if line.follows(chain[-1]) and not any(line is each for each in chain)
        ]
        if not ahead:
            break
        chain.append(min(ahead, key=lambda line: _away(line, poses)))
        left += float(chain[-1].lengths.sum())
    return np.concatenate([line.points for line in chain])


def _away(line: _Line, poses: FloatArray) -> float:
    """Mean distance of a lane's first 30 m from the recorded path, which goes straight on at its end."""
    arc = np.concatenate([[0.0], np.cumsum(line.lengths)])
    at = np.linspace(0.0, min(30.0, arc[-1]), 7)
    places = np.stack([np.interp(at, arc, column) for column in line.points.T], axis=-1)
    end = poses[-1, :2] + 60.0 * np.array([np.cos(poses[-1, 2]), np.sin(poses[-1, 2])])
    path = np.vstack([poses[:, :2], end])
    step = np.diff(path, axis=0)
    offset = places[:, None] - path[:-1]
    share = np.clip((offset * step).sum(-1) / np.maximum((step**2).sum(-1), 1e-12), 0.0, 1.0)
    return float(np.hypot(*np.moveaxis(offset - share[..., None] * step, -1, 0)).min(axis=1).mean())


def _turn(first_rad: FloatArray | float, second_rad: float) -> FloatArray:
    """Angle between two headings [rad], at least 0."""
    return np.asarray(np.abs((np.asarray(first_rad) - second_rad + np.pi) % (2.0 * np.pi) - np.pi))
