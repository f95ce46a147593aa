"""The corridor problem of one window, as every solver of layer 1 sees it.

One vector z holds every vehicle's variables, vehicle by vehicle: the pivotal points
p(1) .. p(K) as (x, y), then the cubes 0 .. K-1 as (x_min, x_max, y_min, y_max); p(0) is the
start. Linear rows always hold; of each separation one option holds.

Shapes: n variables, R rows, D separations.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from istc_replay.datatypes import Corridor, FloatArray, read_only

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: Columns of a cube.
X_MIN, X_MAX, Y_MIN, Y_MAX = range(4)

#: Index of a constant where a variable's index is expected: what `extended` appends to z.
CONSTANT = -1
#: Most variables that a row has.
_ROW_WIDTH = 6


def extended(z: FloatArray) -> FloatArray:
    """Append the 0 that CONSTANT stands for."""
    return np.append(z, 0.0)


@dataclass(frozen=True, slots=True)
class Limits:
    """One vehicle's limits on its pivotal points; feedback from layer 2 makes them tighter."""

    cone: float
    acceleration_mps2: float
    deceleration_mps2: float
    lateral_acceleration_mps2: float
    tightness: float = 1.0  # 1 where nothing was tightened
    room_m: float = 0.0  # left to layer 2 beside the path, more than it always is

    def tightened(self, factor: float = 0.7) -> Limits:
        """Return limits that leave more to layer 2."""
        return Limits(
            self.cone * factor,
            self.acceleration_mps2 * factor,
            self.deceleration_mps2 * factor,
            self.lateral_acceleration_mps2 * factor,
            self.tightness * factor,
            self.room_m,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Linear rows lower <= sum weight * z[index] <= upper.

    `index` and `weight` (R, 6), padded by CONSTANT and 0; `lower`, `upper` (R,); `families` names
    the equation of each run of rows with its length. Every row is of one vehicle alone, and its first
    index is a variable.
    """

    families: tuple[tuple[str, int], ...]
    index: IntArray
    weight: FloatArray
    lower: FloatArray
    upper: FloatArray

    @classmethod
    def of(
        cls,
        equation: str,
        index: IntArray,
        weight: FloatArray,
        lower: FloatArray | float,
        upper: FloatArray | float,
    ) -> Rows:
        """Rows of one equation from indices and weights (R, at most 6) and their bounds."""
        count, width = index.shape
        padded = np.full((count, _ROW_WIDTH), CONSTANT, dtype=np.int64)
        weights = np.zeros((count, _ROW_WIDTH))
        padded[:, :width], weights[:, :width] = index, np.where(index == CONSTANT, 0.0, weight)
        low, high = (np.broadcast_to(np.asarray(b, dtype=np.float64), (count,)) for b in (lower, upper))
        return cls(((equation, count),), padded, weights, low, high)

    @classmethod
    def join(cls, parts: Iterable[Rows]) -> Rows:
        """Put rows one below the other."""
        some = list(parts)
        return cls(
            tuple(family for part in some for family in part.families),
            np.concatenate([part.index for part in some]),
            np.concatenate([part.weight for part in some]),
            np.concatenate([part.lower for part in some]),
            np.concatenate([part.upper for part in some]),
        )

    def taken(self, which: BoolArray) -> Rows:
        """Some of the rows (R,)."""
        ends = np.cumsum([count for _, count in self.families])
        counts = [int(run.sum()) for run in np.split(which, ends[:-1])]
        names = [name for name, _ in self.families]
        families = tuple((name, count) for name, count in zip(names, counts, strict=True) if count)
        return Rows(families, self.index[which], self.weight[which], self.lower[which], self.upper[which])

    def value(self, z: FloatArray) -> FloatArray:
        """Left-hand sides (R,) at z."""
        return np.asarray((self.weight * extended(z)[self.index]).sum(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """One vehicle's part of z.

    `pivot` (K+1, 2): indices into z, row 0 CONSTANT. `cube` (K, 4): indices into z.
    `start_m` (2,), `reference_m` (K+1, 2), `half_gamma_m` (K+1, 2): half extents of the
    car-box held around each pivotal point (row 0: the true start box).
    """

    vehicle_id: str
    priority: float
    first_unit: int
    units: int
    start_m: FloatArray
    reference_m: FloatArray
    half_gamma_m: FloatArray
    pivot: IntArray
    cube: IntArray

    @property
    def end_unit(self) -> int:
        """The unit after the last."""
        return self.first_unit + self.units


@dataclass(frozen=True, slots=True, eq=False)
class Separations:
    """Of each of D pairs of boxes one of four options holds: z[larger] - z[smaller] >= gap.

    `unit` (D,), `first` (D,) the number of a block, `second` (D,) that of a block, eq. (5), or of an
    obstacle, eq. (6), where `obstacle` (D,). `larger`, `smaller` (D, 4) are walls (CONSTANT counts as
    0) and `gap` (D, 4) is infinite where the bounds rule the option out. Separations that the bounds
    satisfy do not appear; one without options has no solution.
    """

    unit: IntArray
    first: IntArray
    second: IntArray
    obstacle: BoolArray
    larger: IntArray
    smaller: IntArray
    gap: FloatArray

    def __len__(self) -> int:
        return len(self.unit)

    @property
    def possible(self) -> BoolArray:
        """Which options (D, 4) the bounds leave."""
        return np.asarray(np.isfinite(self.gap))

    def slack(self, z: FloatArray) -> FloatArray:
        """How far each option holds at z (D, 4) [m]; negative where it does not."""
        values = extended(z)
        return np.asarray(values[self.larger] - values[self.smaller] - self.gap)

    def best(self, z: FloatArray) -> IntArray:
        """The option (D,) of each separation that z meets best."""
        return np.asarray(self.slack(z).argmax(axis=1), dtype=np.int64)

    def taken(self, which: IntArray | BoolArray) -> Separations:
        """Some of the separations."""
        return Separations(
            self.unit[which],
            self.first[which],
            self.second[which],
            self.obstacle[which],
            self.larger[which],
            self.smaller[which],
            self.gap[which],
        )

    def undecided(
        self, lower: FloatArray, upper: FloatArray, decisive_m: float
    ) -> tuple[Separations, IntArray]:
        """Leave out what bounds of z decide: impossible options, and separations that always hold.

        Bounds rule an option out only by more than `decisive_m`, so that rounding never does. Returns
        the rest and where it stood (numbers of separations).
        """
        least, most = extended(lower), extended(upper)
        surely = least[self.larger] - most[self.smaller] - self.gap
        at_best = most[self.larger] - least[self.smaller] - self.gap
        kept = np.flatnonzero(surely.max(axis=1, initial=-np.inf) < 0.0)
        rest = self.taken(kept)
        gap = np.where(at_best[kept] < -decisive_m, np.inf, rest.gap)
        return (
            Separations(rest.unit, rest.first, rest.second, rest.obstacle, rest.larger, rest.smaller, gap),
            kept,
        )

    def rows(self, choice: Sequence[int] | IntArray) -> Rows:
        """Rows that enforce one option of each separation."""
        at = np.arange(len(self)), np.asarray(choice, dtype=np.int64)
        index = np.stack([self.larger[at], self.smaller[at]], axis=-1)
        weight = np.tile([1.0, -1.0], (len(self), 1))
        swapped = index[:, 0] == CONSTANT
        index[swapped], weight[swapped] = index[swapped, ::-1], weight[swapped, ::-1]
        return Rows.of("eq. (5), (6)", index, weight, self.gap[at], np.inf)


@dataclass(frozen=True, eq=False)
class CorridorProblem:
    """Minimise sum quadratic (z - reference)^2 + linear z, eq. (4), over rows and separations.

    All arrays have one entry a variable. `witness` (n, 2) and `witness_offset_m` (n, 2) give, for
    a cube's wall, the two points that the least cube must hold: z[witness] + offset (CONSTANT: the
    offset alone); rows of pivotal variables are unused.
    """

    blocks: tuple[Block, ...]
    obstacles: tuple[str, ...]
    rows: Rows
    separations: Separations
    quadratic: FloatArray
    reference: FloatArray
    linear: FloatArray
    lower: FloatArray
    upper: FloatArray
    witness: IntArray
    witness_offset_m: FloatArray

    @property
    def size(self) -> int:
        """Number of continuous variables."""
        return len(self.lower)

    @cached_property
    def binaries(self) -> int:
        """Number of options to choose from."""
        return int(self.separations.possible.sum())

    @cached_property
    def pivot_indices(self) -> IntArray:
        """Indices of all pivotal variables."""
        return np.concatenate([block.pivot[1:].ravel() for block in self.blocks])

    @cached_property
    def cube_indices(self) -> IntArray:
        """Indices (all units, 4) of all walls."""
        return np.concatenate([block.cube for block in self.blocks])

    @cached_property
    def parts(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of blocks in parts that never meet, whatever is chosen."""
        part, table = np.arange(len(self.blocks)), self.separations
        pairs = np.stack([table.first, table.second], axis=-1)[~table.obstacle]
        for first, second in np.unique(pairs, axis=0).tolist():
            part[part == part[second]] = part[first]
        return tuple(tuple(np.flatnonzero(part == own).tolist()) for own in dict.fromkeys(part.tolist()))

    @property
    def impossible(self) -> IntArray:
        """Separations that no choice satisfies."""
        return np.flatnonzero(~self.separations.possible.any(axis=1))

    def pair(self, separation: int) -> tuple[str, str]:
        """Names of the two that a separation keeps apart."""
        first = self.blocks[self.separations.first[separation]].vehicle_id
        second = int(self.separations.second[separation])
        if self.separations.obstacle[separation]:
            return first, self.obstacles[second]
        return first, self.blocks[second].vehicle_id

    def objective(self, z: FloatArray) -> float:
        """Value of eq. (4)."""
        return self.reference_cost(z) + float(self.linear @ z)

    def part_objective(self, z: FloatArray, part: Sequence[int]) -> float:
        """Value of eq. (4) of some blocks alone."""
        own = self.indices(part)
        squares = self.quadratic[own] @ (z[own] - self.reference[own]) ** 2
        return float(squares + self.linear[own] @ z[own])

    def indices(self, part: Sequence[int]) -> IntArray:
        """Indices of all variables of some blocks."""
        blocks = [self.blocks[number] for number in part]
        return np.concatenate([np.concatenate([b.pivot[1:].ravel(), b.cube.ravel()]) for b in blocks])

    def reference_cost(self, z: FloatArray) -> float:
        """Value of eq. (3), weighted, alone."""
        return float(self.quadratic @ (z - self.reference) ** 2)

    def least_cubes(self, z: FloatArray) -> FloatArray:
        """Put every cube's walls at the least cube around its pivotal points; returns a new z."""
        walls = np.array(z)
        cubes = self.cube_indices
        points = extended(z)[self.witness[cubes]] + self.witness_offset_m[cubes]  # (K, 4, 2)
        walls[cubes[:, ::2]] = points[:, ::2].min(axis=-1)
        walls[cubes[:, 1::2]] = points[:, 1::2].max(axis=-1)
        return walls

    def corridors(self, z: FloatArray) -> tuple[Corridor, ...]:
        """Read the corridors out of a solution."""
        return tuple(
            Corridor(
                vehicle_id=block.vehicle_id,
                first_unit=block.first_unit,
                cubes_m=read_only(z[block.cube]),
                pivots_m=read_only(np.vstack([block.start_m, z[block.pivot[1:]]])),
                references_m=read_only(block.reference_m),
            )
            for block in self.blocks
        )
