"""Handing a plan over: where the vehicles of one window's plan are when the next window begins."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.bicycle import dense_motion
from istc_replay.datatypes import (
    SOUND,
    FloatArray,
    Frame,
    StartState,
    Trajectory,
    WindowPlan,
    read_only,
)
from istc_replay.geometry import box_corners, box_poses, to_frame, to_map
from istc_replay.units import NS_PER_S, wrap_angle

if TYPE_CHECKING:
    from collections.abc import Sequence

    from istc_replay.datatypes import Dimensions, Guidance, Scenario

#: Rounding in times [s].
_INSTANT_S = 1e-6
#: Turns of a car that are tried [rad], and how little a box may stick out [m].
_SLACKS_RAD, _TOUCHING_M = (0.2, 0.15, 0.1, 0.06, 0.03, 0.0), 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Handed:
    """A planned vehicle when it is handed over, map frame: `pose` (3,) of its box centre.

    `ahead` (P, 4) is how its plan would have gone on: seconds since then, x, y, heading.
    """

    pose: FloatArray
    speed_mps: float
    steering_rad: float
    acceleration_mps2: float
    ahead: FloatArray

    def plan(self, frame: Frame, heading_rad: float) -> FloatArray:
        """How its plan would have gone on (P, 4), corridor frame, its first heading near the given one."""
        headings = np.unwrap(self.ahead[:, 3] - frame.yaw_rad)
        headings += 2.0 * np.pi * np.round((heading_rad - headings[0]) / (2.0 * np.pi))
        return read_only(np.column_stack([self.ahead[:, 0], to_frame(self.ahead[:, 1:3], frame), headings]))

    def start(self, frame: Frame, heading_rad: float) -> StartState:
        """The start in a corridor frame, its heading within half a turn of the given one."""
        x, y = to_frame(self.pose[:2], frame).tolist()
        heading = heading_rad + float(wrap_angle(self.pose[2] - frame.yaw_rad - heading_rad))
        return StartState(x, y, heading, self.speed_mps, self.steering_rad, self.acceleration_mps2)


def handed_over(before: WindowPlan | None, start_ns: int) -> dict[str, Handed]:
    """Where the vehicles of a certified plan are at an instant; nobody of any other plan."""
    if before is None or before.status not in SOUND:
        return {}
    frame, at_s = before.scenario.window.frame, (start_ns - before.scenario.window.start_ns) / NS_PER_S
    found = {}
    for trajectory in before.trajectories:
        state = state_at(trajectory, at_s)
        if state is None:
            continue
        _, _, _, steering, speed, acceleration = state
        x, y, heading = box_poses(state, trajectory.dimensions.rear_axle_to_centre_m)
        pose = read_only([*to_map([x, y], frame), heading + frame.yaw_rad])
        later = trajectory.times_s > at_s + _INSTANT_S
        poses = box_poses(trajectory.states[later], trajectory.dimensions.rear_axle_to_centre_m)
        ahead = np.column_stack(
            [trajectory.times_s[later] - at_s, to_map(poses[:, :2], frame), poses[:, 2] + frame.yaw_rad]
        )
        ahead = read_only(np.vstack([[0.0, *pose], ahead]))
        found[trajectory.vehicle_id] = Handed(pose, speed, steering, acceleration, ahead)
    return found


def units_since(before: WindowPlan, start_ns: int) -> int | None:
    """Time units of a plan that are over at an instant; None in the midst of one."""
    window = before.scenario.window
    units = (start_ns - window.start_ns) / NS_PER_S / window.unit_s
    return round(units) if abs(units - round(units)) < _INSTANT_S else None


def motion_before(
    before: WindowPlan | None, scenario: Scenario, guidance: Sequence[Guidance]
) -> tuple[Guidance, ...]:
    """How the plan before goes on from here, and stands in the end, as frames of eq. (9) to (12).

    The rows that are written about these frames hold for this motion, and so do all separations: each
    car-box turns no further than its cubes allow.

    Parameters
    ----------
    before : WindowPlan, optional
        The plan that handed its vehicles over.
    scenario, guidance
        The window that begins, and the guidance of its vehicles.

    Returns
    -------
    tuple of Guidance
        One a vehicle; none where someone is new, or the time units are others.
    """
    if before is None or before.corridors is None or before.status not in SOUND:
        return ()
    window, old = scenario.window, before.scenario.window
    shift = units_since(before, window.start_ns)
    if (
        shift is None
        or abs(old.unit_s - window.unit_s) > _INSTANT_S
        or old.frame.yaw_rad != window.frame.yaw_rad
    ):
        return ()
    corridors = {c.vehicle_id: c for c in before.corridors.corridors}
    driven = {t.vehicle_id: t for t in before.trajectories}
    frames = []
    for participant, guide in zip(scenario.participants, guidance, strict=True):
        name, size = participant.vehicle_id, participant.dimensions
        if name not in corridors or participant.approach is None:
            return ()
        cubes, count = corridors[name].cubes_m, participant.units + 1
        poses = box_poses(driven[name].states, size.rear_axle_to_centre_m)
        poses = poses[:: len(driven[name].controls) // len(cubes)][shift:]
        slack = held(_slack_rad(poses, cubes[shift:], size), count)
        poses = np.array(held(poses, count))
        poses[:, :2] = to_frame(to_map(poses[:, :2], old.frame), window.frame)
        poses[:, 2] += 2.0 * np.pi * np.round((participant.start.heading_rad - poses[0, 2]) / (2.0 * np.pi))
        frames.append(
            replace(
                guide,
                points_m=read_only(poses[:, :2]),
                headings_rad=read_only(poses[:, 2]),
                slack_rad=read_only(slack),
            )
        )
    return tuple(frames)


def _slack_rad(poses: FloatArray, cubes_m: FloatArray, size: Dimensions) -> FloatArray:
    """How far (K+1,) the car may turn at unit boundaries and still be within the cubes on both sides."""
    low = np.maximum(cubes_m[:-1, 0::2], cubes_m[1:, 0::2])
    high = np.minimum(cubes_m[:-1, 1::2], cubes_m[1:, 1::2])
    low = np.vstack([cubes_m[:1, 0::2], low, cubes_m[-1:, 0::2]])
    high = np.vstack([cubes_m[:1, 1::2], high, cubes_m[-1:, 1::2]])
    room = 2.0 * np.minimum(poses[:, :2] - low, high - poses[:, :2])  # (K+1, 2)
    found = np.full(len(poses), _SLACKS_RAD[-1])
    for slack in _SLACKS_RAD[::-1]:
        turns = np.linspace(-slack, slack, 5)
        extents = np.stack(
            [
                np.ptp(box_corners(0.0, 0.0, poses[:, 2] + t, size.length_m, size.width_m), axis=-2)
                for t in turns
            ]
        ).max(axis=0)
        found = np.where((extents <= room + _TOUCHING_M).all(axis=1), np.maximum(found, slack), found)
    return found


def held(rows: FloatArray, count: int) -> FloatArray:
    """So many rows: the first of them, or all and then the last one again and again."""
    rows = rows[:count]
    return np.concatenate([rows, *[rows[-1:]] * (count - len(rows))])


def state_at(trajectory: Trajectory, at_s: float) -> list[float] | None:
    """The state (6,) that a plan's held controls cause at an instant; None outside of it."""
    times = trajectory.times_s
    if not times[0] - _INSTANT_S <= at_s <= times[-1] + _INSTANT_S:
        return None
    knot = min(max(int(np.searchsorted(times, at_s + _INSTANT_S, side="right")) - 1, 0), len(times) - 2)
    since_s = at_s - float(times[knot])
    if since_s <= _INSTANT_S:
        return [float(value) for value in trajectory.states[knot]]
    held = trajectory.controls[knot : knot + 1]
    dense, _, _ = dense_motion(
        trajectory.states[knot], held, since_s, trajectory.dimensions.wheelbase_m, since_s / 8.0
    )
    return [float(value) for value in dense[-1, -1]]
