"""Stage A: pivotal points alone, by a best-first conflict tree over convex QPs.

The least cube of a unit is the hull of the car-boxes at its two pivotal points, so every option
of a disjunction is at most four linear rows of the pivotal points, without a big M. A node adds
options; its QP bounds what lies below it; a node without conflict that is first in the queue is
the optimum of the pivotal points.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING

import daqp
import numpy as np

from istc_replay.corridors.problem import CONSTANT, OptionTable

if TYPE_CHECKING:
    from istc_replay.corridors.problem import CorridorProblem, Option
    from istc_replay.datatypes import FloatArray

#: A conflict smaller than this is closed by rounding, not by branching.
CONFLICT_M = 1e-6
_OPTIMAL = (1, 2)  # DAQP's exit flags of an optimal solution


@dataclass(frozen=True, slots=True)
class TreeOutcome:
    """What the tree found: z with least cubes, or None; and how many nodes it took.

    `exhausted` tells that no node is left, so that None means infeasible. `last_conflict` is the
    disjunction that stayed open in the best node where the budget ended.
    """

    z: FloatArray | None
    nodes: int
    exhausted: bool
    last_conflict: int | None = None


def search(problem: CorridorProblem, node_budget: int) -> TreeOutcome:
    """Find the pivotal points of least eq. (3) without conflict.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    node_budget : int
        Largest number of QPs.
    """
    quadratic = _PivotQp(problem)
    table = OptionTable.of(problem)
    order = count()
    root = quadratic.solve(())
    if root is None:
        return TreeOutcome(None, 1, exhausted=True)
    queue: list[tuple[float, int, tuple[tuple[int, int], ...], FloatArray]] = [
        (root[0], next(order), (), root[1])
    ]
    nodes, conflict = 1, None
    while queue:
        _, _, chosen, z = heapq.heappop(queue)
        walls = problem.least_cubes(z)
        conflict = _worst_conflict(table.slack(walls))
        if conflict is None:
            return TreeOutcome(walls, nodes, exhausted=False)
        for option in range(len(problem.disjunctions[conflict].options)):
            if nodes >= node_budget:
                return TreeOutcome(None, nodes, exhausted=False, last_conflict=conflict)
            child = (*chosen, (conflict, option))
            solved = quadratic.solve(child)
            nodes += 1
            if solved is not None:
                heapq.heappush(queue, (solved[0], next(order), child, solved[1]))
    return TreeOutcome(None, nodes, exhausted=True, last_conflict=conflict)


def _worst_conflict(slack: FloatArray) -> int | None:
    """Branch where the overlap is largest and a second way out is far."""
    if len(slack) == 0:
        return None
    ordered = np.sort(slack, axis=1)[:, ::-1]
    overlap = -ordered[:, 0]
    if overlap.max() <= CONFLICT_M:
        return None
    second = np.where(np.isfinite(ordered[:, 1]), -ordered[:, 1], 100.0)
    return int(np.argmax(np.where(overlap > CONFLICT_M, overlap + second / 2.0, -np.inf)))


class _PivotQp:
    """The convex QP of the pivotal points with rows for chosen options."""

    def __init__(self, problem: CorridorProblem) -> None:
        self._problem = problem
        self._pivots = problem.pivot_indices
        size = len(self._pivots)
        column = np.full(problem.size + 1, CONSTANT, dtype=np.int64)
        column[self._pivots] = np.arange(size)
        self._column = column
        rows = [row for row in problem.rows if all(column[i] != CONSTANT for i in row.index)]
        self._base = np.zeros((len(rows), size))
        for r, row in enumerate(rows):
            self._base[r, column[list(row.index)]] = row.weight
        self._low = np.array([row.lower for row in rows])
        self._high = np.array([row.upper for row in rows])
        # Scaled to a unit Hessian about the reference, z = reference + y / root: DAQP's own form.
        self._root = np.sqrt(2.0 * problem.quadratic[self._pivots])
        self._low_bound = problem.lower[self._pivots]
        self._high_bound = problem.upper[self._pivots]
        self._cache: dict[tuple[int, int], tuple[FloatArray, FloatArray]] = {}

    def solve(self, chosen: tuple[tuple[int, int], ...]) -> tuple[float, FloatArray] | None:
        """Objective of eq. (3) and z (walls unset), or None where infeasible."""
        extra = [self._option_rows(*choice) for choice in chosen]
        matrix = np.vstack([self._base, *(rows for rows, _ in extra)])
        low = np.concatenate([self._low, *(bound for _, bound in extra)])
        high = np.concatenate([self._high, np.full(len(low) - len(self._low), np.inf)])
        reference = self._problem.reference[self._pivots]
        shift = matrix @ reference
        size = len(self._pivots)
        upper = np.concatenate([(self._high_bound - reference) * self._root, high - shift])
        lower = np.concatenate([(self._low_bound - reference) * self._root, low - shift])
        y, _, flag, _ = daqp.solve(
            np.eye(size),
            np.zeros(size),
            matrix / self._root,
            np.minimum(upper, 1e30),
            np.maximum(lower, -1e30),
            np.zeros(len(upper), dtype=np.int32),
        )
        if flag not in _OPTIMAL:
            return None
        z = np.zeros(self._problem.size)
        z[self._pivots] = reference + np.asarray(y) / self._root
        return float(np.asarray(y) @ np.asarray(y)) / 2.0, z

    def _option_rows(self, disjunction: int, option: int) -> tuple[FloatArray, FloatArray]:
        key = (disjunction, option)
        if key not in self._cache:
            self._cache[key] = self._separation(self._problem.disjunctions[disjunction].options[option])
        return self._cache[key]

    def _separation(self, option: Option) -> tuple[FloatArray, FloatArray]:
        """Rows that separate the least cubes: every point of one side from every point of the other."""
        rows, bounds = [], []
        for larger, larger_offset in self._points(option.larger):
            for smaller, smaller_offset in self._points(option.smaller):
                row = np.zeros(len(self._pivots))
                if larger != CONSTANT:
                    row[self._column[larger]] += 1.0
                if smaller != CONSTANT:
                    row[self._column[smaller]] -= 1.0
                bound = option.gap - larger_offset + smaller_offset
                # Rows of constants alone hold already, or rule the option out.
                if row.any() or bound > 0.0:
                    rows.append(row)
                    bounds.append(bound)
        return np.array(rows).reshape(-1, len(self._pivots)), np.array(bounds)

    def _points(self, wall: int) -> list[tuple[int, float]]:
        if wall == CONSTANT:
            return [(CONSTANT, 0.0)]
        problem = self._problem
        return [
            (int(index), float(offset))
            for index, offset in zip(problem.witness[wall], problem.witness_offset_m[wall], strict=True)
        ]
