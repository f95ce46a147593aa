"""Motions of all vehicles that keep clear of each other: best responses, then large neighbourhoods.

After MAPF-LNS2 (Li et al. 2022): a pair in conflict and up to four others are taken out and planned anew one
after the other in random order; the change is kept where the conflicts do not become more.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from istc_replay.corridors.seed.lattice import Lattice, Met, Motion
from istc_replay.datatypes import FloatArray

#: Prices of a unit in conflict, from sweep to sweep of best responses, and in neighbourhoods.
_PRICES = (1000.0, 10_000.0, 100_000.0)
_DEAR = 1e6
_ROUNDING_M = 1e-3
_MOST_OTHERS = 4
#: Improvements last this many times longer while somebody does not arrive.
_PATIENCE = 4
#: Motions of another for which it is kept by which moves it is met.
_KEPT = 4
#: Cars that were handed over may seem so much nearer to each other in so many units [m].
_SEAM_M, _SEAM_UNITS = 0.5, 3


@dataclass(slots=True)
class Repair:
    """The motions, while they are being repaired; equal seeds give equal motions."""

    lattices: Sequence[Lattice]
    gap_m: float
    seed: int
    motions: list[Motion] = field(default_factory=list)
    rounds: int = 0
    no_way: int | None = None  # a vehicle without any motion
    _barred: set[int] = field(default_factory=set)
    _wider_m: dict[tuple[int, int], FloatArray] = field(default_factory=dict)
    # Motions by their numbers: equal motions of a vehicle have the same.
    _versions: list[int] = field(default_factory=list)
    _numbers: dict[tuple[int, int, bytes], int] = field(default_factory=dict)
    _meetings: dict[tuple[int, int], dict[int, Met]] = field(default_factory=dict)
    _conflicts: dict[tuple[int, int], tuple[tuple[int, int], list[int]]] = field(default_factory=dict)
    _planned: dict[tuple[int, float, frozenset[int]], Motion | None] = field(default_factory=dict)
    _random: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        # Where the plan before has led cars close to each other, places of half a metre keep them less apart
        # than they are: what is missed there is layer 1's to mend.
        for pair in combinations([n for n, lattice in enumerate(self.lattices) if lattice.handed], 2):
            self._wider_m[pair] = np.zeros(self._units)
            self._wider_m[pair][:_SEAM_UNITS] = -_SEAM_M

    @property
    def _units(self) -> int:
        return max(lattice.first_unit + lattice.units for lattice in self.lattices)

    def run(self, budget: int, improvements: int) -> bool:
        """Repair within `budget` rounds, then improve; False where conflicts are left or no way is found.

        After `bar` and `keep_apart` it goes on from the motions there are.
        """
        everyone = range(len(self.lattices))
        if not self.motions:
            for number in everyone:
                self._replan(number, 0.0, ())
            if self.no_way is not None:
                return False
            self._respond()
        for number in sorted(self._barred):
            self._replan(number, _DEAR, everyone)
        if self.no_way is not None:
            return False
        self._barred.clear()
        self._mend(self.rounds + budget)
        if self.conflicts():
            return False
        self._improve(improvements)
        return True

    def bar(self, number: int, unit: int) -> None:
        """Have a vehicle not pass where it does in a unit: layer 1 cannot keep it off what stands there."""
        lattice = self.lattices[number]
        lattice.bar(self.motions[number], unit - lattice.first_unit)
        self._barred.add(number)
        self._planned.clear()

    def slow(self, number: int, unit: int) -> None:
        """Have a vehicle pass more slowly or elsewhere where it is in a unit: layer 2 cannot drive it so."""
        lattice = self.lattices[number]
        lattice.slow(self.motions[number], unit - lattice.first_unit)
        self._barred.add(number)
        self._planned.clear()

    def keep_apart(self, first: int, second: int, unit: int, more_m: float) -> None:
        """Have two vehicles keep more than the gap in a unit: layer 1 finds them nearer than here."""
        pair = min(first, second), max(first, second)
        wider = self._wider_m.setdefault(pair, np.zeros(self._units))
        wider[unit] += more_m
        self._planned.clear()
        for key in (pair, pair[::-1]):
            self._meetings.pop(key, None)
            self._conflicts.pop(key, None)

    @property
    def cost(self) -> float:
        """What all motions cost, conflicts left aside."""
        return sum(
            lattice.own_cost(motion) for lattice, motion in zip(self.lattices, self.motions, strict=True)
        )

    @property
    def arrives(self) -> bool:
        """Whether everybody stands at its goal in the end."""
        return all(
            lattice.arrives(motion) for lattice, motion in zip(self.lattices, self.motions, strict=True)
        )

    def conflicts(self) -> dict[tuple[int, int], list[int]]:
        """Pairs of vehicles in conflict, and the units."""
        found = {}
        for i, j in combinations(range(len(self.motions)), 2):
            units = self._meeting(i, j)
            if units:
                found[i, j] = units
        return found

    def _meeting(self, i: int, j: int) -> list[int]:
        """The units in which two vehicles are in conflict."""
        versions = self._versions[i], self._versions[j]
        known = self._conflicts.get((i, j))
        if known is None or known[0] != versions:
            known = self._conflicts[i, j] = (versions, self._found_meeting(i, j))
        return known[1]

    def _found_meeting(self, i: int, j: int) -> list[int]:
        first = max(self.lattices[i].first_unit, self.lattices[j].first_unit)
        a = self.motions[i].cubes_m[first - self.lattices[i].first_unit :]
        b = self._kept_clear_m(i, j)[first - self.lattices[j].first_unit :]
        common = min(len(a), len(b))
        a, b, gap = a[:common], b[:common], self.gap_m - _ROUNDING_M
        over_x = (a[:, 0] < b[:, 1] + gap) & (b[:, 0] < a[:, 1] + gap)
        over_y = (a[:, 2] < b[:, 3] + gap) & (b[:, 2] < a[:, 3] + gap)
        return [first + int(unit) for unit in np.flatnonzero(over_x & over_y)]

    def _kept_clear_m(self, number: int, other: int) -> FloatArray:
        """Cubes (K, 4) of another, larger by what the two keep apart beyond the gap."""
        cubes, first = self.motions[other].cubes_m, self.lattices[other].first_unit
        wider = self._wider_m.get((min(number, other), max(number, other)))
        if wider is None:
            return cubes
        return np.asarray(cubes + wider[first : first + len(cubes), None] * [-1.0, 1.0, -1.0, 1.0])

    def _respond(self) -> None:
        """Best responses in random order, conflicts growing dearer."""
        everyone = range(len(self.lattices))
        for price in _PRICES:
            for number in self._random.permutation(len(self.lattices)):
                if not self.conflicts():
                    return
                self._replan(int(number), price, everyone)

    def _mend(self, budget: int) -> None:
        conflicts = self.conflicts()
        while conflicts and self.rounds < budget:
            self.rounds += 1
            before = list(self.motions), list(self._versions)
            self._plan_anew(self._neighbourhood(conflicts))
            after = self.conflicts()
            if sum(map(len, after.values())) > sum(map(len, conflicts.values())):
                self.motions, self._versions = before
            else:
                conflicts = after

    def _neighbourhood(self, conflicts: dict[tuple[int, int], list[int]]) -> list[int]:
        """A pair in conflict and up to four others, those first that meet it too."""
        pairs = list(conflicts)
        pair = pairs[int(self._random.integers(len(pairs)))]
        others = [int(v) for v in self._random.permutation(len(self.lattices)) if v not in pair]
        involved = {v for p in pairs if set(p) & set(pair) for v in p}
        others.sort(key=lambda v: v not in involved)
        part = [*pair, *others[: int(self._random.integers(_MOST_OTHERS + 1))]]
        return [part[int(i)] for i in self._random.permutation(len(part))]

    def _improve(self, rounds: int) -> None:
        """Neighbourhoods again, for a lower cost, and longer while somebody does not arrive."""
        cost, everyone = self.cost, len(self.lattices)
        for number in range(_PATIENCE * rounds if everyone > 1 else 0):
            if number >= rounds and self.arrives:
                break
            before = list(self.motions), list(self._versions)
            size = int(self._random.integers(1, min(4, everyone + 1)))
            self._plan_anew([int(v) for v in self._random.permutation(everyone)[:size]])
            after = self.cost
            if after >= cost or self.conflicts():
                self.motions, self._versions = before
            else:
                cost = after

    def _plan_anew(self, part: Sequence[int]) -> None:
        present = [v for v in range(len(self.lattices)) if v not in part]
        for number in part:
            self._replan(number, _DEAR, present)
            present.append(number)

    def _replan(self, number: int, price: float, others: Iterable[int]) -> None:
        motion = self._best(number, price, [other for other in others if other != number])
        if motion is None:
            self.no_way = number
            return
        key = number, motion.path, motion.places.tobytes()
        version = self._numbers.setdefault(key, len(self._numbers))
        if number < len(self.motions):
            self.motions[number], self._versions[number] = motion, version
        else:
            self.motions.append(motion)
            self._versions.append(version)

    def _best(self, number: int, price: float, others: Sequence[int]) -> Motion | None:
        """The cheapest motion beside those of others; neighbourhoods ask for the same again and again."""
        key = number, price, frozenset(self._versions[other] for other in others)
        if key not in self._planned:
            met = [self._met(number, other) for other in others]
            self._planned[key] = self.lattices[number].best(met, price)
        return self._planned[key]

    def _met(self, number: int, other: int) -> Met:
        """The moves by which a vehicle meets another's motion."""
        known = self._meetings.setdefault((number, other), {})
        version = self._versions[other]
        if version not in known:
            cubes, first = self._kept_clear_m(number, other), self.lattices[other].first_unit
            known[version] = self.lattices[number].meeting(cubes, first, self.gap_m)
            if len(known) > _KEPT:
                del known[next(iter(known))]
        return known[version]
