"""The moves of one vehicle along its candidate paths: from a place by a step, in one time unit.

Shapes: W steps (places a unit, from 0), S places on the longest path, P paths. Paths come last: arrays of
all moves are long runs of memory, and a step further on is a fixed number of entries.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from istc_replay.corridors.blocks import car_box_m
from istc_replay.corridors.seed.paths import LEVEL_M, SeedPath
from istc_replay.datatypes import FloatArray, Obstacle, Participant

_FASTEST_MPS = 6.5
_ACCELERATION_MPS2, _DECELERATION_MPS2, _BRAKED_MPS2 = 1.5, 2.5, 1.5
#: The car-box turns by this either way, and by what keeps a bend within the hull of two boxes.
_SLACK_RAD, _SLACK_MAX_RAD, _SLACK_OF_BEND = 0.05, 0.44, 1.6
#: Overlaps and places no larger than this are rounding.
ROUNDING_M = 1e-3

Mask = NDArray[np.bool_]
Depth = NDArray[np.float32]
_Value = TypeVar("_Value", bound=np.generic)


class Moves:
    """Least cubes of all moves, and which can be driven.

    Parameters
    ----------
    participant : Participant
        The vehicle.
    paths : sequence of SeedPath
        Its candidates.
    unit_s : float
        Length of a time unit.
    obstacles, bounds_m, gap_m
        What to keep clear of.
    """

    def __init__(
        self,
        participant: Participant,
        paths: Sequence[SeedPath],
        unit_s: float,
        obstacles: Sequence[Obstacle],
        bounds_m: tuple[float, float, float, float] | None,
        gap_m: float,
    ) -> None:
        self.paths = paths
        #: How many places a unit a step may be shorter or longer than the one before.
        self.fewer = max(1, math.ceil(_DECELERATION_MPS2 * unit_s**2 / LEVEL_M))
        self.more = max(1, round(_ACCELERATION_MPS2 * unit_s**2 / LEVEL_M))
        #: Places of the longest step in which a car can brake to stand.
        self.braked_step = int(_DECELERATION_MPS2 * unit_s**2 / 2.0 / LEVEL_M)
        steps = round(_FASTEST_MPS * unit_s / LEVEL_M) + 1
        self.shape = (steps, max(len(path.poses) for path in paths), len(paths))
        self.last = np.array([len(path.poses) - 1 for path in paths])
        self._participant, self._unit_s = participant, unit_s
        low, high = self._car_boxes()
        #: x_min, x_max, y_min, y_max of every move's least cube (4, W, S, P).
        self.cubes_m = np.stack(
            [
                side(box[..., axis], self.onward(box[..., axis]))
                for axis in (0, 1)
                for side, box in ((np.minimum, low), (np.maximum, high))
            ],
            dtype=np.float32,
            casting="same_kind",
        )
        self.free = self._drivable()
        if bounds_m is not None:
            lower, upper = np.reshape(bounds_m, (2, 2)).T
            out: Mask = np.any((low < lower - ROUNDING_M) | (high > upper + ROUNDING_M), axis=-1)
            out[0] = False  # the start is as it is
            self.free &= ~self.onward(out)
        #: How far (W, S, P) [m] moves reach into what stands.
        self.deep = np.zeros(self.shape, dtype=np.float32)
        for obstacle in obstacles:
            if stands(obstacle):
                np.maximum(self.deep, self.depth(obstacle.boxes_m[0], gap_m), out=self.deep)

    def onward(self, values: NDArray[_Value]) -> NDArray[_Value]:
        """A view (W, S, P) of values (S, P) at the places where moves end, the last ones beyond them."""
        steps, places, paths = self.shape
        padded = np.concatenate([values, np.repeat(values[-1:], steps, axis=0)])
        place, path = padded.strides
        return as_strided(padded, (steps, places, paths), (place, place, path), writeable=False)

    def depth(self, box_m: FloatArray, gap_m: float) -> Depth:
        """How far (W, S, P) [m] the cubes of moves reach into a box grown by the gap."""
        x_min, x_max, y_min, y_max = self.cubes_m
        low_x, high_x = np.float32(box_m[0] - gap_m), np.float32(box_m[1] + gap_m)
        low_y, high_y = np.float32(box_m[2] - gap_m), np.float32(box_m[3] + gap_m)
        across = np.minimum(high_x - x_min, x_max - low_x)
        np.minimum(across, high_y - y_min, out=across)
        np.minimum(across, y_max - low_y, out=across)
        return np.asarray(np.maximum(across, np.float32(0.0), out=across))

    def meeting(self, boxes_m: FloatArray, gap_m: float, furthest: Sequence[int]) -> list[NDArray[np.int64]]:
        """For each of several boxes (K, 4) the moves whose cubes come nearer than the gap.

        Left out are those that begin beyond the furthest place (K,). They are numbered as in an array
        (W, W + S, P), of which the first W places lie before the start.
        """
        steps, places, paths = self.shape
        grown = (boxes_m + gap_m * np.array([-1.0, 1.0, -1.0, 1.0])).astype(np.float32)
        x_min, x_max, y_min, y_max = (side[:, None] for side in grown.T)
        reach = self._reach_m
        near = (reach[0] < x_max) & (reach[1] > x_min)
        near &= (reach[2] < y_max) & (reach[3] > y_min)
        near &= np.arange(places * paths) < (np.array(furthest)[:, None] + 1) * paths
        box, place = np.nonzero(near)
        cubes = self.cubes_m.reshape(4, steps, places * paths)[:, :, place]
        met = (cubes[0] < x_max[box, 0]) & (cubes[1] > x_min[box, 0])
        met &= (cubes[2] < y_max[box, 0]) & (cubes[3] > y_min[box, 0])
        met &= self.free.reshape(steps, -1)[:, place]
        at, step = np.nonzero(met.T)
        moves = (step * (steps + places) + steps) * paths + place[at]
        ends = np.searchsorted(box[at], np.arange(len(boxes_m) + 1)).tolist()
        return [moves[first:end] for first, end in pairwise(ends)]

    @cached_property
    def _reach_m(self) -> Depth:
        """Hull (4, S P) of the cubes of all moves that can be driven from a place."""
        cubes, free = self.cubes_m.reshape(4, self.shape[0], -1), self.free.reshape(self.shape[0], -1)
        low = np.where(free, cubes[::2], np.inf).min(axis=1)
        high = np.where(free, cubes[1::2], -np.inf).max(axis=1)
        return np.stack([low[0], high[0], low[1], high[1]])

    def reachable(self, overlap_max_m: float) -> Mask:
        """Paths (P,) whose end can be reached at all, whatever the time."""
        steps, places, paths = self.shape
        free = self.free & (self.deep <= overlap_max_m)
        here = np.zeros((places + steps, paths), dtype=bool)
        here[0] = True
        for place in range(places):
            here[place : place + steps] |= here[place] & free[:, place]
        return np.asarray(here[self.last, np.arange(paths)])

    def first_steps(self) -> Mask:
        """First steps (W,) that follow from the speed at the start."""
        cruising, half = self._participant.start.speed_mps * self._unit_s / LEVEL_M, 0.51
        steps = np.arange(self.shape[0])
        slowest, fastest = cruising - self.fewer / 2.0 - half, cruising + self.more / 2.0 + half
        first = (steps >= slowest) & (steps <= fastest)
        if not first.any():
            first[-1] = True
        return np.asarray(first)

    def furthest(self, units: int) -> list[int]:
        """The furthest place (K,) at which a unit may begin."""
        steps, places, _ = self.shape
        found, step = [0], int(np.flatnonzero(self.first_steps())[-1])
        for _ in range(units - 1):
            found.append(min(found[-1] + step, places - 1))
            step = min(step + self.more, steps - 1)
        return found

    def _car_boxes(self) -> tuple[FloatArray, FloatArray]:
        """Low and high corners (S, P, 2) of the car-box at every place."""
        _, places, paths = self.shape
        poses = np.stack([_padded(path.poses, places) for path in self.paths], axis=1)
        bend = np.zeros((places, paths))
        for number, path in enumerate(self.paths):
            bend[: len(path.curvatures_1pm), number] = path.curvatures_1pm
        slack = np.minimum(_SLACK_RAD + _SLACK_OF_BEND * self._unit_s**2 * np.abs(bend), _SLACK_MAX_RAD)
        slack[0] = 0.0
        size = self._participant.dimensions
        boxes = car_box_m(poses[..., 2].ravel(), slack.ravel(), size.length_m, size.width_m)
        half = boxes.reshape(places, paths, 2) / 2.0
        #: Centres (S, P, 2) of all places, and the heading slack (S, P) of their car-boxes.
        self.points_m, self.slack_rad = poses[..., :2], slack
        return self.points_m - half, self.points_m + half

    def _drivable(self) -> Mask:
        """Moves (W, S, P) that end on the path and are not too fast for either end."""
        count, places, _ = self.shape
        steps = np.arange(count)[:, None, None]
        speeds = np.stack([_padded(path.speeds_mps, places) for path in self.paths], axis=1)
        # Who starts faster than a bend allows brakes into it.
        start_mps = self._participant.start.speed_mps
        braked = np.sqrt(np.maximum(start_mps**2 - 2.0 * _BRAKED_MPS2 * LEVEL_M * np.arange(places), 0.0))
        speeds = np.maximum(speeds, braked[:, None])
        most = np.floor(speeds * self._unit_s / LEVEL_M + ROUNDING_M)
        most = np.maximum(most, 1.0)  # creeping is always allowed
        inside = steps + np.arange(places)[:, None] <= self.last
        return np.asarray(inside & (steps <= most) & (steps <= self.onward(most)))


def stands(obstacle: Obstacle) -> bool:
    """Whether an obstacle is at the same place in all units."""
    return bool((obstacle.boxes_m == obstacle.boxes_m[0]).all())


def _padded(values: FloatArray, count: int) -> FloatArray:
    """Values (n, ...) with the last one repeated up to a count."""
    return np.concatenate([values, np.repeat(values[-1:], count - len(values), axis=0)])
