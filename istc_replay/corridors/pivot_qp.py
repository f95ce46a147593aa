"""The convex QP of the pivotal points alone, with rows for the options chosen so far."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import daqp
import numpy as np

from istc_replay.corridors.problem import CONSTANT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from istc_replay.corridors.problem import CorridorProblem, Option
    from istc_replay.datatypes import FloatArray

_OPTIMAL = (1, 2)  # DAQP's exit flags of an optimal solution
_UNBOUNDED = 1e30

#: Options chosen so far: (disjunction, option).
Choices = tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, eq=False)
class PivotSolution:
    """Cost of eq. (3), z (of the QP's vehicles; else 0), and multipliers that warm-start the next."""

    cost: float
    z: FloatArray
    multipliers: FloatArray


class PivotQp:
    """Minimise eq. (3) over the pivotal points of some vehicles such that the chosen options hold.

    The least cube of a unit is the hull of the car-boxes at its two pivotal points, so an option
    is at most four linear rows: every point of one side from every point of the other.
    """

    def __init__(self, problem: CorridorProblem, vehicles: Sequence[str]) -> None:
        self._problem = problem
        group = [block for block in problem.blocks if block.vehicle_id in vehicles]
        self._pivots = np.concatenate([block.pivot[1:].ravel() for block in group])
        size = len(self._pivots)
        self._column = np.full(problem.size + 1, CONSTANT, dtype=np.int64)
        self._column[self._pivots] = np.arange(size)
        column = self._column.tolist()
        # A row is of one vehicle alone: most are out by their first index.
        rows = [
            row
            for row in problem.rows
            if column[row.index[0]] != CONSTANT and CONSTANT not in [column[i] for i in row.index]
        ]
        matrix = np.zeros((len(rows), size))
        for r, row in enumerate(rows):
            matrix[r, self._column[list(row.index)]] = row.weight
        # Scaled to a unit Hessian about the reference, z = reference + y / root: DAQP's own form.
        self._root = np.sqrt(2.0 * problem.quadratic[self._pivots])
        self._reference = problem.reference[self._pivots]
        shift = matrix @ self._reference
        low = problem.lower[self._pivots] - self._reference
        high = problem.upper[self._pivots] - self._reference
        self._matrix = matrix / self._root
        self._lower = np.concatenate([low * self._root, [row.lower for row in rows] - shift])
        self._upper = np.concatenate([high * self._root, [row.upper for row in rows] - shift])
        self._lower = np.maximum(self._lower, -_UNBOUNDED)
        self._upper = np.minimum(self._upper, _UNBOUNDED)
        self._hessian, self._gradient = np.eye(size), np.zeros(size)
        self._cache: dict[tuple[int, int], tuple[FloatArray, FloatArray]] = {}

    def solve(self, choices: Choices, multipliers: FloatArray | None = None) -> PivotSolution | None:
        """Solve with these options enforced, or return None where they contradict each other.

        `multipliers` are those of the same choices without the last ones.
        """
        extra = [self._option_rows(choice) for choice in choices]
        matrix = np.vstack([self._matrix, *(rows for rows, _ in extra)])
        lower = np.concatenate([self._lower, *(bound for _, bound in extra)])
        upper = np.full(len(lower), _UNBOUNDED)
        upper[: len(self._upper)] = self._upper
        start = None
        if multipliers is not None:
            start = np.zeros(len(lower))
            start[: len(multipliers)] = multipliers
        sense = np.zeros(len(lower), dtype=np.int32)
        y, _, flag, info = daqp.solve(
            self._hessian, self._gradient, matrix, upper, lower, sense, dual_start=start
        )
        if flag not in _OPTIMAL:
            return None
        scaled = np.asarray(y)
        z = np.zeros(self._problem.size)
        z[self._pivots] = self._reference + scaled / self._root
        cost = float(scaled @ scaled) / 2.0
        return PivotSolution(cost, z, np.asarray(info["lam"]))

    def _option_rows(self, choice: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        if choice not in self._cache:
            disjunction, option = choice
            rows, bounds = self._separation(self._problem.disjunctions[disjunction].options[option])
            self._cache[choice] = rows / self._root, bounds - rows @ self._reference
        return self._cache[choice]

    def _separation(self, option: Option) -> tuple[FloatArray, FloatArray]:
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
        points = zip(self._problem.witness[wall], self._problem.witness_offset_m[wall], strict=True)
        return [(int(index), float(offset)) for index, offset in points]
