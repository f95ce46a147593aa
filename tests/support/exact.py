"""One small log and its plan, made by exact motion.

`car 1` drives straight with a constant jerk, `car 2` crosses at a constant speed, `car 3` comes in at the
second unit and drives an arc. `block` stands; `walker` moves from the third unit on.
"""

from __future__ import annotations

import itertools

import numpy as np
import polars as pl

from istc_replay.datatypes import (
    Certificate,
    Corridor,
    Corridors,
    Frame,
    Guidance,
    LaneLine,
    Log,
    Obstacle,
    Participant,
    Recording,
    Scenario,
    SceneObstacle,
    SolveRecord,
    SolveStatus,
    StartState,
    StaticScene,
    Trajectory,
    VehicleInfo,
    Verdict,
    Window,
    WindowPlan,
    WindowStatus,
    read_only,
)
from istc_replay.geometry import box_corners, shift_along, to_map
from istc_replay.units import wrap_angle

from .participants import CAR
from .tracks import log_of, track

START_NS = 1_700_000_000_000_000_000
FRAME = Frame(x_m=120.0, y_m=-40.0, yaw_rad=0.3)
UNITS = 6

#: Start of the rear axle in the corridor frame, speed, jerk, steering angle, first unit, priority.
MOTIONS = {
    "car 1": ((-15.0, 0.0, 0.0), 4.0, 0.2, 0.0, 0, 0.5),
    "car 2": ((25.0, -15.0, np.pi / 2), 5.0, 0.0, 0.0, 0, 0.2),
    "car 3": ((15.0, 14.0, np.pi), 4.0, 0.0, 0.03, 1, 0.01),
}


def _motion(vehicle: str, times_s: np.ndarray) -> np.ndarray:
    """Rear-axle states (S, 6) of exact motion: a straight line with jerk, or an arc at constant speed."""
    (x, y, heading), v0, jerk, steering, first_unit, _ = MOTIONS[vehicle]
    t = times_s - first_unit
    s = v0 * t + jerk * t**3 / 6.0
    curvature = np.tan(steering) / CAR.wheelbase_m
    if curvature == 0.0:
        headings = np.full_like(t, heading)
        points = np.stack([x + s * np.cos(heading), y + s * np.sin(heading)], axis=-1)
    else:
        headings = heading + curvature * s
        points = np.stack(
            [
                x + (np.sin(headings) - np.sin(heading)) / curvature,
                y - (np.cos(headings) - np.cos(heading)) / curvature,
            ],
            axis=-1,
        )
    rest = [headings, np.full_like(t, steering), v0 + jerk * t**2 / 2.0, jerk * t]
    return np.column_stack([points, *rest])


def _centres(states: np.ndarray) -> np.ndarray:
    centres = shift_along(states[:, 0], states[:, 1], states[:, 2], CAR.rear_axle_to_centre_m)
    return np.column_stack([centres, states[:, 2]])  # (S, 3)


def _trajectory(vehicle: str) -> Trajectory:
    _, _, jerk, _, first_unit, _ = MOTIONS[vehicle]
    times = np.round(np.arange(first_unit, UNITS + 1e-9, 0.2), 9)
    controls = np.tile([0.0, jerk], (len(times) - 1, 1))
    states = read_only(_motion(vehicle, times), 6)
    return Trajectory(vehicle, CAR, read_only(times), states, read_only(controls, 2), 1.25)


def _corridor(vehicle: str) -> Corridor:
    first_unit = MOTIONS[vehicle][4]
    cubes = []
    for k in range(first_unit, UNITS):
        poses = _centres(_motion(vehicle, np.linspace(k, k + 1, 11)))
        corners = box_corners(poses[:, 0], poses[:, 1], poses[:, 2], CAR.length_m, CAR.width_m).reshape(-1, 2)
        (x_min, y_min), (x_max, y_max) = corners.min(axis=0) - 0.3, corners.max(axis=0) + 0.3
        cubes.append((x_min, x_max, y_min, y_max))
    pivots = _centres(_motion(vehicle, np.arange(first_unit, UNITS + 1.0)))[:, :2]
    return Corridor(
        vehicle, first_unit, read_only(cubes, 4), read_only(pivots, 2), read_only(pivots + 0.1, 2)
    )


def _recorded(vehicle: str) -> Recording:
    """What was driven instead: the same motion half a metre aside, 10 Hz."""
    times = np.round(np.arange(MOTIONS[vehicle][4], UNITS + 1e-9, 0.1), 9)
    states = _motion(vehicle, times)
    poses = _centres(states)
    poses[:, :2] = shift_along(poses[:, 0], poses[:, 1], poses[:, 2] + np.pi / 2, 0.5)
    return Recording(read_only(times), read_only(poses, 3), read_only(states[:, 4]))


def _participant(vehicle: str) -> Participant:
    recording, first_unit, priority = _recorded(vehicle), MOTIONS[vehicle][4], MOTIONS[vehicle][5]
    x, y, heading = (float(value) for value in recording.poses[0])
    start = StartState(x, y, heading, float(recording.speeds_mps[0]))
    return Participant(vehicle, CAR, priority, first_unit, UNITS - first_unit, start, recording)


def _guidance(vehicle: str) -> Guidance:
    participant = _participant(vehicle)
    recording = participant.recording
    ends = recording.poses[::10]
    return Guidance(
        vehicle,
        "recorded",
        read_only(ends[:, :2], 2),
        read_only(ends[:, 2]),
        MOTIONS[vehicle][1],
        recording.times_s,
        recording.poses,
    )


def _states_table() -> pl.DataFrame:
    tables = []
    for vehicle in MOTIONS:
        recording = _recorded(vehicle)
        points = to_map(recording.poses[:, :2], FRAME)
        columns = {
            "x_m": points[:, 0],
            "y_m": points[:, 1],
            "heading_rad": wrap_angle(recording.poses[:, 2] + FRAME.yaw_rad),
            "speed_mps": recording.speeds_mps,
            "length_m": CAR.length_m,
            "width_m": CAR.width_m,
            "topic": f"/vehicles/{vehicle}/state",
        }
        tables.append(track(vehicle, recording.times_s, START_NS, **columns))
    return pl.concat(tables)


def exact_log() -> Log:
    """A log of three cars over 6 s, in which each drove half a metre beside its plan."""
    block = to_map([0.0, -8.0], FRAME)
    lanes = [
        LaneLine(f"lane {i}", read_only(to_map(points, FRAME), 2), vehicle)
        for i, (vehicle, points) in enumerate(
            {
                "car 1": [[-30.0, 0.0], [30.0, 0.0]],
                "car 2": [[25.0, -30.0], [25.0, 0.0], [25.0, 30.0]],
            }.items()
        )
    ]
    scene = StaticScene(
        lane_lines=tuple(lanes),
        obstacles=(SceneObstacle("block", float(block[0]), float(block[1]), FRAME.yaw_rad, 6.0, 3.0),),
        vehicles=tuple(VehicleInfo(vehicle, MOTIONS[vehicle][5], CAR) for vehicle in MOTIONS),
    )
    return log_of(_states_table(), path="synthetic.mcap", chunks=1, scene=scene)


def _obstacles() -> tuple[Obstacle, ...]:
    block = np.tile([-3.0, 3.0, -9.5, -6.5], (UNITS, 1))
    walker = np.full((UNITS, 4), np.nan)
    walker[2:] = [[-20.0 + k, -18.5 + k, -14.0, -13.0] for k in range(2, UNITS)]
    outline = [[3.0, -6.5], [3.0, -9.5], [-3.0, -9.5], [-3.0, -6.5]]
    return (
        Obstacle("block", read_only(block, 4), read_only(outline, 2)),
        Obstacle("walker", read_only(walker, 4)),
    )


def exact_plan() -> WindowPlan:
    """The plan of the log's one window, in a turned frame."""
    window = Window(0, START_NS, START_NS + UNITS * 1_000_000_000, 1.0, UNITS, FRAME)
    records = (
        SolveRecord("corridors", "tree", "daqp", SolveStatus.FEASIBLE, objective=27.2, nodes=11, wall_s=0.05),
        SolveRecord(
            "corridors",
            "certificate",
            "cbc",
            SolveStatus.OPTIMAL,
            objective=27.2,
            bound=27.18,
            gap=0.001,
            wall_s=0.9,
            binaries=48,
        ),
    )
    corridors = Corridors(
        SolveStatus.OPTIMAL,
        tuple(_corridor(v) for v in MOTIONS),
        objective=27.2,
        bound=27.18,
        gap=0.001,
        found_by="tree",
        records=records,
    )
    solves = tuple(
        SolveRecord(
            "trajectory", "nlp", "ipopt", SolveStatus.OPTIMAL, v, objective=1.25, iterations=12, wall_s=0.02
        )
        for v in MOTIONS
    )
    scenario = Scenario(
        window, tuple(_participant(v) for v in MOTIONS), _obstacles(), None, vehicles_present=len(MOTIONS)
    )
    return WindowPlan(
        scenario,
        WindowStatus.CERTIFIED,
        guidance=tuple(_guidance(v) for v in MOTIONS),
        corridors=corridors,
        trajectories=tuple(_trajectory(v) for v in MOTIONS),
        records=records + solves,
    )


def exact_certificates() -> list[Certificate]:
    """Checks of the plan; one of them fails."""
    pairs = list(itertools.combinations(MOTIONS, 2))
    return [
        Certificate(0, "disjoint", Verdict.PASS, 0.8, "m", 2.0, pairs[0], "cubes of unit 2"),
        Certificate(
            0, "dynamics", Verdict.FAIL, -0.07, "m", 5.4, ("car 3",), "drift from the written states"
        ),
        Certificate(0, "overlap", Verdict.NOT_APPLICABLE, None, "m"),
    ]
