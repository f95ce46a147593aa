"""Stage B: the options of the largest cubes around fixed pivotal points.

Most separations have one option left then. What shares no wall is chosen apart: few combinations of options
are tried one by one, each a small LP; the others are one MILP.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import daqp
import numpy as np
import pyomo.environ as pyo

from istc_replay.corridors.miqp import add_separations, add_variables, linear_sum
from istc_replay.corridors.problem import CONSTANT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from istc_replay.corridors.problem import BoolArray, CorridorProblem, IntArray, Separations
    from istc_replay.datatypes import FloatArray

#: Bounds of fixed pivotal points decide a separation only by more than this.
_DECISIVE_M = 1e-6
#: Starting CBC takes as long as some hundred small LPs.
_TRIED = 16
_UNBOUNDED = 1e30


@dataclass(slots=True)
class SizeProblem:
    """Walls around fixed pivotal points.

    `choice` (D,) has the option of every separation, as far as it is known. Those of `open` (numbers of
    separations) have several left, or share walls with one that has: what is `left` of them, in their order.
    `lower`, `upper` are bounds of all walls; `weight` is what eq. (2) counts of each.
    """

    choice: IntArray
    open: IntArray
    left: Separations
    lower: FloatArray
    upper: FloatArray
    weight: FloatArray

    def settle_small(self) -> None:
        """Choose where there are few combinations of options among separations tied by walls."""
        settled = np.zeros(len(self.open), dtype=bool)
        for tied in _tied_apart(self.left):
            options = [np.flatnonzero(row).tolist() for row in self.left.possible[tied]]
            if np.prod([float(len(some)) for some in options]) <= _TRIED:
                self.choice[self.open[tied]] = self._tried(self.left.taken(tied), options)
                settled[tied] = True
        self.open, self.left = self.open[~settled], self.left.taken(~settled)

    def _tried(self, table: Separations, options: Sequence[Sequence[int]]) -> tuple[int, ...]:
        """The combination of options with the largest cubes: each is an LP of the walls that it names."""
        walls = _walls(table)
        walls = np.unique(walls[walls != CONSTANT])
        column = {wall: number for number, wall in enumerate([*walls.tolist(), CONSTANT])}
        count, size = len(table), len(walls)
        best, least = tuple(some[0] for some in options), np.inf
        for choice in product(*options):
            at = np.arange(count), np.array(choice)
            rows = np.zeros((count, size + 1))  # the last column takes the constants
            rows[at[0], [column[w] for w in table.larger[at].tolist()]] = 1.0
            rows[at[0], [column[w] for w in table.smaller[at].tolist()]] = -1.0
            lower = np.concatenate([self.lower[walls], table.gap[at]])
            upper = np.concatenate([self.upper[walls], np.full(count, _UNBOUNDED)])
            own = np.ascontiguousarray(rows[:, :size])
            _, value, flag, _ = daqp.solve(None, self.weight[walls], own, upper, lower)
            if flag > 0 and value < least:
                best, least = choice, value
        return best

    def milp(self) -> Any:
        """What is open as a Pyomo model."""
        walls = _walls(self.left)
        walls = np.unique(walls[walls != CONSTANT])
        model = pyo.ConcreteModel("cube sizes")
        add_variables(model, walls.tolist(), self.lower, self.upper)
        add_separations(model, self.left, self.lower, self.upper, None)
        model.objective = pyo.Objective(
            expr=linear_sum([model.z[i] for i in walls.tolist()], self.weight[walls].tolist()), doc="eq. (2)"
        )
        return model

    def settle(self, model: Any) -> None:
        """Choose the options that the solution of `milp` meets best."""
        z = np.zeros(len(self.lower))
        for index, variable in model.z.items():
            z[index] = variable.value
        self.choice[self.open] = self.left.best(z)
        self.open, self.left = self.open[:0], self.left.taken(self.open[:0])


def size_problem(problem: CorridorProblem, z: FloatArray) -> SizeProblem:
    """Fix pivotal points at z: bounds of walls, and the separations left.

    Every row has at most one wall (our reading, not the printed rows).
    """
    lower, upper = np.array(problem.lower), np.array(problem.upper)
    pivots = problem.pivot_indices
    lower[pivots] = upper[pivots] = z[pivots]
    rows = problem.rows
    is_wall = np.append(problem.quadratic == 0.0, False)[rows.index]
    which, entry = np.nonzero(is_wall)
    wall, weight = rows.index[which, entry], rows.weight[which, entry]
    rest = rows.value(np.where(problem.quadratic > 0.0, z, 0.0))[which]
    sides = np.stack([rows.lower[which] - rest, rows.upper[which] - rest], axis=-1) / weight[:, None]
    np.maximum.at(lower, wall, sides.min(axis=1))
    np.minimum.at(upper, wall, sides.max(axis=1))
    upper = np.maximum(lower, upper)  # they may cross by rounding
    left, kept = problem.separations.undecided(lower, upper, _DECISIVE_M)
    # What bounds decide holds however far out walls are.
    choice = problem.separations.best(np.where(problem.linear > 0.0, lower, upper))
    choice[kept] = np.where(left.possible, left.slack(problem.least_cubes(z)), -np.inf).argmax(axis=1)
    tied = _tied_to(left.possible.sum(axis=1) > 1, _walls(left))
    return SizeProblem(choice, kept[tied], left.taken(tied), lower, upper, problem.linear)


def _walls(table: Separations) -> IntArray:
    """The walls (D, 8) of possible options; CONSTANT in place of others."""
    walls = np.concatenate([table.larger, table.smaller], axis=1)
    return np.where(np.tile(table.possible, 2), walls, CONSTANT)


def _tied_to(some: BoolArray, walls: IntArray) -> BoolArray:
    """Which separations (D,) share walls (D, 8) with some of them, or with others that do."""
    tied = np.array(some)
    while True:
        ours = np.unique(walls[tied])
        more = tied | (np.isin(walls, ours) & (walls != CONSTANT)).any(axis=1)
        if np.array_equal(more, tied):
            return tied
        tied = more


def _tied_apart(table: Separations) -> Iterator[IntArray]:
    """Numbers of the separations that are tied together by walls, part by part."""
    walls, untold = _walls(table), np.ones(len(table), dtype=bool)
    while untold.any():
        first = np.arange(len(table)) == untold.argmax()
        tied = _tied_to(first, walls)
        untold &= ~tied
        yield np.flatnonzero(tied)
