"""A window's plan, what it changed, and its certificates."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from istc_replay.datatypes.certificates import Certificate
from istc_replay.datatypes.corridors import Corridors
from istc_replay.datatypes.guidance import Guidance
from istc_replay.datatypes.scenario import Exclusion, Scenario
from istc_replay.datatypes.solves import SolveRecord
from istc_replay.datatypes.trajectories import Lateral, Trajectory, Undrivable

#: A vehicle that ends its recording standing has arrived where its plan ends this near.
ARRIVED_M = 1.0


class WindowStatus(StrEnum):
    """How a window ended."""

    CERTIFIED = "certified"  # every plannable vehicle has a plan, every check passes
    PARTIAL = "partial"  # some plannable vehicles stay as recorded, the others' plans pass every check
    NOT_CERTIFIED = "not_certified"  # a plan, but a check fails or cannot be judged
    GOAL_NOT_REACHED = "goal_not_reached"  # every check passes, but a scene's vehicle ends elsewhere
    CONFLICT_LEFT = "conflict_left"  # no corridors: a pair is not kept apart in a time unit
    NO_CORRIDORS = "no_corridors"  # for any other reason
    NOT_DRIVABLE = "not_drivable"  # corridors, but a vehicle sticks out of its own in a time unit
    NOTHING_TO_PLAN = "nothing_to_plan"


#: Statuses of windows whose plans pass every check.
SOUND = frozenset({WindowStatus.CERTIFIED, WindowStatus.PARTIAL, WindowStatus.GOAL_NOT_REACHED})


@dataclass(frozen=True, slots=True)
class WindowPlan:
    """A window's whole result before it is certified.

    `frozen` vehicles could have been planned but stay as recorded: obstacles to the others. The
    gaps [m] are those that layer 1 promised, None where they are the configuration's. `late` are vehicles
    of a scene that do not come to their goals.
    """

    scenario: Scenario
    status: WindowStatus
    reason: str = ""
    guidance: tuple[Guidance, ...] = ()
    corridors: Corridors | None = None
    trajectories: tuple[Trajectory, ...] = ()
    undrivable: tuple[Undrivable, ...] = ()
    rounds: int = 1
    records: tuple[SolveRecord, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    frozen: tuple[Exclusion, ...] = ()
    vehicle_gap_m: float | None = None
    obstacle_gap_m: float | None = None
    lateral: tuple[Lateral, ...] = ()
    late: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RecordedGap:
    """The least gap of two recorded boxes (negative: they overlap), whose, and when."""

    min_separation_m: float
    pair: tuple[str, str]
    time_ns: int


@dataclass(frozen=True, slots=True)
class Change:
    """What a plan changed of one vehicle's guidance; zeros where nothing had to change.

    `delay_s`: at the plan's end, later (negative: earlier) than the guidance at the same place.
    `deviation_m`, `lateral_m`: the largest distance from the guidance at the same instant, and
    across its path. `acceleration_rms_mps2`, `braking_mps2`: rise of the root mean square
    acceleration, and of the hardest braking. `clearance_m`: least gap to any other road user as
    planned, and `clearance_gained_m` what that is more than by guidance; None where nobody is near.
    """

    vehicle_id: str
    changed: bool
    delay_s: float = 0.0
    deviation_m: float = 0.0
    lateral_m: float = 0.0
    acceleration_rms_mps2: float = 0.0
    braking_mps2: float = 0.0
    clearance_m: float | None = None
    clearance_gained_m: float | None = None


@dataclass(frozen=True, slots=True)
class WindowOutcome:
    """A window's plan as its certificates judge it, the least gap of its recording, and both compared.

    `changes` are what coordination changed of the guidance, for vehicles that have a trajectory.
    """

    plan: WindowPlan
    certificates: tuple[Certificate, ...] = ()
    recorded: RecordedGap | None = None
    against_plan: tuple[dict[str, Any], ...] = ()  # rows of AGAINST_PLAN_SCHEMA
    changes: tuple[Change, ...] = ()
