"""Guidance at constant speed for every participant: along its lane line or its recorded path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from istc_replay.datatypes import FloatArray, Guidance, read_only
from istc_replay.guidance.path import Path, constant_speed, constant_speed_then_stop

if TYPE_CHECKING:
    from istc_replay.config import GuidanceConfig
    from istc_replay.datatypes import Participant, Scenario

#: A start farther than this from its lane line does not follow it.
LANE_REACH_M = 5.0
#: Below this speed a recorded vehicle counts as standing.
STANDING_MPS = 0.5
_SAMPLES_PER_UNIT = 10


def build_guidance(scenario: Scenario, config: GuidanceConfig) -> tuple[Guidance, ...]:
    """Build the guidance of every participant, in their order.

    A constant speed is given to the path (the paper's rule): the configured one, or the recorded
    mean while moving. A vehicle that stands at the end of its recording brakes to stand there.
    """
    return tuple(_guidance(p, scenario.window.unit_s, config) for p in scenario.participants)


def recorded_guidance(
    participant: Participant, unit_s: float, times_s: FloatArray, poses: FloatArray
) -> Guidance:
    """Guidance by the recorded law of time.

    Parameters
    ----------
    participant : Participant
        Whose it is.
    unit_s : float
        Length of a time unit [s].
    times_s, poses : (S,) and (S, 3) arrays
        A drivable motion over exactly its units, box centre; every unit holds equally many steps.
    """
    per_unit = (len(times_s) - 1) // participant.units
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    at_units = poses[::per_unit]
    return Guidance(
        vehicle_id=participant.vehicle_id,
        kind="recorded",
        points_m=read_only(at_units[:, :2]),
        headings_rad=read_only(at_units[:, 2]),
        speed_mps=float(steps.sum() / (participant.units * unit_s)),
        times_s=read_only(times_s),
        poses=read_only(poses),
    )


def _guidance(participant: Participant, unit_s: float, config: GuidanceConfig) -> Guidance:
    kind, path, stop_m = _path(participant, config)
    speed = config.speed_mps or recorded_speed_mps(participant)
    samples = np.linspace(0.0, participant.units * unit_s, participant.units * _SAMPLES_PER_UNIT + 1)
    if stop_m is not None and participant.recording.speeds_mps[-1] < STANDING_MPS:
        arc = constant_speed_then_stop(samples, speed, stop_m, config.stop_deceleration_mps2)
    else:
        arc = constant_speed(samples, speed)
    poses = path.at(arc)
    poses[0, :2] = participant.start.x_m, participant.start.y_m
    at_units = poses[::_SAMPLES_PER_UNIT]
    return Guidance(
        vehicle_id=participant.vehicle_id,
        kind=kind,
        points_m=read_only(at_units[:, :2]),
        headings_rad=read_only(at_units[:, 2]),
        speed_mps=speed,
        times_s=read_only(samples + participant.first_unit * unit_s),
        poses=read_only(poses),
    )


def _path(participant: Participant, config: GuidanceConfig) -> tuple[str, Path, float | None]:
    """Kind and path of a guidance, and where on it a vehicle stops that is recorded to stand in the end."""
    poses = participant.recording.poses
    if participant.lane_m is not None and config.source != "recorded":
        lane = Path.through(participant.lane_m)
        arc, distance = lane.project(np.array([participant.start.x_m, participant.start.y_m]))
        if distance <= LANE_REACH_M and arc < lane.length_m:
            # An intent is driven to its end; who is in a lane of the road stops where it was recorded to.
            in_traffic = participant.lateral is not None
            stop_m = max(lane.project(poses[-1, :2])[0] - arc, 0.0) if in_traffic else None
            return "lane", _from(lane, arc), stop_m
    path = Path.through(poses[:, :2], poses[:, 2])
    return "recorded", path, path.length_m


def _from(path: Path, arc_m: float) -> Path:
    later = path.arc_m[path.arc_m > arc_m]
    poses = path.at(np.concatenate([[arc_m], later]))
    return Path.through(poses[:, :2], poses[:, 2])


def recorded_speed_mps(participant: Participant) -> float:
    """Mean recorded speed while moving [m/s]; 0 for a vehicle that never moves."""
    recording = participant.recording
    steps = np.hypot(*np.diff(recording.poses[:, :2], axis=0).T)
    seconds = np.diff(recording.times_s)
    moving: FloatArray = (steps > STANDING_MPS * seconds).astype(np.float64)
    if not moving.any():
        return 0.0
    return float(steps @ moving / (seconds @ moving))
