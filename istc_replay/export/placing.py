"""Plans placed where the recording is: box centres, the map frame, absolute time."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from istc_replay.datatypes import (
    SOUND,
    Dimensions,
    FloatArray,
    Frame,
    Log,
    Trajectory,
    Window,
    WindowPlan,
)
from istc_replay.geometry import box_poses, to_map
from istc_replay.units import NS_PER_S, seconds_to_ns, wrap_angle

IntArray = NDArray[np.int64]

_NAME_LIMIT = 80


@dataclass(frozen=True, slots=True, eq=False)
class PlannedMotion:
    """A vehicle's planned motion at the knots of its trajectory, box centre, map frame.

    `times_ns` (S,). `poses` (S, 3): x, y, heading in [-pi, pi). `speeds_mps`,
    `accelerations_mps2`, `steerings_rad` (S,). `controls` (S, 2): steering rate and jerk, each held
    from its knot to the next, 0 at the last.
    """

    vehicle_id: str
    window: int
    dimensions: Dimensions
    times_ns: IntArray
    poses: FloatArray
    speeds_mps: FloatArray
    accelerations_mps2: FloatArray
    steerings_rad: FloatArray
    controls: FloatArray


def planned_motion(trajectory: Trajectory, window: Window) -> PlannedMotion:
    """Place a trajectory (rear axle, corridor frame, seconds) in the map frame and in absolute time."""
    _, _, _, steering, speed, acceleration = trajectory.states.T
    poses = box_poses(trajectory.states, trajectory.dimensions.rear_axle_to_centre_m)
    return PlannedMotion(
        vehicle_id=trajectory.vehicle_id,
        window=window.index,
        dimensions=trajectory.dimensions,
        times_ns=absolute_ns(window, trajectory.times_s),
        poses=map_poses(poses, window.frame),
        speeds_mps=speed,
        accelerations_mps2=acceleration,
        steerings_rad=steering,
        controls=np.vstack([trajectory.controls, np.zeros((1, 2))]),
    )


def planned_motions(plan: WindowPlan) -> Iterator[PlannedMotion]:
    """Place the trajectories of a window in their order, if it is certified."""
    if plan.status in SOUND:
        for trajectory in plan.trajectories:
            if len(trajectory.times_s):
                yield planned_motion(trajectory, plan.scenario.window)


def map_poses(poses: ArrayLike, frame: Frame) -> FloatArray:
    """Turn poses (S, 3) of the corridor frame into the map frame, headings wrapped."""
    local = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    return np.column_stack([to_map(local[:, :2], frame), wrap_angle(local[:, 2] + frame.yaw_rad)])


def absolute_ns(window: Window, times_s: ArrayLike) -> IntArray:
    """Turn seconds from the window's start (S,) into absolute nanoseconds."""
    return np.asarray(np.rint(np.asarray(times_s) * NS_PER_S).astype(np.int64) + window.start_ns)


def unit_span_ns(window: Window, k: int) -> tuple[int, int]:
    """Start and end of the window's unit k [ns]."""
    return (
        window.start_ns + seconds_to_ns(k * window.unit_s),
        window.start_ns + seconds_to_ns((k + 1) * window.unit_s),
    )


def first_ns(log: Log, windows: Sequence[Window]) -> int:
    """Return the first instant of the states and windows, 0 where there are none [ns]."""
    times = [window.start_ns for window in windows]
    if log.states.height:
        times.append(log.states["time_ns"].min())  # type: ignore[arg-type]
    return min(times, default=log.start_ns or 0)


def topic_name(vehicle_id: str) -> str:
    """Name a vehicle within topics and frames; distinct ids get distinct names.

    Letters, digits and `_ . -` stay; other characters, and a first dot, become the percent escapes
    of their UTF-8 bytes. Long names are cut, and a digest of the whole id makes them distinct.
    """
    name = re.sub(r"[^A-Za-z0-9_.-]", lambda match: _escaped(match.group()), vehicle_id)
    if name.startswith("."):
        name = _escaped(".") + name[1:]
    if len(name) > _NAME_LIMIT:
        digest = hashlib.sha256(vehicle_id.encode()).hexdigest()[:32]
        # No escape begins with these two characters, so no other id has this name.
        name = f"{name[:_NAME_LIMIT]}%-{digest}"
    return name or "%"


def _escaped(character: str) -> str:
    return "".join(f"%{byte:02X}" for byte in character.encode("utf-8", "surrogatepass"))
