"""Motions of all vehicles that keep clear of each other: best responses, then large neighbourhoods.

After MAPF-LNS2 (Li et al. 2022): a pair in conflict and up to two others are taken out and planned anew one
after the other in random order; the change is kept where the conflicts do not become more.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations, count

import numpy as np
from numpy.typing import NDArray

from istc_replay.corridors.seed.lattice import Lattice, Motion

#: Prices of a unit in conflict, from sweep to sweep of best responses, and in neighbourhoods.
_PRICES = (1000.0, 10_000.0, 100_000.0)
_DEAR = 1e6
_ROUNDING_M = 1e-3
_MOST_OTHERS = 2


@dataclass(slots=True)
class Repair:
    """The motions, while they are being repaired; equal seeds give equal motions."""

    lattices: Sequence[Lattice]
    gap_m: float
    seed: int
    motions: list[Motion] = field(default_factory=list)
    rounds: int = 0
    _versions: list[int] = field(default_factory=list)
    _overlaps: dict[tuple[int, int], tuple[int, NDArray[np.uint8]]] = field(default_factory=dict)
    _random: np.random.Generator = field(init=False)
    _numbers: Iterator[int] = field(default_factory=count)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def run(self, budget: int, improvements: int) -> bool:
        """Repair within `budget` rounds, then improve; False where conflicts are left or no way is found."""
        alone = [lattice.best(self._penalty(number, 0.0, ())) for number, lattice in enumerate(self.lattices)]
        if any(motion is None for motion in alone):
            return False
        self.motions = [motion for motion in alone if motion is not None]
        self._versions = [next(self._numbers) for _ in self.motions]
        self._respond()
        self._mend(budget)
        if self.conflicts():
            return False
        self._improve(improvements)
        return True

    @property
    def cost(self) -> float:
        """What all motions cost, conflicts left aside."""
        return sum(
            lattice.own_cost(motion) for lattice, motion in zip(self.lattices, self.motions, strict=True)
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
        first = max(self.lattices[i].first_unit, self.lattices[j].first_unit)
        a, b = (self.motions[v].cubes_m[first - self.lattices[v].first_unit :] for v in (i, j))
        common = min(len(a), len(b))
        a, b, gap = a[:common], b[:common], self.gap_m - _ROUNDING_M
        over_x = (a[:, 0] < b[:, 1] + gap) & (b[:, 0] < a[:, 1] + gap)
        over_y = (a[:, 2] < b[:, 3] + gap) & (b[:, 2] < a[:, 3] + gap)
        return [first + int(unit) for unit in np.flatnonzero(over_x & over_y)]

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
        """A pair in conflict and up to two others, those first that meet it too."""
        pairs = list(conflicts)
        pair = pairs[int(self._random.integers(len(pairs)))]
        others = [int(v) for v in self._random.permutation(len(self.lattices)) if v not in pair]
        involved = {v for p in pairs if set(p) & set(pair) for v in p}
        others.sort(key=lambda v: v not in involved)
        part = [*pair, *others[: int(self._random.integers(_MOST_OTHERS + 1))]]
        return [part[int(i)] for i in self._random.permutation(len(part))]

    def _improve(self, rounds: int) -> None:
        """Neighbourhoods again, for a lower cost."""
        cost, everyone = self.cost, len(self.lattices)
        for _ in range(rounds if everyone > 1 else 0):
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
        motion = self.lattices[number].best(self._penalty(number, price, others))
        if motion is not None:
            self.motions[number] = motion
            self._versions[number] = next(self._numbers)

    def _penalty(self, number: int, price: float, others: Iterable[int]) -> NDArray[np.float32]:
        """Price (K, P, S, W) of meeting others."""
        lattice = self.lattices[number]
        total = np.zeros(lattice.shape, dtype=np.uint8)
        for other in others:
            if other != number:
                total += self._overlap(number, other)
        return np.float32(price) * total

    def _overlap(self, number: int, other: int) -> NDArray[np.uint8]:
        known = self._overlaps.get((number, other))
        if known is None or known[0] != self._versions[other]:
            cubes, first = self.motions[other].cubes_m, self.lattices[other].first_unit
            found = self.lattices[number].overlaps(cubes, first, self.gap_m)
            known = self._overlaps[number, other] = (self._versions[other], found)
        return known[1]
