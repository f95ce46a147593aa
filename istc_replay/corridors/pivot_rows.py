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
_UNBOUNDED = 1e30


@dataclass(slots=True, eq=False)
class _Own:
    """One vehicle's bounds and rows: scaled to unit length, `matrix` (R, n); `lower`, `upper` (n + R,).

    `columns` and `rows` say where its variables and rows stand among those of all vehicles.
    """

    matrix: FloatArray
    lower: FloatArray
    upper: FloatArray
    columns: IntArray
    rows: IntArray
    watched: IntArray  # numbers of the rows that a solution without them has missed


@dataclass(frozen=True, slots=True, eq=False)
class TiedRows:
    """Rows of options: `column`, `weight` (R, 2) of their entries, and `lower` bounds (R,).

    A row of one entry has it twice.
    """

    column: IntArray
    weight: FloatArray
    lower: FloatArray

    @classmethod
    def join(cls, parts: list[TiedRows]) -> TiedRows:
        """Put rows one below the other."""
        if len(parts) == 1:
            return parts[0]
        columns = np.concatenate([part.column for part in parts])
        weights = np.concatenate([part.weight for part in parts])
        return cls(columns, weights, np.concatenate([part.lower for part in parts]))


NO_ROWS = TiedRows(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)), np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class PivotMatrix:
    """The watched rows of some vehicles, and below them room for those of options.

    `columns` are the vehicles' own of all columns, `local` the way back. `place` says where variables
    and watched rows stand among those of all vehicles, `numbers` (room, 1) counts the options' rows.
    """

    rows: FloatArray
    lower: FloatArray
    upper: FloatArray
    sense: NDArray[np.int32]
    columns: IntArray
    local: IntArray
    place: IntArray
    numbers: IntArray
    watched: int

    def with_options(self, tied: TiedRows) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int32]]:
        """Rows, upper and lower bounds and their kinds with options; valid until it is called again."""
        count, own = len(tied.lower), len(self.place)
        rows = self.rows[: self.watched + count]
        if count:
            below = rows[self.watched :]
            below[:] = 0.0
            below[self.numbers[:count], self.local[tied.column]] = tied.weight
            self.lower[own : own + count] = tied.lower
        return rows, self.upper[: own + count], self.lower[: own + count], self.sense[: own + count]


@dataclass(frozen=True, slots=True, eq=False)
class _Check:
    """All rows of some vehicles, to see which a solution misses."""

    matrices: tuple[FloatArray, ...]
    columns: tuple[slice, ...]
    rows: tuple[slice, ...]
    least: FloatArray
    most: FloatArray
    value: FloatArray

    def missed(self, y: FloatArray) -> NDArray[np.bool_]:
        """Which rows y misses."""
        for matrix, column, row in zip(self.matrices, self.columns, self.rows, strict=True):
            np.dot(matrix, y[column], out=self.value[row])
        return np.asarray((self.value < self.least) | (self.value > self.most))


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
        self._columns = len(root)
        #: Number of all variables and rows.
        self.count = self._columns + sum(len(own.rows) for own in self._own)
        self._watched = 0  # rows of all vehicles
        self._matrices: dict[tuple[int, ...], tuple[PivotMatrix, int]] = {}  # with what was watched then
        self._checks: dict[tuple[int, ...], _Check] = {}

    def missed(self, members: tuple[int, ...], y: FloatArray) -> bool:
        """Watch the rows that y of these vehicles misses; whether any is new."""
        check = self._checks.get(members) or self._check(members)
        missed = check.missed(y)
        if not missed.any():
            return False
        before = self._watched
        for vehicle, rows in zip(members, check.rows, strict=True):
            if missed[rows].any():
                own = self._own[vehicle]
                watched = np.union1d(own.watched, np.flatnonzero(missed[rows]))
                self._watched += len(watched) - len(own.watched)
                own.watched = watched
        return self._watched > before

    def matrix(self, members: tuple[int, ...], tied: int) -> PivotMatrix:
        """The rows of some vehicles that are watched at present, with room for `tied` rows of options."""
        known, seen = self._matrices.get(members, (None, 0))
        if known is not None and seen == self._watched and len(known.rows) >= known.watched + tied:
            return known
        own = [self._own[v] for v in members]
        count = sum(len(o.watched) for o in own)
        if known is not None and known.watched == count and len(known.rows) >= count + tied:
            self._matrices[members] = known, self._watched
            return known
        columns = np.concatenate([o.columns for o in own])
        size, room = len(columns), max(_ROOM, 2 * tied)
        rows = np.zeros((count + room, size))
        row = column = 0
        for o in own:
            width = len(o.columns)
            rows[row : row + len(o.watched), column : column + width] = o.matrix[o.watched]
            row, column = row + len(o.watched), column + width
        local = np.full(self._columns, CONSTANT, dtype=np.int64)
        local[columns] = np.arange(size)
        lower, upper = (
            np.concatenate(
                [side[: len(o.columns)] for o, side in sides]
                + [side[len(o.columns) + o.watched] for o, side in sides]
                + [np.full(room, _UNBOUNDED)]
            )
            for sides in ([(o, o.lower) for o in own], [(o, o.upper) for o in own])
        )
        place = np.concatenate([columns, *(o.rows[o.watched] for o in own)])
        sense, numbers = np.zeros(len(lower), dtype=np.int32), np.arange(room)[:, None]
        found = PivotMatrix(
            rows, np.maximum(lower, -_UNBOUNDED), upper, sense, columns, local, place, numbers, count
        )
        self._matrices[members] = found, self._watched
        return found

    def _check(self, members: tuple[int, ...]) -> _Check:
        own = [self._own[v] for v in members]
        columns = np.cumsum([0, *(len(o.columns) for o in own)]).tolist()
        rows = np.cumsum([0, *(len(o.rows) for o in own)]).tolist()
        check = _Check(
            tuple(o.matrix for o in own),
            tuple(slice(*ends) for ends in pairwise(columns)),
            tuple(slice(*ends) for ends in pairwise(rows)),
            np.concatenate([o.lower[len(o.columns) :] for o in own]) - _MISSED,
            np.concatenate([o.upper[len(o.columns) :] for o in own]) + _MISSED,
            np.zeros(rows[-1]),
        )
        self._checks[members] = check
        return check


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
    place = len(pivots)
    for first, end in pairwise(ends):
        which = np.flatnonzero(pivotal & (column[:, 0] >= first) & (column[:, 0] < end))
        matrix = np.zeros((len(which), end - first + 1))  # the last column takes the padding
        at = np.where(column[which] == CONSTANT, end - first, column[which] - first)
        np.put_along_axis(matrix, at, rows.weight[which], axis=1)
        matrix = matrix[:, :-1]
        shift = matrix @ reference[first:end]
        matrix = matrix / root[first:end]
        length = np.maximum(np.linalg.norm(matrix, axis=1), _TINY)
        low = np.concatenate([lower[first:end], (rows.lower[which] - shift) / length])
        high = np.concatenate([upper[first:end], (rows.upper[which] - shift) / length])
        numbers = place + np.arange(len(which))
        place += len(which)
        none = np.zeros(0, dtype=np.int64)
        found.append(_Own(matrix / length[:, None], low, high, np.arange(first, end), numbers, none))
    return found
