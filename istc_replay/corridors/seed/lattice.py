"""The best motion of one vehicle over (path, place, last step), by exact dynamic programming.

Shapes: P paths, S places on the longest, W steps (places a unit, from 0), K units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from istc_replay.corridors.blocks import car_box_m
from istc_replay.corridors.seed.paths import LEVEL_M, SeedPath
from istc_replay.datatypes import FloatArray, Guidance, Obstacle, Participant

_FASTEST_MPS = 6.5
_ACCELERATION_MPS2, _DECELERATION_MPS2, _BRAKED_MPS2 = 1.5, 2.5, 1.5
#: The car-box turns by this either way, and by what keeps a bend within the hull of two boxes.
_SLACK_RAD, _SLACK_MAX_RAD, _SLACK_OF_BEND = 0.05, 0.44, 1.6
_ROUNDING_M = 1e-3

# Costs, in those of eq. (3) at a weight of 10.
_LENGTH_COST = 200.0  # of a metre more than the guidance has
_MISS_COST = 3000.0  # of a metre short of the goal
_LATE_COST = 60.0  # the same in each of the last units
_OVERLAP_COST = 5000.0  # of a metre of overlap with an obstacle: layer 1 can mend a little
_OVERLAP_MAX_M = 2.0
_LATE_S = 2.0

#: Overlaps no larger than this are rounding of places.
CLEAR_M = 0.6
#: Steps from so many places about one that is barred are barred with it.
_BESIDE = 2

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Where a vehicle is: its path, places (K+1,) along it, and least cubes (K, 4)."""

    path: int
    places: NDArray[np.int64]
    cubes_m: FloatArray
    cost: float


class Lattice:
    """All motions of one vehicle along its candidate paths.

    Parameters
    ----------
    participant, guide : Participant, Guidance
        The vehicle.
    paths : sequence of SeedPath
        Its candidates.
    unit_s : float
        Length of a time unit.
    obstacles, bounds_m, gap_m
        What to keep clear of: layer 1 can mend a small overlap, which costs.
    weight : float
        Of a squared distance from the guidance, eta times omega_ref.
    """

    def __init__(
        self,
        participant: Participant,
        guide: Guidance,
        paths: Sequence[SeedPath],
        unit_s: float,
        obstacles: Sequence[Obstacle],
        bounds_m: tuple[float, float, float, float] | None,
        gap_m: float,
        weight: float,
        stops: bool,
        overlap_max_m: float = _OVERLAP_MAX_M,
    ) -> None:
        self.paths = paths
        self.first_unit, self.units = participant.first_unit, participant.units
        self.stops, self._overlap_max_m = stops, overlap_max_m
        self._fewer = max(1, math.ceil(_DECELERATION_MPS2 * unit_s**2 / LEVEL_M))
        self._more = max(1, round(_ACCELERATION_MPS2 * unit_s**2 / LEVEL_M))
        steps = round(_FASTEST_MPS * unit_s / LEVEL_M) + 1
        self._shape = (len(paths), max(len(path.poses) for path in paths), steps)
        self._last = np.array([len(path.poses) - 1 for path in paths])
        self._to = np.arange(self._shape[1])[:, None] + np.arange(steps)[None, :]  # (S, W)
        self._at = np.minimum(self._to, self._shape[1] - 1)
        low, high = self._car_boxes(participant, unit_s)
        self._cubes = np.stack(
            [
                side(box[:, :, None, axis], box[:, self._at, axis])
                for axis in (0, 1)
                for side, box in ((np.minimum, low), (np.maximum, high))
            ]
        ).astype(np.float32)  # (4, P, S, W)
        free = self._drivable(unit_s, participant.start.speed_mps)
        if bounds_m is not None:
            lower, upper = np.reshape(bounds_m, (2, 2)).T
            out: Mask = np.any((low < lower - _ROUNDING_M) | (high > upper + _ROUNDING_M), axis=-1)
            out[:, 0] = False  # the start is as it is
            free &= ~out[:, self._at]
        self._cost = self._costs(guide, free, obstacles, gap_m, weight, unit_s)
        lengths = np.array([path.length_m for path in paths])
        self._extra = (_LENGTH_COST * weight / 10.0 * np.maximum(lengths - lengths[0], 0.0)).astype(
            np.float32
        )
        self._first = self._first_steps(participant.start.speed_mps, unit_s)

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(K, P, S, W)."""
        return (self.units, *self._shape)

    def poses(self, motion: Motion) -> FloatArray:
        """Poses (K+1, 3) of a motion at the units' ends."""
        return np.asarray(self.paths[motion.path].poses[motion.places])

    def slack_rad(self, motion: Motion) -> FloatArray:
        """Heading slack (K+1,) of the car-boxes of a motion."""
        return np.asarray(self._slack[motion.path, motion.places])

    def overlaps(self, cubes_m: FloatArray, first_unit: int, gap_m: float) -> NDArray[np.uint8]:
        """Where (K, P, S, W) a step comes nearer than the gap to another's cubes."""
        out = np.zeros((self.units, *self._shape), dtype=np.uint8)
        for unit in range(self.units):
            other = unit + self.first_unit - first_unit
            if 0 <= other < len(cubes_m):
                out[unit] = self._depth(cubes_m[other], gap_m - _ROUNDING_M) > 0.0
        return out

    def best(self, penalty: NDArray[np.float32]) -> Motion | None:
        """The cheapest motion where steps cost `penalty` (K, P, S, W) beyond their own; None: no way."""
        paths, places, steps = self._shape
        # (K, P, W + S, W): least cost up to the end of a step, rows before the start infinite.
        costs = np.full((self.units, paths, steps + places, steps), np.inf, dtype=np.float32)
        costs[0, :, steps] = np.where(
            self._first, self._cost[0, :, 0] + penalty[0, :, 0] + self._extra[:, None], np.inf
        )
        wide = np.full((paths, places, steps + self._more + self._fewer), np.inf, dtype=np.float32)
        for unit in range(1, self.units):
            wide[:, :, self._more : self._more + steps] = self._arriving(costs[unit - 1])
            least = wide[:, :, :steps].copy()
            for shift in range(1, self._more + self._fewer + 1):
                np.minimum(least, wide[:, :, shift : shift + steps], out=least)
            np.add(least, self._cost[unit], out=costs[unit, :, steps:])
            costs[unit, :, steps:] += penalty[unit]
        return self._traced(costs)

    def own_cost(self, motion: Motion) -> float:
        """What a motion costs without any penalty."""
        steps = np.diff(motion.places)
        along = self._cost[np.arange(self.units), motion.path, motion.places[:-1], steps]
        return float(along.sum() + self._extra[motion.path] + self._end_cost(motion.path, motion.places[-1]))

    def arrives(self, motion: Motion) -> bool:
        """Whether a motion that stops at its goal stands there in the last unit."""
        return not self.stops or bool(motion.places[-2] >= self._last[motion.path] - 1)

    def bar(self, motion: Motion, row: int) -> None:
        """Leave out a motion's step of one unit, and those beside it that reach as deep into an obstacle."""
        path, place = motion.path, int(motion.places[row])
        step = int(motion.places[row + 1]) - place
        near = slice(max(0, place - _BESIDE), place + _BESIDE + 1)
        depth = self._depth_of_obstacles[path, near]
        deepest = self._depth_of_obstacles[path, place, step]
        self._cost[:, path, place, step] = np.inf
        if deepest > _ROUNDING_M:
            self._cost[:, path, near][:, depth >= deepest - _ROUNDING_M] = np.inf

    def slow(self, motion: Motion, row: int) -> None:
        """Leave out a motion's last move up to a unit, and faster ones, from places beside it."""
        steps = np.diff(motion.places)
        moving = np.flatnonzero(steps[: row + 1])
        row = int(moving[-1]) if len(moving) else row
        path, place = motion.path, int(motion.places[row])
        near = slice(max(0, place - _BESIDE), place + _BESIDE + 1)
        self._cost[:, path, near, max(1, int(steps[row])) :] = np.inf

    def reachable(self) -> Mask:
        """Paths (P,) whose end can be reached at all, whatever the time."""
        free = np.isfinite(self._cost[0]) & (self._depth_of_obstacles <= CLEAR_M)
        here = np.zeros(self._shape[:2], dtype=bool)
        here[:, 0] = True
        for place in range(self._shape[1]):
            for step in range(1, min(self._shape[2], self._shape[1] - place)):
                here[:, place + step] |= here[:, place] & free[:, place, step]
        return np.asarray(here[np.arange(len(self._last)), self._last])

    def _car_boxes(self, participant: Participant, unit_s: float) -> tuple[FloatArray, FloatArray]:
        """Low and high corners (P, S, 2) of the car-box at every place."""
        paths, places, _ = self._shape
        poses = np.stack(
            [np.pad(p.poses, ((0, places - len(p.poses)), (0, 0)), mode="edge") for p in self.paths]
        )
        bend = np.stack([np.pad(p.curvatures_1pm, (0, places - len(p.poses))) for p in self.paths])
        slack = np.minimum(_SLACK_RAD + _SLACK_OF_BEND * unit_s**2 * np.abs(bend), _SLACK_MAX_RAD)
        slack[:, 0] = 0.0
        size = participant.dimensions
        boxes = car_box_m(poses[..., 2].ravel(), slack.ravel(), size.length_m, size.width_m)
        half = boxes.reshape(paths, places, 2) / 2.0
        self._points, self._slack = poses[..., :2], slack
        return poses[..., :2] - half, poses[..., :2] + half

    def _drivable(self, unit_s: float, start_mps: float) -> Mask:
        """Steps (P, S, W) that end on the path and are not too fast for either end."""
        places, steps = self._shape[1], np.arange(self._shape[2])
        speeds = np.stack([np.pad(p.speeds_mps, (0, places - len(p.poses)), mode="edge") for p in self.paths])
        # Who starts faster than a bend allows brakes into it.
        braked = np.sqrt(np.maximum(start_mps**2 - 2.0 * _BRAKED_MPS2 * LEVEL_M * np.arange(places), 0.0))
        speeds = np.maximum(speeds, braked)
        most = np.floor(speeds * unit_s / LEVEL_M + _ROUNDING_M)
        most = np.maximum(most, 1.0)  # creeping is always allowed
        inside = self._to[None] <= self._last[:, None, None]
        return np.asarray(inside & (steps <= most[:, :, None]) & (steps <= most[:, self._at]))

    def _costs(
        self,
        guide: Guidance,
        free: Mask,
        obstacles: Sequence[Obstacle],
        gap_m: float,
        weight: float,
        unit_s: float,
    ) -> NDArray[np.float32]:
        """Costs (K, P, S, W) of every step in every unit, infinite where it must not be."""
        still = [o.boxes_m[0] for o in obstacles if (o.boxes_m == o.boxes_m[0]).all()]
        deep = np.zeros(self._shape, dtype=np.float32)
        for box in still:
            deep = np.maximum(deep, self._depth(box, gap_m))
        self._depth_of_obstacles = deep
        own = np.where(free & (deep <= self._overlap_max_m), _OVERLAP_COST * weight / 10.0 * deep, np.inf)
        left = LEVEL_M * (self._last[:, None] - np.arange(self._shape[1])[None, :])  # (P, S)
        out = np.empty((self.units, *self._shape), dtype=np.float32)
        for unit in range(self.units):
            away = ((self._points - guide.points_m[unit + 1]) ** 2).sum(axis=-1)
            if self.stops and (self.units - unit) * unit_s <= _LATE_S:
                away = away + _LATE_COST * unit_s * np.maximum(left, 0.0)
            out[unit] = own + (weight * away)[:, self._at]
            for obstacle in obstacles:
                box = obstacle.boxes_m[self.first_unit + unit]
                if not np.isnan(box).any() and not (obstacle.boxes_m == obstacle.boxes_m[0]).all():
                    out[unit] += np.where(self._depth(box, gap_m) > 0.0, np.inf, 0.0)
        return out

    def _depth(self, box_m: FloatArray, gap_m: float) -> NDArray[np.float32]:
        """How far (P, S, W) [m] the cubes of steps reach into a box grown by the gap."""
        x_min, x_max, y_min, y_max = self._cubes
        across = np.minimum(np.float32(box_m[1] + gap_m) - x_min, x_max - np.float32(box_m[0] - gap_m))
        along = np.minimum(np.float32(box_m[3] + gap_m) - y_min, y_max - np.float32(box_m[2] - gap_m))
        return np.asarray(np.maximum(np.minimum(across, along), np.float32(0.0)))

    def _first_steps(self, speed_mps: float, unit_s: float) -> Mask:
        """First steps (W,) that follow from the speed at the start."""
        cruising, half = speed_mps * unit_s / LEVEL_M, 0.51
        steps = np.arange(self._shape[2])
        first = (steps >= cruising - self._fewer / 2.0 - half) & (steps <= cruising + self._more / 2.0 + half)
        if not first.any():
            first[-1] = True
        return np.asarray(first)

    def _end_cost(self, path: int | NDArray[np.int64], place: NDArray[np.int64]) -> FloatArray:
        if not self.stops:
            return np.zeros(np.shape(place))
        return np.asarray(_MISS_COST * LEVEL_M * np.maximum(self._last[path] - place, 0))

    def _arriving(self, costs: NDArray[np.float32]) -> NDArray[np.float32]:
        """A view (P, S, W) by the place where a step ended, of costs (P, W + S, W) by where it began."""
        inner = costs[:, self._shape[2] :]
        per_path, per_place, per_step = inner.strides
        return as_strided(inner, self._shape, (per_path, per_place, per_step - per_place), writeable=False)

    def _traced(self, costs: NDArray[np.float32]) -> Motion | None:
        steps = self._shape[2]
        numbers = np.arange(len(self.paths))[:, None, None]
        final = costs[-1, :, steps:] + self._end_cost(numbers, self._to[None])
        if self.stops:
            final[:, :, 2:] += _MISS_COST
        path, place, step = (int(i) for i in np.unravel_index(int(np.argmin(final)), final.shape))
        cost = float(final[path, place, step])
        if not np.isfinite(cost):
            return None
        places = [place + step, place]
        for unit in range(self.units - 2, -1, -1):
            before = np.arange(max(0, step - self._more), min(steps - 1, step + self._fewer, place) + 1)
            step = int(before[np.argmin(costs[unit, path, steps + place - before, before])])
            place -= step
            places.append(place)
        found = np.array(places[::-1])
        cubes = self._cubes[:, path, found[:-1], np.diff(found)].T.astype(np.float64)
        return Motion(path, found, cubes, cost)
