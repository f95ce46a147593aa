"""What decides how far options hold while every cube is the least one: the pivotal points at its walls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.problem import CONSTANT

if TYPE_CHECKING:
    from istc_replay.corridors.problem import CorridorProblem, IntArray
    from istc_replay.datatypes import FloatArray

#: A wall of a least cube is the outermost of two points.
_POINTS = 2


@dataclass(frozen=True, slots=True, eq=False)
class OptionEnds:
    """The two points of the larger and the two of the smaller wall of each option.

    `column` (4, 4, D) by point, option and separation: that of a pivotal variable, or the number of these
    for a constant; `offset_m` (4, 4, D) how far from the point the wall lies; `gap` (4, D).
    """

    column: IntArray
    offset_m: FloatArray
    gap: FloatArray

    @classmethod
    def of(cls, problem: CorridorProblem) -> OptionEnds:
        """The ends of all separations of a problem; columns are places in its pivot indices."""
        pivots, table = problem.pivot_indices, problem.separations
        columns = np.full(problem.size + 1, len(pivots), dtype=np.int64)
        columns[pivots] = np.arange(len(pivots))
        column, offset = [], []
        for wall in (table.larger.T, table.smaller.T):
            constant = wall == CONSTANT
            for point in range(_POINTS):
                column.append(np.where(constant, len(pivots), columns[problem.witness[wall, point]]))
                offset.append(np.where(constant, 0.0, problem.witness_offset_m[wall, point]))
        return cls(np.stack(column), np.stack(offset), np.ascontiguousarray(table.gap.T))

    def taken(self, which: IntArray) -> OptionEnds:
        """The ends of some separations."""
        return OptionEnds(self.column[..., which], self.offset_m[..., which], self.gap[:, which])

    def slack(self, points_m: FloatArray) -> FloatArray:
        """How far each option holds (D, 4) [m], at pivotal variables with a 0 behind them."""
        ends = points_m.take(self.column)
        ends += self.offset_m
        larger, smaller = np.minimum(ends[0], ends[1]), np.maximum(ends[2], ends[3])
        return np.asarray((larger - smaller - self.gap).T)
