"""Layer 2: the motion of one vehicle within its corridor."""

from __future__ import annotations

from dataclasses import dataclass, field

from istc_replay.datatypes.arrays import FloatArray
from istc_replay.datatypes.scene import Dimensions


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """An in-corridor trajectory, eq. (16): rear axle, corridor frame.

    `times_s` (S,) from the window's start. `states` (S, 6): x, y, heading (unwrapped), steering
    delta, speed v, acceleration a of the rear axle. `controls` (S-1, 2): steering rate beta and
    jerk j, each held from its sample to the next.
    """

    vehicle_id: str
    dimensions: Dimensions
    times_s: FloatArray
    states: FloatArray
    controls: FloatArray
    cost: float
    costs: dict[str, float] = field(default_factory=dict)  # smoothness, comfort, pivotal


@dataclass(frozen=True, slots=True)
class Undrivable:
    """Where a vehicle cannot be driven in its corridor: the unit, and how far it would stick out."""

    vehicle_id: str
    unit: int
    slack_m: float
    detail: str


@dataclass(frozen=True, slots=True)
class Lateral:
    """How a plan of traffic keeps its lateral bound.

    `bounds` are what holds somewhere along its path: road, path, recording (which is itself at the
    road's edge). `excursion_m` is the largest distance of the centre from the recorded path,
    `margin_m` the least room left, and `bound` what bounds it there. `off_road_m` is how far the
    recorded box is beyond the road's edge; `sample` is the number of the pose of the least margin.
    """

    vehicle_id: str
    bounds: tuple[str, ...]
    excursion_m: float
    margin_m: float
    bound: str
    off_road_m: float = 0.0
    sample: int = 0
