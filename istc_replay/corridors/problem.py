"""The corridor problem of one window, as every solver of layer 1 sees it.

One vector z holds every vehicle's variables, vehicle by vehicle: the pivotal points
p(1) .. p(K) as (x, y), then the cubes 0 .. K-1 as (x_min, x_max, y_min, y_max); p(0) is the
start. Linear rows always hold; of each disjunction one option holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from istc_replay.datatypes import Corridor, FloatArray, read_only

IntArray = NDArray[np.int64]

#: Columns of a cube.
X_MIN, X_MAX, Y_MIN, Y_MAX = range(4)

#: Index of a constant where a variable's index is expected.
CONSTANT = -1


@dataclass(frozen=True, slots=True)
class Limits:
    """One vehicle's limits on its pivotal points; feedback from layer 2 makes them tighter."""

    cone: float
    acceleration_mps2: float
    deceleration_mps2: float
    lateral_acceleration_mps2: float
    tightness: float = 1.0  # 1 where nothing was tightened

    def tightened(self, factor: float = 0.7) -> Limits:
        """Return limits that leave more to layer 2."""
        return Limits(
            self.cone * factor,
            self.acceleration_mps2 * factor,
            self.deceleration_mps2 * factor,
            self.lateral_acceleration_mps2 * factor,
            self.tightness * factor,
        )


@dataclass(frozen=True, slots=True)
class Row:
    """One linear row lower <= sum weight * z[index] <= upper of an equation of the paper."""

    equation: str
    index: tuple[int, ...]
    weight: tuple[float, ...]
    lower: float
    upper: float


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


@dataclass(frozen=True, slots=True)
class Option:
    """One way to keep two boxes apart: z[larger] - z[smaller] >= gap; CONSTANT counts as 0."""

    larger: int
    smaller: int
    gap: float


@dataclass(frozen=True, slots=True)
class Disjunction:
    """At least one option holds: eq. (5) for two vehicles, eq. (6) for a vehicle and an obstacle.

    Options that the bounds rule out are left out, and a disjunction that the bounds satisfy does
    not appear. Without options the conflict has no solution.
    """

    equation: str
    unit: int
    first: str
    second: str
    options: tuple[Option, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CorridorProblem:
    """Minimise sum quadratic (z - reference)^2 + linear z, eq. (4), over rows and disjunctions.

    All arrays have one entry a variable. `witness` (n, 2) and `witness_offset_m` (n, 2) give, for
    a cube's wall, the two points that the least cube must hold: z[witness] + offset (CONSTANT: the
    offset alone); rows of pivotal variables are unused.
    """

    blocks: tuple[Block, ...]
    rows: tuple[Row, ...]
    disjunctions: tuple[Disjunction, ...]
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

    @property
    def binaries(self) -> int:
        """Number of options to choose from."""
        return sum(len(disjunction.options) for disjunction in self.disjunctions)

    @property
    def pivot_indices(self) -> IntArray:
        """Indices of all pivotal variables."""
        return np.concatenate([block.pivot[1:].ravel() for block in self.blocks])

    @property
    def impossible(self) -> tuple[Disjunction, ...]:
        """Conflicts that no choice resolves."""
        return tuple(d for d in self.disjunctions if not d.options)

    def objective(self, z: FloatArray) -> float:
        """Value of eq. (4)."""
        return float(self.quadratic @ (z - self.reference) ** 2 + self.linear @ z)

    def least_cubes(self, z: FloatArray) -> FloatArray:
        """Put every cube's walls at the least cube around its pivotal points; returns a new z."""
        extended = np.append(z, 0.0)
        points = extended[self.witness] + self.witness_offset_m
        walls = np.array(z)
        cubes = np.concatenate([block.cube for block in self.blocks])
        low, high = cubes[:, [X_MIN, Y_MIN]], cubes[:, [X_MAX, Y_MAX]]
        walls[low] = points[low].min(axis=-1)
        walls[high] = points[high].max(axis=-1)
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


@dataclass(frozen=True, slots=True, eq=False)
class OptionTable:
    """The disjunctions as padded arrays (D, 4), for evaluation in one go; no option: gap inf."""

    larger: IntArray
    smaller: IntArray
    gap: FloatArray

    @classmethod
    def of(cls, disjunctions: Sequence[Disjunction]) -> OptionTable:
        """Tabulate disjunctions."""
        shape = (len(disjunctions), 4)
        larger = np.full(shape, CONSTANT, dtype=np.int64)
        smaller = np.full(shape, CONSTANT, dtype=np.int64)
        gap = np.full(shape, np.inf)
        for d, disjunction in enumerate(disjunctions):
            for o, option in enumerate(disjunction.options):
                larger[d, o], smaller[d, o], gap[d, o] = option.larger, option.smaller, option.gap
        return cls(larger, smaller, gap)

    def slack(self, z: FloatArray) -> FloatArray:
        """How far each option holds at z (D, 4) [m]; negative where it does not."""
        extended = np.append(z, 0.0)
        return np.asarray(extended[self.larger] - extended[self.smaller] - self.gap)
