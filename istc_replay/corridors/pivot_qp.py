"""The convex QP of the pivotal points alone, with rows for the options chosen so far.

Vehicles that no chosen option ties together are solved apart: choosing an option solves again only
the vehicles that it ties, and keeps the others' parts of the solution.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import daqp
import numpy as np

from istc_replay.corridors.pivot_rows import PivotRows
from istc_replay.corridors.problem import CONSTANT

if TYPE_CHECKING:
    from istc_replay.corridors.problem import CorridorProblem, IntArray
    from istc_replay.datatypes import FloatArray

_OPTIMAL = (1, 2)  # DAQP's exit flags of an optimal solution
_UNBOUNDED = 1e30

#: Options chosen so far: (separation, option).
Choice = tuple[int, int]
Choices = tuple[Choice, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Vehicles tied together: their numbers, the options that tie them, and the QP's solution.

    `y` are the scaled variables; `multipliers` are of their bounds and rows and then of the options.
    """

    members: tuple[int, ...]
    choices: Choices
    cost: float
    y: FloatArray
    multipliers: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PivotSolution:
    """A solution by parts: its cost, eq. (3), and which part each vehicle belongs to."""

    cost: float
    parts: tuple[Part, ...]

    @property
    def choices(self) -> Choices:
        """All options chosen."""
        return tuple(choice for part in self.parts for choice in part.choices)


@dataclass(frozen=True, slots=True, eq=False)
class _Option:
    """Up to four rows of an option: place of each entry, its weight, and the lower bounds."""

    row: IntArray
    column: IntArray
    weight: FloatArray
    lower: FloatArray


class PivotQp:
    """Minimise eq. (3) over the pivotal points of some vehicles such that the chosen options hold.

    The least cube of a unit is the hull of the car-boxes at its two pivotal points, so an option
    is at most four linear rows: every point of one side from every point of the other.
    Variables are scaled to a unit Hessian about the reference, z = reference + y / root: DAQP's own
    form. DAQP is given the rows that are watched (`pivot_rows`).
    """

    def __init__(self, problem: CorridorProblem) -> None:
        self._problem = problem
        pivots = problem.pivot_indices
        sizes = [2 * block.units for block in problem.blocks]
        self._start = np.concatenate([[0], np.cumsum(sizes)])
        self._vehicle = np.repeat(np.arange(len(sizes)), sizes)
        self._pivots = pivots
        self._column = np.full(problem.size + 1, CONSTANT, dtype=np.int64)
        self._column[pivots] = np.arange(len(pivots))
        self._root = np.sqrt(2.0 * problem.quadratic[pivots])
        self._reference = problem.reference[pivots]
        self._rows = PivotRows(problem, self._root)
        self._options: dict[Choice, _Option] = {}
        self._held = np.zeros(len(problem.blocks), dtype=bool)
        self._around = np.zeros(problem.size)

    def beside(self, z: FloatArray, free: tuple[int, ...]) -> PivotQp:
        """The same QP for some vehicles alone, with all others where z has them."""
        other = copy(self)
        other._options = {}
        other._held = ~np.isin(np.arange(len(self._held)), free)
        other._around = np.array(z)
        other._around[self._pivots[self._columns(free)]] = 0.0
        return other

    def z(self, solution: PivotSolution) -> FloatArray:
        """The solution's pivotal points in z; what is not part of it is 0, or as held."""
        z = np.array(self._around)
        for part in solution.parts:
            at = self._columns(part.members)
            z[self._pivots[at]] = self._reference[at] + part.y / self._root[at]
        return z

    def price(self, separation: int, option: int) -> float:
        """What enforcing an option costs at least a squared metre of violation.

        The optimum is a projection in y: every solution that moves by d costs d^2 / 2 more.
        """
        table, q = self._problem.separations, self._problem.quadratic
        walls = table.larger[separation, option], table.smaller[separation, option]
        compliance = 0.0
        for wall in walls:
            if wall != CONSTANT:
                columns = [(p, self._column[p]) for p in self._problem.witness[wall].tolist()]
                free = [p for p, c in columns if c != CONSTANT and not self._held[self._vehicle[c]]]
                compliance += max((1.0 / float(q[p]) for p in free), default=0.0)
        return 1.0 / compliance if compliance > 0.0 else np.inf

    def root(self, members: tuple[int, ...], choices: Choices, limit: float = np.inf) -> PivotSolution | None:
        """Solve with these options from scratch, or return None where they contradict each other."""
        parts: list[Part] = []
        of = {vehicle: {vehicle} for vehicle in members}
        for separation, _ in choices:
            tied = set.union(*(of[v] for v in self._concerned(separation)))
            of |= dict.fromkeys(tied, tied)
        for group in dict.fromkeys(tuple(sorted(of[vehicle])) for vehicle in members):
            own = tuple(c for c in choices if self._concerned(c[0])[0] in group)
            part = self._solve(group, own, None, limit - sum(p.cost for p in parts))
            if part is None:
                return None
            parts.append(part)
        return PivotSolution(sum(part.cost for part in parts), tuple(parts))

    def with_option(
        self, solution: PivotSolution, choice: Choice, limit: float = np.inf
    ) -> PivotSolution | None:
        """Add an option; None where that contradicts the others, or costs more than `limit` for sure."""
        concerned = self._concerned(choice[0])
        tied = [part for part in solution.parts if any(v in part.members for v in concerned)]
        rest = [part for part in solution.parts if all(part is not other for other in tied)]
        others = sum(part.cost for part in rest)
        members = tuple(sorted(v for part in tied for v in part.members))
        choices = (*(c for part in tied for c in part.choices), choice)
        part = self._solve(members, choices, tied, limit - others)
        return None if part is None else PivotSolution(others + part.cost, (*rest, part))

    def _concerned(self, separation: int) -> tuple[int, ...]:
        table = self._problem.separations
        both = (int(table.first[separation]), int(table.second[separation]))
        named = both[:1] if table.obstacle[separation] else both
        return tuple(vehicle for vehicle in named if not self._held[vehicle])

    def _columns(self, members: tuple[int, ...]) -> IntArray:
        return np.concatenate([np.arange(self._start[v], self._start[v + 1]) for v in members])

    def _solve(
        self, members: tuple[int, ...], choices: Choices, before: list[Part] | None, limit: float
    ) -> Part | None:
        """Solve with the watched rows, and again with those that this misses, until it misses none."""
        options = [self._option(choice) for choice in choices]
        tied = sum(len(option.lower) for option in options)
        start = None if before is None else self._start_multipliers(members, before, tied)
        while True:
            matrix = self._rows.matrix(members, tied)
            size, own = matrix.rows.shape[1], len(matrix.lower)
            rows = matrix.rows[: own - size + tied]
            self._enforce(options, rows[own - size :], members)
            low = np.concatenate([matrix.lower, *(option.lower for option in options)])
            high = np.concatenate([matrix.upper, np.full(tied, _UNBOUNDED)])
            if start is not None:
                start = np.concatenate([start[matrix.place], start[matrix.count :]])
            y, _, flag, info = daqp.solve(
                matrix.hessian,
                np.zeros(size),
                rows,
                high,
                np.maximum(low, -_UNBOUNDED),
                np.zeros(len(low), dtype=np.int32),
                dual_start=start,
                fval_bound=min(limit, _UNBOUNDED),
            )
            if flag not in _OPTIMAL:
                return None
            y = np.asarray(y)
            start = np.zeros(matrix.count + tied)
            start[matrix.place], start[matrix.count :] = np.split(np.asarray(info["lam"]), [own])
            if not self._rows.missed(members, y):
                return Part(members, choices, float(y @ y) / 2.0, y, start)

    def _enforce(self, options: list[_Option], rows: FloatArray, members: tuple[int, ...]) -> None:
        """Write the options' rows."""
        rows[:] = 0.0
        column, at = self._local(members), 0
        for option in options:
            rows[at + option.row, column[option.column]] = option.weight
            at += len(option.lower)

    def _local(self, members: tuple[int, ...]) -> IntArray:
        """Columns of the group's matrix by columns of all pivotal points."""
        local = np.full(self._start[-1], CONSTANT, dtype=np.int64)
        columns = self._columns(members)
        local[columns] = np.arange(len(columns))
        return local

    def _start_multipliers(self, members: tuple[int, ...], before: list[Part], tied: int) -> FloatArray:
        """Multipliers of the parts, put together; 0 for what is new."""
        variables: dict[int, FloatArray] = {}
        rows: dict[int, FloatArray] = {}
        chosen = []
        for part in before:
            sizes = [int(self._start[v + 1] - self._start[v]) for v in part.members]
            counts = [self._rows.count(v) for v in part.members]
            pieces = np.split(part.multipliers, np.cumsum([*sizes, *counts]))
            variables |= dict(zip(part.members, pieces, strict=False))
            rows |= dict(zip(part.members, pieces[len(sizes) :], strict=False))
            chosen.append(pieces[-1])
        found = np.concatenate([*(variables[v] for v in members), *(rows[v] for v in members), *chosen])
        return np.concatenate([found, np.zeros(tied - sum(map(len, chosen)))])

    def _option(self, choice: Choice) -> _Option:
        if choice not in self._options:
            self._options[choice] = self._separation(*choice)
        return self._options[choice]

    def _separation(self, separation: int, option: int) -> _Option:
        table = self._problem.separations
        gap = float(table.gap[separation, option])
        rows: list[int] = []
        columns: list[int] = []
        weights: list[float] = []
        bounds: list[float] = []
        for larger, larger_offset in self._points(int(table.larger[separation, option])):
            for smaller, smaller_offset in self._points(int(table.smaller[separation, option])):
                entries = [(c, w) for c, w in ((larger, 1.0), (smaller, -1.0)) if c != CONSTANT]
                bound = gap - larger_offset + smaller_offset
                # Rows of constants alone hold already, or rule the option out.
                if not entries and bound <= 0.0:
                    continue
                for column, weight in entries:
                    rows.append(len(bounds))
                    columns.append(column)
                    weights.append(weight / self._root[column])
                    bound -= weight * self._reference[column]
                bounds.append(bound)
        index = np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64)
        return _Option(*index, np.array(weights), np.array(bounds))

    def _points(self, wall: int) -> list[tuple[int, float]]:
        """The two points that a wall must hold: column and offset."""
        if wall == CONSTANT:
            return [(CONSTANT, 0.0)]
        found = []
        for index, offset in zip(
            self._problem.witness[wall].tolist(), self._problem.witness_offset_m[wall].tolist(), strict=True
        ):
            column = int(self._column[index])
            if column != CONSTANT and self._held[self._vehicle[column]]:
                found.append((CONSTANT, offset + float(self._around[index])))
            else:
                found.append((column, offset))
        return found
