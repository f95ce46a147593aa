"""The best motion of one vehicle over (step, place, path), by exact dynamic programming.

Shapes: K units, W steps, S places, P paths, as of `moves`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from istc_replay.corridors.seed.moves import ROUNDING_M, Moves, stands
from istc_replay.corridors.seed.paths import LEVEL_M, SeedPath
from istc_replay.datatypes import FloatArray, Guidance, Obstacle, Participant

# Costs, in those of eq. (3) at a weight of 10.
_LENGTH_COST = 200.0  # of a metre more than the guidance has
_MISS_COST = 3000.0  # of a metre short of the goal
_LATE_COST = 60.0  # the same in each of the last units
_OVERLAP_COST = 5000.0  # of a metre of overlap with an obstacle: layer 1 can mend a little
_LATE_S = 2.0

#: Overlaps up to the first are rounding of places; who has no other way may go as deep as the second.
CLEAR_M, DEEPEST_M = 0.6, 2.0
#: Steps from so many places about one that is barred are barred with it.
_BESIDE = 2

Costs = NDArray[np.float32]
#: Moves by their number, of each unit.
Met = list[NDArray[np.int64]]


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
    moves : Moves
        What it can do in a unit.
    unit_s : float
        Length of a time unit.
    obstacles, gap_m
        What to keep clear of: layer 1 can mend a small overlap, which costs.
    weight : float
        Of a squared distance from the guidance, eta times omega_ref.
    """

    def __init__(
        self,
        participant: Participant,
        guide: Guidance,
        moves: Moves,
        unit_s: float,
        obstacles: Sequence[Obstacle],
        gap_m: float,
        weight: float,
        stops: bool,
        overlap_max_m: float = DEEPEST_M,
    ) -> None:
        self._moves = moves
        self.first_unit, self.units = participant.first_unit, participant.units
        self.stops, self._overlap_max_m = stops, overlap_max_m
        self._goes_on, self.handed = participant.goes_on, participant.ahead is not None
        self._cost = self._costs(guide, obstacles, gap_m, weight, unit_s)
        lengths = np.array([path.length_m for path in moves.paths])
        longer = np.maximum(lengths - lengths[0], 0.0)
        self._extra = (_LENGTH_COST * weight / 10.0 * longer).astype(np.float32)
        self._first = moves.first_steps()
        self._furthest = moves.furthest(self.units)
        self._end_cost = self._end_costs()
        steps, places, paths = moves.shape
        # (K, W, W + S, P): least cost up to the end of a move; what is never reached stays infinite, as do
        # the places before the start. It is written anew for every motion.
        self._least = np.full((self.units, steps, steps + places, paths), np.inf, dtype=np.float32)

    @property
    def paths(self) -> Sequence[SeedPath]:
        """The candidate paths."""
        return self._moves.paths

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(K, W, S, P)."""
        return (self.units, *self._moves.shape)

    def poses(self, motion: Motion) -> FloatArray:
        """Poses (K+1, 3) of a motion at the units' ends."""
        return np.asarray(self.paths[motion.path].poses[motion.places])

    def slack_rad(self, motion: Motion) -> FloatArray:
        """Heading slack (K+1,) of the car-boxes of a motion."""
        return np.asarray(self._moves.slack_rad[motion.places, motion.path])

    def fastest_mps(self, motion: Motion) -> FloatArray:
        """Largest speed (K,) that a motion's path allows in each unit."""
        speeds = self.paths[motion.path].speeds_mps[motion.places]
        return np.asarray(np.minimum(speeds[:-1], speeds[1:]))

    def meeting(self, cubes_m: FloatArray, first_unit: int, gap_m: float) -> Met:
        """The moves that come nearer than the gap to another's cubes, unit by unit."""
        first = max(0, first_unit - self.first_unit)
        end = min(self.units, first_unit - self.first_unit + len(cubes_m))
        none = np.zeros(0, dtype=np.int64)
        if first >= end:
            return [none] * self.units
        theirs = cubes_m[first + self.first_unit - first_unit : end + self.first_unit - first_unit]
        met = self._moves.meeting(theirs, gap_m - ROUNDING_M, self._furthest[first:end])
        return [none] * first + met + [none] * (self.units - end)

    def best(self, others: Sequence[Met], price: float) -> Motion | None:
        """The cheapest motion where a move costs a price for everyone that it meets; None: no way."""
        steps = self._moves.shape[0]
        for unit, furthest in enumerate(self._furthest):
            least = self._least[unit, :, steps : steps + furthest + 1]
            if unit == 0:
                least[:, 0] = np.where(self._first[:, None], self._cost[0, :, 0], np.inf)
                self._add_prices(0, others, price)
                least += self._extra
                continue
            before = self._arriving(unit - 1, furthest + 1)
            least[:] = before
            for less in range(1, self._moves.fewer + 1):
                np.minimum(least[:-less], before[less:], out=least[:-less])
            for more in range(1, self._moves.more + 1):
                np.minimum(least[more:], before[:-more], out=least[more:])
            least += self._cost[unit, :, : furthest + 1]
            self._add_prices(unit, others, price)
        return self._traced()

    def own_cost(self, motion: Motion) -> float:
        """What a motion costs without any price."""
        steps = np.diff(motion.places)
        along = self._cost[np.arange(self.units), steps, motion.places[:-1], motion.path]
        missed = max(int(self._moves.last[motion.path] - motion.places[-1]), 0) if self.stops else 0
        return float(along.sum() + self._extra[motion.path] + _MISS_COST * LEVEL_M * missed)

    def arrives(self, motion: Motion) -> bool:
        """Whether a motion that stops at its goal stands there in the last unit."""
        return not self.stops or bool(motion.places[-2] >= self._moves.last[motion.path] - 1)

    def bar(self, motion: Motion, row: int) -> None:
        """Leave out a motion's step of one unit, and those beside it that reach as deep into an obstacle."""
        path, place = motion.path, int(motion.places[row])
        step = int(motion.places[row + 1]) - place
        near = slice(max(0, place - _BESIDE), place + _BESIDE + 1)
        depth, deepest = self._moves.deep[:, near, path], self._moves.deep[step, place, path]
        self._cost[:, step, place, path] = np.inf
        if deepest > ROUNDING_M:
            self._cost[:, :, near, path][:, depth >= deepest - ROUNDING_M] = np.inf

    def slow(self, motion: Motion, row: int) -> None:
        """Leave out a motion's last move up to a unit, and faster ones, from places beside it."""
        steps = np.diff(motion.places)
        moving = np.flatnonzero(steps[: row + 1])
        row = int(moving[-1]) if len(moving) else row
        place = int(motion.places[row])
        near = slice(max(0, place - _BESIDE), place + _BESIDE + 1)
        self._cost[:, max(1, int(steps[row])) :, near, motion.path] = np.inf

    def _costs(
        self, guide: Guidance, obstacles: Sequence[Obstacle], gap_m: float, weight: float, unit_s: float
    ) -> Costs:
        """Costs (K, W, S, P) of every move in every unit, infinite where it must not be."""
        moves = self._moves
        allowed = moves.free & (moves.deep <= self._overlap_max_m)
        own = np.where(allowed, _OVERLAP_COST * weight / 10.0 * moves.deep, np.inf).astype(np.float32)
        left = LEVEL_M * (moves.last - np.arange(moves.shape[1])[:, None])  # (S, P)
        moving = [obstacle for obstacle in obstacles if not stands(obstacle)]
        x, y = (np.ascontiguousarray(moves.points_m[..., axis]) for axis in (0, 1))
        out = np.empty((self.units, *moves.shape), dtype=np.float32)
        for unit in range(self.units):
            away = (x - guide.points_m[unit + 1, 0]) ** 2 + (y - guide.points_m[unit + 1, 1]) ** 2
            if self.stops and (self.units - unit) * unit_s <= _LATE_S:
                away = away + _LATE_COST * unit_s * np.maximum(left, 0.0)
            np.add(own, moves.onward((weight * away).astype(np.float32)), out=out[unit])
            for obstacle in moving:
                box = obstacle.boxes_m[self.first_unit + unit]
                if not np.isnan(box).any():
                    out[unit] += np.where(moves.depth(box, gap_m) > 0.0, np.inf, 0.0).astype(np.float32)
        return out

    def _end_costs(self) -> FloatArray:
        """What last moves (W, places within reach, P) cost by where they end, and for not standing there."""
        steps, _, paths = self._moves.shape
        places = np.arange(self._furthest[-1] + 1)[:, None]
        cost = np.zeros((steps, len(places), paths))
        if self.stops:
            ends = np.arange(steps)[:, None, None] + places
            cost += _MISS_COST * LEVEL_M * np.maximum(self._moves.last - ends, 0)
            cost[2:] += _MISS_COST
        if self._goes_on:  # it has to be able to stand then
            cost[self._moves.braked_step + 1 :] = np.inf
        return cost

    def _add_prices(self, unit: int, others: Sequence[Met], price: float) -> None:
        """Add the price once for everyone that a move of a unit meets."""
        least = self._least[unit].reshape(-1)
        for met in others:
            least[met[unit]] += np.float32(price)

    def _arriving(self, unit: int, places: int) -> Costs:
        """A view (W, places, P) by the place where a move ended of the costs up to its end."""
        steps, _, paths = self._moves.shape
        per_step, per_place, per_path = self._least.strides[1:]
        strides = per_step - per_place, per_place, per_path
        return as_strided(self._least[unit, :, steps:], (steps, places, paths), strides, writeable=False)

    def _traced(self) -> Motion | None:
        """The motion that ends at the least cost, from its end back."""
        moves, steps = self._moves, self._moves.shape[0]
        final = self._least[-1, :, steps : steps + self._furthest[-1] + 1] + self._end_cost
        cost = float(final.min())
        if not np.isfinite(cost):
            return None
        path, place, step = min((p, s, w) for w, s, p in np.argwhere(final == cost).tolist())
        found = [place + step, place]
        for unit in range(self.units - 2, -1, -1):
            least, most = max(0, step - moves.more), min(steps - 1, step + moves.fewer, place)
            before = np.arange(least, most + 1)
            step = int(before[np.argmin(self._least[unit, before, steps + place - before, path])])
            place -= step
            found.append(place)
        motion = np.array(found[::-1])
        cubes = moves.cubes_m[:, np.diff(motion), motion[:-1], path].T.astype(np.float64)
        return Motion(path, motion, cubes, cost)
