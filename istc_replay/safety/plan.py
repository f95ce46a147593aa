"""A window's plan as it stands written in a result, and what is missing from it.

Times are int64 nanoseconds from the window's start, positions in the window's corridor frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray, Frame

IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Fault:
    """Something missing or malformed: whose, when [s from the window's start], and what."""

    vehicle_id: str
    time_s: float | None
    detail: str


@dataclass(frozen=True, slots=True, eq=False)
class Boxes:
    """Axis-aligned boxes that hold on closed spans of time.

    `spans_ns` (K, 2) starts and ends, `walls_m` (K, 4) x_min, x_max, y_min, y_max, `units` (K,) k.
    """

    units: IntArray
    spans_ns: IntArray
    walls_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class VehiclePlan:
    """A written trajectory: `knots_ns` (S,), `states` (S, 6): x, y of the box centre, heading,
    steering, speed, acceleration, `controls` (S-1, 2): steering rate and jerk, each held to the
    next knot, `dimensions` (4,): length, width, wheelbase, rear axle to centre [m].
    """

    knots_ns: IntArray
    states: FloatArray
    controls: FloatArray
    dimensions: FloatArray


@dataclass(slots=True, eq=False)
class WrittenPlan:
    """What one window's plan says: sound cubes and trajectories by vehicle, obstacles, faults.

    `as_recorded` names the road users that should be among the obstacles. `traffic` says by which rules
    it was planned.

    The gaps are those that it promises [m], None where it is silent. `handed_over` vehicles promise
    to start where the plan of the window before, `before`, has led them.
    """

    index: int
    start_ns: int
    end_ns: int
    frame: Frame
    vehicles: tuple[str, ...]
    as_recorded: tuple[str, ...] = ()
    traffic: bool = False
    vehicle_gap_m: float | None = None
    obstacle_gap_m: float | None = None
    handed_over: frozenset[str] = frozenset()
    before: WrittenPlan | None = None
    cubes: dict[str, Boxes] = field(default_factory=dict)
    plans: dict[str, VehiclePlan] = field(default_factory=dict)
    obstacles: dict[str, Boxes] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)
    obstacle_faults: list[Fault] = field(default_factory=list)
