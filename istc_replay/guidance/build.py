"""Guidance at constant speed for every participant: along its lane line or its recorded path."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.datatypes import STANDING_MPS, FloatArray, Guidance, read_only
from istc_replay.guidance.other_routes import other_routes, standing_obstacles
from istc_replay.guidance.path import (
    Path,
    constant_speed,
    constant_speed_then_stop,
    eased,
    standing_in_the_end,
)
from istc_replay.road_frame import heading_slack

if TYPE_CHECKING:
    from istc_replay.config import GuidanceConfig
    from istc_replay.datatypes import Participant, Recording, Scenario

#: A start farther than this from its lane line does not follow it.
LANE_REACH_M = 5.0
_SAMPLES_PER_UNIT = 10
#: How far on it has come back to its path to a third [m], and rounding in times [s].
_BACK_M, _INSTANT_S = 10.0, 1e-6
#: Who goes on beyond the window brakes so to stand at its end: as hard as pivotal points may by default.
#: Its plan, which is smooth, begins so much earlier.
_STAND_MPS2, _BRAKES_BEFORE_S = 3.0, 0.5


def build_guidance(scenario: Scenario, config: GuidanceConfig) -> tuple[Guidance, ...]:
    """Build the guidance of every participant, in their order.

    A constant speed is given to the path (the paper's rule): the configured one, or the recorded
    mean while moving. A vehicle that stands at the end of its recording brakes to stand there. In a
    crowded scene it can tell other routes, too.
    """
    built = tuple(_guidance(p, scenario.window.unit_s, config) for p in scenario.participants)
    if not scenario.crowded:
        return built
    obstacles = standing_obstacles(scenario)
    return tuple(
        replace(guide, others=other_routes(guide.poses, p.dimensions, scenario.bounds_m, obstacles))
        for p, guide in zip(scenario.participants, built, strict=True)
    )


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
    recording = participant.route or participant.recording
    speed = config.speed_mps or recorded_speed_mps(recording)
    samples = np.linspace(0.0, participant.units * unit_s, participant.units * _SAMPLES_PER_UNIT + 1)
    start = np.array([participant.start.x_m, participant.start.y_m, participant.start.heading_rad])
    if participant.ahead is None:
        kind, poses = _constant(participant, start, samples, speed, config)
    else:
        kind, poses = _continued(participant, participant.ahead, samples, speed, config)
    poses[0, :2] = start[:2]
    at_units = poses[::_SAMPLES_PER_UNIT]
    slack = heading_slack(at_units, unit_s) if participant.ahead is not None else None
    return Guidance(
        vehicle_id=participant.vehicle_id,
        kind=kind,
        points_m=read_only(at_units[:, :2]),
        headings_rad=read_only(at_units[:, 2]),
        speed_mps=speed,
        times_s=read_only(samples + participant.first_unit * unit_s),
        poses=read_only(poses),
        slack_rad=None if slack is None else read_only(slack),
    )


def _constant(
    participant: Participant, start: FloatArray, times_s: FloatArray, speed: float, config: GuidanceConfig
) -> tuple[str, FloatArray]:
    """Kind and poses of a guidance at constant speed."""
    kind, path, stop_m = _path(participant, start, config)
    if stop_m is not None and _stands(participant):
        arc = constant_speed_then_stop(times_s, speed, stop_m, config.stop_deceleration_mps2)
    else:
        arc = constant_speed(times_s, speed)
    if participant.goes_on:
        arc = standing_in_the_end(times_s, arc, _STAND_MPS2)
    return kind, path.at(arc)


def _continued(
    participant: Participant, ahead: FloatArray, times_s: FloatArray, speed: float, config: GuidanceConfig
) -> tuple[str, FloatArray]:
    """Kind and poses of a guidance that goes on with the plan before, then along the path."""
    # The half next to the seam, for what follows may be done better; nor how the plan comes to stand.
    until_s = min(ahead[-1, 0] / 2.0, ahead[-1, 0] - speed / _STAND_MPS2 - _BRAKES_BEFORE_S)
    until_s = max(until_s, times_s[_SAMPLES_PER_UNIT])  # the first time unit: its car is steered
    ahead = ahead[: max(1, int(np.searchsorted(ahead[:, 0], until_s + _INSTANT_S, side="right")))]
    last, before = ahead[-1], ahead[max(len(ahead) - 2, 0)]
    kind, path, stop_m = _path(participant, last[1:], config)
    later = times_s > last[0] + _INSTANT_S
    planned = np.column_stack([np.interp(times_s, ahead[:, 0], column) for column in ahead[:, 1:].T])
    if later.any():
        pace = participant.start.speed_mps
        if len(ahead) > 1:
            pace = float(np.hypot(*(last[1:3] - before[1:3]))) / (last[0] - before[0])
        end_m = stop_m if stop_m is not None and _stands(participant) else np.inf
        since = np.concatenate([[0.0], times_s[later] - last[0]])
        arc = eased(since, pace, speed, end_m, config.stop_deceleration_mps2)
        if participant.goes_on:
            arc = standing_in_the_end(since, arc, _STAND_MPS2)
        on = path.at(arc[1:])
        on[:, 2] += 2.0 * np.pi * np.round((last[3] - on[0, 2]) / (2.0 * np.pi))
        # It comes back to the path by and by.
        off = (last[1:3] - path.at(np.zeros(1))[0, :2]) * np.exp(
            -arc[1:, None] / min(_BACK_M, max(end_m / 4.0, _INSTANT_S))
        )
        planned[later] = np.column_stack([on[:, :2] + off, on[:, 2]])
    return kind, planned


def _stands(participant: Participant) -> bool:
    """Whether it is recorded to stand in the end."""
    return (participant.route or participant.recording).ends_standing


def _path(
    participant: Participant, start: FloatArray, config: GuidanceConfig
) -> tuple[str, Path, float | None]:
    """Kind and path of a guidance, and where on it a vehicle stops that is recorded to stand in the end."""
    recording = participant.route or participant.recording
    poses = recording.poses
    if participant.lane_m is not None and config.source != "recorded":
        lane = Path.through(participant.lane_m)
        arc, distance = lane.project(start[:2])
        if distance <= LANE_REACH_M and arc < lane.length_m:
            # An intent is driven to its end; who is in a lane of the road stops where it was recorded to.
            in_traffic = participant.lateral is not None
            stop_m = max(lane.project(poses[-1, :2])[0] - arc, 0.0) if in_traffic else None
            return "lane", _from(lane, arc), stop_m
    path = Path.through(poses[:, :2], poses[:, 2])
    if participant.route is not None:  # of which it need not be at the start
        path = _from(path, path.place(start[:2], float(start[2])))
    return "recorded", path, path.length_m


def _from(path: Path, arc_m: float) -> Path:
    later = path.arc_m[path.arc_m > arc_m]
    poses = path.at(np.concatenate([[arc_m], later]))
    return Path.through(poses[:, :2], poses[:, 2])


def recorded_speed_mps(recording: Recording) -> float:
    """Mean recorded speed while moving [m/s]; 0 for a vehicle that never moves."""
    steps = np.hypot(*np.diff(recording.poses[:, :2], axis=0).T)
    seconds = np.diff(recording.times_s)
    moving: FloatArray = (steps > STANDING_MPS * seconds).astype(np.float64)
    if not moving.any():
        return 0.0
    return float(steps @ moving / (seconds @ moving))
