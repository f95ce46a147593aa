"""Participants that were recorded driving straight on."""

from __future__ import annotations

import numpy as np

from istc_replay.datatypes import Dimensions, Participant, Recording, StartState, read_only

#: The paper's car.
CAR = Dimensions(length_m=4.0, width_m=2.0, wheelbase_m=2.7, rear_axle_to_centre_m=1.35)


def straight_on(
    vehicle_id: str,
    start: tuple[float, float, float],
    times_s: np.ndarray,
    way_m: np.ndarray,
    speeds_mps: np.ndarray,
    units: int,
    priority: float = 1.0,
) -> Participant:
    """A car that drove ahead from a pose by these ways at these times."""
    x, y, heading = start
    headings = np.full(len(times_s), heading)
    poses = np.stack([x + way_m * np.cos(heading), y + way_m * np.sin(heading), headings], axis=-1)
    return Participant(
        vehicle_id=vehicle_id,
        dimensions=CAR,
        priority=priority,
        first_unit=0,
        units=units,
        start=StartState(x, y, heading, float(speeds_mps[0])),
        recording=Recording(read_only(times_s), read_only(poses), read_only(speeds_mps)),
    )
