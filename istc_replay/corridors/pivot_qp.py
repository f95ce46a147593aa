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

from istc_replay.corridors.option_ends import OptionEnds
from istc_replay.corridors.pivot_rows import NO_ROWS, PivotMatrix, PivotRows, TiedRows
from istc_replay.corridors.problem import CONSTANT

if TYPE_CHECKING:
    from istc_replay.corridors.problem import CorridorProblem, IntArray
    from istc_replay.datatypes import FloatArray

_OPTIMAL = (1, 2)  # DAQP's exit flags of an optimal solution
_UNBOUNDED = 1e30

#: Options chosen so far: (separation, option).
Choice = tuple[int, int]
Choices = tuple[Choice, ...]
#: A point by its column and how far from it a wall lies.
_End = tuple[int, float]


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Vehicles tied together: their numbers, the options that tie them, and the QP's solution.

    `points_m` are their pivotal variables; `multipliers` are of those bounds and rows that stand at `place`
    among all, and then of the options' rows, `tied`.
    """

    members: tuple[int, ...]
    choices: Choices
    cost: float
    points_m: FloatArray
    multipliers: FloatArray
    place: IntArray
    tied: TiedRows


@dataclass(frozen=True, slots=True, eq=False)
class PivotSolution:
    """A solution by parts: its cost, eq. (3), and which part each vehicle belongs to."""

    cost: float
    parts: tuple[Part, ...]

    @property
    def choices(self) -> Choices:
        """All options chosen."""
        return tuple(choice for part in self.parts for choice in part.choices)


class PivotQp:
    """Minimise eq. (3) over the pivotal points of some vehicles such that the chosen options hold.

    The least cube of a unit is the hull of the car-boxes at its two pivotal points, so an option
    is at most four linear rows: every point of one side from every point of the other.
    Variables are scaled to a unit Hessian about the reference, z = reference + y / root: DAQP's own
    form, in which it needs neither a Hessian nor a gradient. DAQP is given the rows that are watched
    (`pivot_rows`).
    """

    def __init__(self, problem: CorridorProblem) -> None:
        self._problem = problem
        pivots = problem.pivot_indices
        sizes = [2 * block.units for block in problem.blocks]
        self._start = np.concatenate([[0], np.cumsum(sizes)])
        self._pivots = pivots
        self._root = np.sqrt(2.0 * problem.quadratic[pivots])
        self._reference = problem.reference[pivots]
        self._rows = PivotRows(problem, self._root)
        self._options: dict[Choice, TiedRows] = {}
        self._held: frozenset[int] = frozenset()
        self._fixed = np.append(np.zeros(len(pivots), dtype=bool), True)  # (pivotal variables + 1,)
        self._around = np.zeros(problem.size)
        self._points = np.zeros(len(pivots) + 1)
        #: What decides how far options hold, in places of pivotal variables.
        self.ends = OptionEnds.of(problem)
        table = problem.separations
        pairs = zip(table.first.tolist(), table.second.tolist(), table.obstacle.tolist(), strict=True)
        self._kept_apart = [(first,) if obstacle else (first, second) for first, second, obstacle in pairs]

    def beside(self, z: FloatArray, free: tuple[int, ...]) -> PivotQp:
        """The same QP for some vehicles alone, with all others where z has them."""
        other = copy(self)
        other._options = {}
        other._held = frozenset(range(len(self._start) - 1)).difference(free)
        own = self._columns(free)
        other._fixed = np.ones(len(self._fixed), dtype=bool)
        other._fixed[own] = False
        other._around = np.array(z)
        other._around[self._pivots[own]] = 0.0
        other._points = np.append(other._around[self._pivots], 0.0)
        return other

    def z(self, solution: PivotSolution) -> FloatArray:
        """The solution's pivotal points in z; what is not part of it is 0, or as held."""
        z = np.array(self._around)
        z[self._pivots] = self.points(solution)[:-1]
        return z

    def points(self, solution: PivotSolution) -> FloatArray:
        """All pivotal variables with a 0 behind them; what is not part of the solution is 0, or as held."""
        points = np.array(self._points)
        for part in solution.parts:
            points[part.place[: len(part.points_m)]] = part.points_m
        return points

    def prices(self, separations: IntArray) -> FloatArray:
        """What enforcing options (D, 4) costs at least a squared metre of violation.

        The optimum is a projection in y: every solution that moves by d costs d^2 / 2 more.
        """
        give = np.append(1.0 / self._problem.quadratic[self._pivots], 0.0)
        give[self._fixed] = 0.0
        ends = give[self.ends.column[..., separations]]
        compliance = np.maximum(ends[0], ends[1]) + np.maximum(ends[2], ends[3])
        known = compliance > 0.0
        return np.asarray(np.where(known, 1.0 / np.where(known, compliance, 1.0), np.inf).T)

    def root(self, members: tuple[int, ...], choices: Choices, limit: float = np.inf) -> PivotSolution | None:
        """Solve with these options from scratch, or return None where they contradict each other."""
        parts: list[Part] = []
        of = {vehicle: {vehicle} for vehicle in members}
        for separation, _ in choices:
            tied = set.union(*(of[v] for v in self._concerned(separation)))
            of |= dict.fromkeys(tied, tied)
        for group in dict.fromkeys(tuple(sorted(of[vehicle])) for vehicle in members):
            own = tuple(c for c in choices if self._concerned(c[0])[0] in group)
            part = self._solve(group, own, self._rows_of(own), [], limit - sum(p.cost for p in parts))
            if part is None:
                return None
            parts.append(part)
        return PivotSolution(sum(part.cost for part in parts), tuple(parts))

    def with_option(
        self, solution: PivotSolution, choice: Choice, limit: float = np.inf
    ) -> PivotSolution | None:
        """Add an option; None where that contradicts the others, or costs more than `limit` for sure."""
        concerned = self._concerned(choice[0])
        tied: list[Part] = []
        rest: list[Part] = []
        for part in solution.parts:
            (tied if any(v in part.members for v in concerned) else rest).append(part)
        others = sum(part.cost for part in rest)
        members, choices = tied[0].members, tied[0].choices
        if len(tied) > 1:
            members = tuple(sorted(v for part in tied for v in part.members))
            choices = tuple(c for part in tied for c in part.choices)
        rows = TiedRows.join([*(part.tied for part in tied), self._option(choice)])
        solved = self._solve(members, (*choices, choice), rows, tied, limit - others)
        return None if solved is None else PivotSolution(others + solved.cost, (*rest, solved))

    def _concerned(self, separation: int) -> tuple[int, ...]:
        return tuple(vehicle for vehicle in self._kept_apart[separation] if vehicle not in self._held)

    def _columns(self, members: tuple[int, ...]) -> IntArray:
        return np.concatenate([np.arange(self._start[v], self._start[v + 1]) for v in members])

    def _solve(
        self, members: tuple[int, ...], choices: Choices, tied: TiedRows, before: list[Part], limit: float
    ) -> Part | None:
        """Solve with the watched rows, and again with those that this misses, until it misses none."""
        limit = min(limit, _UNBOUNDED)
        while True:
            matrix = self._rows.matrix(members, len(tied.lower))
            start = self._start_multipliers(before, matrix, len(tied.lower)) if before else None
            rows, high, low, sense = matrix.with_options(tied)
            y, _, flag, info = daqp.solve(
                None, None, rows, high, low, sense, dual_start=start, fval_bound=limit
            )
            if flag not in _OPTIMAL:
                return None
            points = self._reference[matrix.columns] + y / self._root[matrix.columns]
            cost = float(y @ y) / 2.0
            part = Part(members, choices, cost, points, np.asarray(info["lam"]), matrix.place, tied)
            if not self._rows.missed(members, y):
                return part
            before = [part]

    def _start_multipliers(self, before: list[Part], matrix: PivotMatrix, tied: int) -> FloatArray:
        """Multipliers of the parts, put together; 0 for what is new."""
        if len(before) == 1 and before[0].place is matrix.place:
            known = [before[0].multipliers]
        else:
            everything = np.zeros(self._rows.count)
            for part in before:
                everything[part.place] = part.multipliers[: len(part.place)]
            known = [everything[matrix.place], *(part.multipliers[len(part.place) :] for part in before)]
        new = len(matrix.place) + tied - sum(map(len, known))
        return np.concatenate([*known, np.zeros(new)])

    def _rows_of(self, choices: Choices) -> TiedRows:
        return TiedRows.join([NO_ROWS, *(self._option(choice) for choice in choices)])

    def _option(self, choice: Choice) -> TiedRows:
        if choice not in self._options:
            self._options[choice] = self._separation(*choice)
        return self._options[choice]

    def _separation(self, separation: int, option: int) -> TiedRows:
        """Each point of the larger wall from each point of the smaller."""
        larger_ends, smaller_ends = self._ends(separation, option)
        gap = float(self.ends.gap[option, separation])
        columns: list[tuple[int, int]] = []
        weights: list[tuple[float, float]] = []
        bounds: list[float] = []
        for larger, larger_offset in larger_ends:
            for smaller, smaller_offset in smaller_ends:
                entries = [(c, w) for c, w in ((larger, 1.0), (smaller, -1.0)) if c != CONSTANT]
                bound = gap - larger_offset + smaller_offset
                # Rows of constants alone hold already, or rule the option out.
                if not entries and bound <= 0.0:
                    continue
                for column, weight in entries:
                    bound -= weight * float(self._reference[column])
                (first, at), (last, to) = (entries[0], entries[-1]) if entries else ((0, 0.0), (0, 0.0))
                columns.append((first, last))
                weights.append((at / float(self._root[first]), to / float(self._root[last])))
                bounds.append(bound)
        shape = len(bounds), 2
        index = np.array(columns, dtype=np.int64).reshape(shape)
        return TiedRows(index, np.array(weights).reshape(shape), np.array(bounds))

    def _ends(self, separation: int, option: int) -> tuple[list[_End], list[_End]]:
        """The points of the larger wall and of the smaller; of a constant its offset alone, once."""
        columns = self.ends.column[:, option, separation].tolist()
        offsets = self.ends.offset_m[:, option, separation].tolist()
        found = [
            (CONSTANT, offset + float(self._points[column])) if self._fixed[column] else (column, offset)
            for column, offset in zip(columns, offsets, strict=True)
        ]
        return list(dict.fromkeys(found[:2])), list(dict.fromkeys(found[2:]))
