"""Who comes to its goal in a scene, and what has layer 2 come there."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.apart import driven_through
from istc_replay.corridors.blocks import car_box_m
from istc_replay.datatypes import ARRIVED_M, read_only
from istc_replay.geometry import box_poses

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from istc_replay.datatypes import Corridor, Participant, Scenario, Trajectory

#: Whose last car-box stays this near to that of its goal has arrived [m].
_HOME_M = 0.6


def distance_left_m(participant: Participant, trajectory: Trajectory) -> float:
    """How far from where it was recorded to stand a vehicle ends [m]; 0 for who was not."""
    recording = participant.recording
    if not recording.ends_standing or participant.goes_on:
        return 0.0
    end = box_poses(trajectory.states[-1], trajectory.dimensions.rear_axle_to_centre_m)
    return float(np.hypot(*(recording.poses[-1] - end)[:2]))


def late_vehicles(participants: Sequence[Participant], found: Sequence[Trajectory]) -> dict[str, float]:
    """Vehicles that were recorded to stand at their goal, do not come to it, and end how far [m] away."""
    both = zip(participants, found, strict=True)
    left = {p.vehicle_id: distance_left_m(p, trajectory) for p, trajectory in both}
    return {vehicle: away_m for vehicle, away_m in left.items() if away_m > ARRIVED_M}


def late_text(late_m: Mapping[str, float], scenario: Scenario) -> str:
    """Who does not come to its goal, in one line; empty where everybody does."""
    told = []
    for participant in scenario.participants:
        if participant.vehicle_id in late_m:
            why = driven_through(participant, scenario)
            away = f"{participant.vehicle_id} by {late_m[participant.vehicle_id]:.1f} m"
            told.append(f"{away} ({why})" if why else away)
    return f"goal not reached: {', '.join(told)}" if told else ""


def drawn_home(corridor: Corridor, participant: Participant) -> Corridor | None:
    """Draw the last cube in about the goal, so that layer 2 ends there; None where layer 1 does not."""
    x, y, heading = participant.recording.poses[-1]
    goal, size = np.array([x, y]), participant.dimensions
    if np.hypot(*(corridor.pivots_m[-1] - goal)) > ARRIVED_M:
        return None
    half = car_box_m(np.array([heading]), 0.0, size.length_m, size.width_m)[0] / 2.0 + _HOME_M
    cubes = np.array(corridor.cubes_m)
    cubes[-1, ::2] = np.maximum(cubes[-1, ::2], goal - half)
    cubes[-1, 1::2] = np.minimum(cubes[-1, 1::2], goal + half)
    return replace(corridor, cubes_m=read_only(cubes))
