"""What a vehicle would do alone."""

from __future__ import annotations

from dataclasses import dataclass

from istc_replay.datatypes.arrays import FloatArray
from istc_replay.datatypes.trajectories import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Guidance:
    """A vehicle's guidance trajectory, box centre, corridor frame.

    `points_m` (K+1, 2) and `headings_rad` (K+1,) at the unit boundaries of the vehicle, the
    first at its start; `times_s` (S,) from the window's start and `poses` (S, 3) for drawing
    and as the NLP's first guess. `kind` is recorded or lane. `slack_rad` (K+1,) is how far from
    its heading the car may turn, None where the configuration tells it. `motion` is the drivable
    motion that it tells of, where there is one: a plan that needs no change. `others` are other
    routes (R, 3) of the rear axle between its ends, in a crowded scene. `fastest_mps` (K,) is what the bends
    of its path allow in each unit, None where layer 1 alone decides.
    """

    vehicle_id: str
    kind: str
    points_m: FloatArray
    headings_rad: FloatArray
    speed_mps: float
    times_s: FloatArray
    poses: FloatArray
    slack_rad: FloatArray | None = None
    motion: Trajectory | None = None
    others: tuple[FloatArray, ...] = ()
    fastest_mps: FloatArray | None = None
