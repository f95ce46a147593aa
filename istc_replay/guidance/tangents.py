"""Sharp paths along taut lines: circles at the ends and about the corners, joined by their tangents."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from istc_replay.datatypes import FloatArray
from istc_replay.guidance.curves import Pose, arc_poses
from istc_replay.guidance.ways import Way

_WHOLE_TURN = 2.0 * math.pi
#: Kept beside a corner: a path pulled taut from outside finds a shorter one than one pushed out.
_SPARE_M = 0.4


@dataclass(frozen=True, eq=False)
class Sharp:
    """A path whose curvature jumps: arcs `lengths_m` and `bends_1pm` (A,) from a start.

    Averaged over `ramp_m` the curvature leads to the same end, up to some centimetres.
    """

    start: Pose
    lengths_m: FloatArray
    bends_1pm: FloatArray
    ramp_m: float = 0.0

    @property
    def length_m(self) -> float:
        """Length of the whole path."""
        return float(self.lengths_m.sum())

    def poses(self, step_m: float) -> FloatArray:
        """Poses (S, 3) a step apart, its end left out [m, rad]."""
        s = np.arange(0.0, self.length_m, step_m)
        start, lengths, bends = self.start.as_array()[None], self.lengths_m[None], self.bends_1pm[None]
        return np.asarray(arc_poses(start, lengths, bends, s[None])[0])


def sharp_paths(ways: list[Way], start: Pose, goal: Pose, radius_m: float, ramp_m: float) -> list[Sharp]:
    """Make paths of one turning radius along lines, either way round at start and goal, shortest first.

    They begin and end with straights of half a ramp [m], over which their curvature can be averaged.
    """
    begin, end = inner_ends(start, goal, ramp_m)
    found: dict[tuple[float, ...], Sharp] = {}
    for way, first, last in itertools.product(ways, (1.0, -1.0), (1.0, -1.0)):
        path = _tangents(way, begin, end, radius_m, first, last)
        if path is not None:
            # Lines that differ at loose corners alone give one path.
            found.setdefault(
                tuple(np.round(np.concatenate(path), 6).tolist()), with_ramps(start, *path, ramp_m)
            )
    return sorted(found.values(), key=lambda sharp: sharp.length_m)


def inner_ends(start: Pose, goal: Pose, ramp_m: float) -> tuple[Pose, Pose]:
    """Poses half a ramp [m] after the start and before the goal."""
    moved = []
    for pose, by_m in ((start, ramp_m / 2.0), (goal, -ramp_m / 2.0)):
        dx, dy = by_m * math.cos(pose.heading_rad), by_m * math.sin(pose.heading_rad)
        moved.append(Pose(pose.x_m + dx, pose.y_m + dy, pose.heading_rad))
    return moved[0], moved[1]


def with_ramps(start: Pose, lengths_m: FloatArray, bends_1pm: FloatArray, ramp_m: float) -> Sharp:
    """Arcs (A,) between the `inner_ends` as a path between the ends."""
    half, straight = [ramp_m / 2.0], [0.0]
    return Sharp(
        start,
        np.concatenate([half, lengths_m, half]),
        np.concatenate([straight, bends_1pm, straight]),
        ramp_m,
    )


def _tangents(
    way: Way, start: Pose, goal: Pose, radius_m: float, first: float, last: float
) -> tuple[FloatArray, FloatArray] | None:
    """Arcs of the path that touches circles to the given sides; None where two have no such tangent."""
    corners = [
        (side, _beside(x, y, heading, side * (radius_m - room - _SPARE_M)))
        for side, (x, y), heading, room in zip(
            way.sides.tolist(),
            way.points_m.tolist(),
            way.headings_rad.tolist(),
            way.rooms_m.tolist(),
            strict=True,
        )
    ]
    while True:
        circles = [
            (first, _beside(start.x_m, start.y_m, start.heading_rad, first * radius_m)),
            *corners,
            (last, _beside(goal.x_m, goal.y_m, goal.heading_rad, last * radius_m)),
        ]
        headings, straights = [start.heading_rad], []
        for (side, here), (other, there) in itertools.pairwise(circles):
            dx, dy = there[0] - here[0], there[1] - here[1]
            apart, aside = math.hypot(dx, dy), (side - other) * radius_m
            if apart <= abs(aside):
                return None
            inclined = math.asin(aside / apart)
            headings.append(math.atan2(dy, dx) + inclined)
            straights.append(apart * math.cos(inclined))
        headings.append(goal.heading_rad)
        sides = [side for side, _ in circles]
        turns = [side * (b - a) for side, (a, b) in zip(sides, itertools.pairwise(headings), strict=True)]
        about = [math.remainder(turn, _WHOLE_TURN) for turn in turns[1:-1]]
        touched = [corner for corner, turn in zip(corners, about, strict=True) if turn >= 0.0]
        if len(touched) == len(corners):
            break
        corners = touched
    lengths, bends = np.zeros(2 * len(turns) - 1), np.zeros(2 * len(turns) - 1)
    lengths[::2] = np.array([turns[0] % _WHOLE_TURN, *about, turns[-1] % _WHOLE_TURN]) * radius_m
    lengths[1::2] = straights
    bends[::2] = np.array(sides) / radius_m
    return lengths, bends


def _beside(x_m: float, y_m: float, heading_rad: float, by_m: float) -> tuple[float, float]:
    """The point this far to the left of a pose."""
    return x_m - by_m * math.sin(heading_rad), y_m + by_m * math.cos(heading_rad)
