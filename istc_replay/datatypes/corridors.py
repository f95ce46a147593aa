"""Layer 1: a cube of space for every vehicle and time unit."""

from __future__ import annotations

from dataclasses import dataclass

from istc_replay.datatypes.arrays import FloatArray
from istc_replay.datatypes.guidance import Guidance
from istc_replay.datatypes.solves import SolveRecord, SolveStatus


@dataclass(frozen=True, slots=True, eq=False)
class Corridor:
    """The spatio-temporal corridor of one vehicle, eq. (1), corridor frame.

    `cubes_m` (K, 4): x_min, x_max, y_min, y_max of unit first_unit + row.
    `pivots_m` (K+1, 2) and `references_m` (K+1, 2) at the unit boundaries.
    """

    vehicle_id: str
    first_unit: int
    cubes_m: FloatArray
    pivots_m: FloatArray
    references_m: FloatArray


@dataclass(frozen=True, slots=True)
class Conflict:
    """Two road users that were not kept apart, and in which time unit."""

    first: str
    second: str
    unit: int


@dataclass(frozen=True, slots=True)
class Corridors:
    """The interactive spatio-temporal corridors of one window, eq. (4).

    `corridors` is empty unless status is optimal or feasible. `gap` = (objective - bound) /
    max(1, |objective|). `reason` says in one line why there is no solution, or what of this one is out of
    the ordinary, `culprits` which vehicles (or pairs of road users) are in the way of one, and `conflicts`
    where pairs meet. `frames` are the guidance that eq. (9) to (12) were written about, one a corridor.
    """

    status: SolveStatus
    corridors: tuple[Corridor, ...] = ()
    frames: tuple[Guidance, ...] = ()
    objective: float | None = None
    bound: float | None = None
    gap: float | None = None
    found_by: str = ""
    reason: str = ""
    records: tuple[SolveRecord, ...] = ()
    culprits: tuple[tuple[str, ...], ...] = ()
    conflicts: tuple[Conflict, ...] = ()
