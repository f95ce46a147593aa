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

from istc_replay.corridors.problem import CONSTANT

if TYPE_CHECKING:
    from istc_replay.corridors.problem import CorridorProblem, IntArray
    from istc_replay.datatypes import FloatArray

_OPTIMAL = (1, 2)  # DAQP's exit flags of an optimal solution
_UNBOUNDED = 1e30
#: Rows for options that a matrix has room for when it is made.
_ROOM = 32

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


@dataclass(slots=True)
class _Matrix:
    """The rows of some vehicles, below them room for those of options, and a unit Hessian."""

    rows: FloatArray
    own: int
    hessian: FloatArray


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
    form.
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
        self._own = self._own_rows()
        self._matrices: dict[tuple[int, ...], _Matrix] = {}
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

    def _own_rows(self) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Rows of the pivotal points alone, by vehicle: scaled matrix, lower and upper bounds."""
        problem, rows = self._problem, self._problem.rows
        column = self._column[rows.index]  # (R, 6)
        pivotal = ((column != CONSTANT) | (rows.weight == 0.0)).all(axis=1)
        lower = (problem.lower[self._pivots] - self._reference) * self._root
        upper = (problem.upper[self._pivots] - self._reference) * self._root
        found = []
        for first, end in zip(self._start[:-1], self._start[1:], strict=True):
            which = np.flatnonzero(pivotal & (column[:, 0] >= first) & (column[:, 0] < end))
            matrix = np.zeros((len(which), end - first + 1))  # the last column takes the padding
            place = np.where(column[which] == CONSTANT, end - first, column[which] - first)
            np.put_along_axis(matrix, place, rows.weight[which], axis=1)
            matrix = matrix[:, :-1]
            shift = matrix @ self._reference[first:end]
            low = np.concatenate([lower[first:end], rows.lower[which] - shift])
            high = np.concatenate([upper[first:end], rows.upper[which] - shift])
            found.append((matrix / self._root[first:end], low, high))
        return found

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
        options = [self._option(choice) for choice in choices]
        counts = [len(option.lower) for option in options]
        matrix = self._matrix(members, sum(counts))
        size, own = matrix.rows.shape[1], matrix.own
        used = matrix.rows[: own + sum(counts)]
        used[own:] = 0.0
        column = self._local(members)
        at = own
        for option, count in zip(options, counts, strict=True):
            used[at + option.row, column[option.column]] = option.weight
            at += count
        low = np.concatenate([*self._bounds(members, 1), *(option.lower for option in options)])
        high = np.full(len(low), _UNBOUNDED)
        high[: size + own] = np.concatenate(self._bounds(members, 2))
        start = None if before is None else self._start_multipliers(members, before, len(low))
        y, _, flag, info = daqp.solve(
            matrix.hessian,
            np.zeros(size),
            used,
            high,
            np.maximum(low, -_UNBOUNDED),
            np.zeros(len(low), dtype=np.int32),
            dual_start=start,
            fval_bound=min(limit, _UNBOUNDED),
        )
        if flag not in _OPTIMAL:
            return None
        y = np.asarray(y)
        return Part(members, choices, float(y @ y) / 2.0, y, np.asarray(info["lam"]))

    def _matrix(self, members: tuple[int, ...], extra: int) -> _Matrix:
        """The vehicles' rows with room for `extra` more, kept from call to call."""
        known = self._matrices.get(members)
        if known is None or len(known.rows) < known.own + extra:
            matrices = [self._own[v][0] for v in members]
            own = sum(len(m) for m in matrices)
            rows = np.zeros((own + max(_ROOM, 2 * extra), sum(m.shape[1] for m in matrices)))
            row = column = 0
            for m in matrices:
                rows[row : row + len(m), column : column + m.shape[1]] = m
                row, column = row + len(m), column + m.shape[1]
            known = self._matrices[members] = _Matrix(rows, own, np.eye(rows.shape[1]))
        return known

    def _local(self, members: tuple[int, ...]) -> IntArray:
        """Columns of the group's matrix by columns of all pivotal points."""
        local = np.full(self._start[-1], CONSTANT, dtype=np.int64)
        columns = self._columns(members)
        local[columns] = np.arange(len(columns))
        return local

    def _bounds(self, members: tuple[int, ...], which: int) -> list[FloatArray]:
        """Lower (1) or upper (2) bounds: first of all variables, then of all rows."""
        sizes = [self._start[v + 1] - self._start[v] for v in members]
        bounds = [self._own[v][which] for v in members]
        variables = [b[:n] for b, n in zip(bounds, sizes, strict=True)]
        return variables + [b[n:] for b, n in zip(bounds, sizes, strict=True)]

    def _start_multipliers(self, members: tuple[int, ...], before: list[Part], length: int) -> FloatArray:
        """Multipliers of the parts, put together; 0 for what is new."""
        variables: dict[int, FloatArray] = {}
        rows: dict[int, FloatArray] = {}
        chosen = []
        for part in before:
            sizes = [int(self._start[v + 1] - self._start[v]) for v in part.members]
            counts = [len(self._own[v][0]) for v in part.members]
            pieces = np.split(part.multipliers, np.cumsum([*sizes, *counts]))
            variables |= dict(zip(part.members, pieces, strict=False))
            rows |= dict(zip(part.members, pieces[len(sizes) :], strict=False))
            chosen.append(pieces[-1])
        found = np.concatenate([*(variables[v] for v in members), *(rows[v] for v in members), *chosen])
        return np.concatenate([found, np.zeros(length - len(found))])

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
