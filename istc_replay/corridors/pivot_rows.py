"""Bounds and rows of the pivotal points alone, by vehicle, in the scaled variables of the pivot QP.

Most rows never matter, and DAQP's time grows with the rows it is given: it gets those alone that some
solution without them has missed. They are watched from then on.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from istc_replay.corridors.problem import CONSTANT

if TYPE_CHECKING:
    from istc_replay.corridors.problem import CorridorProblem, IntArray
    from istc_replay.datatypes import FloatArray

#: Rows for options that a matrix has room for when it is made.
_ROOM = 32
#: Rows are of unit length; one missed by more than this is watched.
_MISSED = 1e-6
_TINY = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class _Own:
    """One vehicle's bounds and rows: scaled to unit length, `matrix` (R, n); `lower`, `upper` (n + R,)."""

    matrix: FloatArray
    lower: FloatArray
    upper: FloatArray
    watched: NDArray[np.bool_]  # (R,): rows that a solution without them has missed

    def missed(self, y: FloatArray) -> int:
        """Watch the rows that y misses; returns how many were not watched yet."""
        value, count = self.matrix @ y, self.matrix.shape[1]
        new = (value < self.lower[count:] - _MISSED) | (value > self.upper[count:] + _MISSED)
        new &= ~self.watched
        self.watched[new] = True
        return int(new.sum())


@dataclass(frozen=True, slots=True, eq=False)
class PivotMatrix:
    """The watched rows of some vehicles, below them room for those of options, and a unit Hessian.

    `place` says where variables and watched rows stand among all variables and rows, `count` of both.
    """

    rows: FloatArray
    lower: FloatArray
    upper: FloatArray
    place: IntArray
    watched: int
    count: int
    hessian: FloatArray


class PivotRows:
    """The rows of all vehicles; which are watched grows while QPs are solved.

    Parameters
    ----------
    problem : CorridorProblem
        Its rows of pivotal points alone.
    root : (all pivotal variables,) array
        Scale, z = reference + y / root.
    """

    def __init__(self, problem: CorridorProblem, root: FloatArray) -> None:
        self._own = _own_rows(problem, root)
        self._matrices: dict[tuple[int, ...], PivotMatrix] = {}

    def count(self, vehicle: int) -> int:
        """Number of a vehicle's rows, watched or not."""
        return len(self._own[vehicle].matrix)

    def missed(self, members: tuple[int, ...], y: FloatArray) -> bool:
        """Watch the rows that y of these vehicles misses; whether any is new."""
        ends = np.cumsum([self._own[v].matrix.shape[1] for v in members])
        parts = np.split(y, ends[:-1])
        return sum(self._own[v].missed(part) for v, part in zip(members, parts, strict=True)) > 0

    def matrix(self, members: tuple[int, ...], tied: int) -> PivotMatrix:
        """The rows of some vehicles that are watched at present, with room for `tied` rows of options."""
        own = [self._own[v] for v in members]
        watched = [np.flatnonzero(o.watched) for o in own]
        count = sum(map(len, watched))
        known = self._matrices.get(members)
        if known is not None and known.watched == count and len(known.rows) >= count + tied:
            return known
        sizes = [o.matrix.shape[1] for o in own]
        size = sum(sizes)
        rows = np.zeros((count + max(_ROOM, 2 * tied), size))
        row = column = 0
        for o, which, width in zip(own, watched, sizes, strict=True):
            rows[row : row + len(which), column : column + width] = o.matrix[which]
            row, column = row + len(which), column + width
        offsets = size + np.cumsum([0, *(len(o.matrix) for o in own)])
        place = [np.arange(size), *(o + which for o, which in zip(offsets, watched, strict=False))]
        parts = list(zip(own, sizes, watched, strict=True))
        lower = [o.lower[:n] for o, n, _ in parts] + [o.lower[n + which] for o, n, which in parts]
        upper = [o.upper[:n] for o, n, _ in parts] + [o.upper[n + which] for o, n, which in parts]
        bounds = np.concatenate(lower), np.concatenate(upper)
        found = PivotMatrix(rows, *bounds, np.concatenate(place), count, int(offsets[-1]), np.eye(size))
        self._matrices[members] = found
        return found


def _own_rows(problem: CorridorProblem, root: FloatArray) -> list[_Own]:
    rows, pivots = problem.rows, problem.pivot_indices
    ends = np.cumsum([0, *(2 * block.units for block in problem.blocks)])
    columns = np.full(problem.size + 1, CONSTANT, dtype=np.int64)
    columns[pivots] = np.arange(len(pivots))
    column = columns[rows.index]  # (R, 6)
    pivotal = ((column != CONSTANT) | (rows.weight == 0.0)).all(axis=1)
    reference = problem.reference[pivots]
    lower = (problem.lower[pivots] - reference) * root
    upper = (problem.upper[pivots] - reference) * root
    found = []
    for first, end in pairwise(ends):
        which = np.flatnonzero(pivotal & (column[:, 0] >= first) & (column[:, 0] < end))
        matrix = np.zeros((len(which), end - first + 1))  # the last column takes the padding
        place = np.where(column[which] == CONSTANT, end - first, column[which] - first)
        np.put_along_axis(matrix, place, rows.weight[which], axis=1)
        matrix = matrix[:, :-1]
        shift = matrix @ reference[first:end]
        matrix = matrix / root[first:end]
        length = np.maximum(np.linalg.norm(matrix, axis=1), _TINY)
        low = np.concatenate([lower[first:end], (rows.lower[which] - shift) / length])
        high = np.concatenate([upper[first:end], (rows.upper[which] - shift) / length])
        watched = np.zeros(len(which), dtype=bool)
        found.append(_Own(matrix / length[:, None], low, high, watched))
    return found
