"""Corridors built by hand, and a judge of trajectories that shares no code with the solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from istc_replay.config import TrajectoriesConfig
from istc_replay.datatypes import (
    Corridor,
    Guidance,
    Participant,
    Recording,
    StartState,
    Trajectory,
    read_only,
)
from istc_replay.trajectories.plan import TrajectoryOutcome, TrajectoryPlanner

from .participants import CAR

SPEED_MAX_MPS = 10.0


@dataclass(frozen=True)
class Course:
    """What layer 1 hands over for one vehicle, and where the vehicle starts."""

    start: StartState
    cubes: NDArray
    pivots: NDArray
    headings: NDArray
    unit_s: float = 1.0
    first_unit: int = 0

    def turned(self, quarters: int, shift: tuple[float, float] = (0.0, 0.0)) -> Course:
        """The course turned by quarters of a turn about the origin, then shifted."""
        angle = quarters * np.pi / 2
        rotation = np.round([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return self._mapped(lambda points: points @ rotation.T + shift, lambda heading: heading + angle)

    def mirrored(self) -> Course:
        """The course seen in the x axis."""
        return self._mapped(lambda points: points * [1.0, -1.0], lambda heading: -heading)

    def _mapped(self, place: Callable[[NDArray], NDArray], turn: Callable[[NDArray], NDArray]) -> Course:
        low, high = place(self.cubes[:, [0, 2]]), place(self.cubes[:, [1, 3]])
        low, high = np.minimum(low, high), np.maximum(low, high)
        x, y = place(np.array([self.start.x_m, self.start.y_m]))
        start = StartState(
            float(x),
            float(y),
            float((turn(self.start.heading_rad) + np.pi) % (2 * np.pi) - np.pi),
            self.start.speed_mps,
        )
        cubes = np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)
        wrapped = (turn(self.headings) + np.pi) % (2 * np.pi) - np.pi
        return Course(start, cubes, place(self.pivots), wrapped, self.unit_s, self.first_unit)


def box_at(centre: NDArray, heading: float, slack_rad: float = np.deg2rad(25)) -> NDArray:
    """Least cube (4,) around a car at a centre whose heading may be off by the slack."""
    headings = heading + np.linspace(-slack_rad, slack_rad, 51)
    c, s = np.abs(np.cos(headings)), np.abs(np.sin(headings))
    half_x = np.max(CAR.length_m * c + CAR.width_m * s) / 2
    half_y = np.max(CAR.length_m * s + CAR.width_m * c) / 2
    return np.array([centre[0] - half_x, centre[0] + half_x, centre[1] - half_y, centre[1] + half_y])


def course_along(
    pivots: NDArray,
    headings: NDArray,
    speed_mps: float,
    room_m: float = 0.0,
    slack_rad: float = np.deg2rad(25),
    unit_s: float = 1.0,
) -> Course:
    """A course of least cubes around pivotal points (K+1, 2), widened by some room.

    As layer 1 gives them: each cube holds the box at both its pivotal points, at the start the
    car-box alone.
    """
    slacks = [0.0] + [slack_rad] * (len(pivots) - 1)
    boxes = np.array([box_at(p, h, s) for p, h, s in zip(pivots, headings, slacks, strict=True)])
    low, high = np.minimum(boxes[:-1], boxes[1:]), np.maximum(boxes[:-1], boxes[1:])
    cubes = np.stack([low[:, 0], high[:, 1], low[:, 2], high[:, 3]], axis=1) + room_m * np.array(
        [-1, 1, -1, 1]
    )
    start = StartState(*map(float, pivots[0]), float(headings[0]), speed_mps)
    return Course(start, cubes, np.asarray(pivots), np.asarray(headings), unit_s)


def driven_path(
    curvature: Callable[[float], float], speed: Callable[[float], float], units: int, unit_s: float
) -> tuple[NDArray, NDArray]:
    """Box centres (K+1, 2) and headings (K+1,) of a rear axle that follows a curvature of time."""
    steps, h = 1000, unit_s / 1000
    x = y = heading = 0.0
    rows = [(CAR.rear_axle_to_centre_m, 0.0, 0.0)]
    for unit in range(units):
        for step in range(steps):
            t = unit * unit_s + step * h
            v = speed(t)
            x, y = x + v * np.cos(heading) * h, y + v * np.sin(heading) * h
            heading += v * curvature(t) * h
        ahead = CAR.rear_axle_to_centre_m
        rows.append((x + ahead * np.cos(heading), y + ahead * np.sin(heading), heading))
    path = np.array(rows)
    return path[:, :2], path[:, 2]


def s_bend(units: int = 8, room_m: float = 0.0, unit_s: float = 1.0, radius_m: float = 12.0) -> Course:
    """A left turn and a right turn at 5 m/s, the steering changing smoothly."""
    span = units * unit_s

    def curvature(t: float) -> float:
        return float(np.sin(2 * np.pi * t / span) / radius_m)

    pivots, headings = driven_path(curvature, lambda _: 5.0, units, unit_s)
    return course_along(pivots, headings, 5.0, room_m, unit_s=unit_s)


def plan(
    course: Course,
    config: TrajectoriesConfig | None = None,
    planner: TrajectoryPlanner | None = None,
    speed_max_mps: float = SPEED_MAX_MPS,
) -> TrajectoryOutcome:
    """Plan a course as the only vehicle, named "a"."""
    units = len(course.cubes)
    start = course.start
    pose = [[start.x_m, start.y_m, start.heading_rad]]
    recording = Recording(read_only([0.0]), read_only(pose), read_only([start.speed_mps]))
    participant = Participant("a", CAR, 1.0, course.first_unit, units, start, recording)
    pivots = read_only(course.pivots)
    corridor = Corridor("a", course.first_unit, read_only(course.cubes), pivots, pivots)
    headings = read_only(course.headings)
    guidance = Guidance("a", "recorded", pivots, headings, 5.0, read_only([0.0]), read_only(pose))
    planner = planner or TrajectoryPlanner(config or TrajectoriesConfig(), course.unit_s)
    return planner.plan(participant, corridor, guidance, speed_max_mps)


def planned(course: Course, config: TrajectoriesConfig | None = None) -> Trajectory:
    """Plan a course that can be driven."""
    outcome = plan(course, config)
    assert outcome.undrivable is None, outcome.undrivable
    assert outcome.trajectory is not None
    return outcome.trajectory


def motion_at_1ms(trajectory: Trajectory) -> tuple[NDArray, NDArray]:
    """Times (n,) from the first knot and true states (n, 6), from the first knot and the controls alone.

    Heun's method at 1 ms on the bicycle written out once more.
    """
    knots = trajectory.times_s - trajectory.times_s[0]
    wheelbase = trajectory.dimensions.wheelbase_m
    times, states = [0.0], [np.array(trajectory.states[0])]
    for begin, end, (beta, jerk) in zip(knots[:-1], knots[1:], trajectory.controls, strict=True):
        steps = max(1, round((end - begin) / 1e-3))
        h = (end - begin) / steps

        def rate(s: NDArray, beta: float = beta, jerk: float = jerk) -> NDArray:
            turn = s[4] * np.tan(s[3]) / wheelbase
            return np.array([s[4] * np.cos(s[2]), s[4] * np.sin(s[2]), turn, beta, s[5], jerk])

        for step in range(steps):
            s = states[-1]
            first = rate(s)
            states.append(s + h / 2 * (first + rate(s + h * first)))
            times.append(begin + (step + 1) * h)
    return np.array(times), np.array(states)


def least_margin_m(trajectory: Trajectory, course: Course) -> float:
    """Least distance of the true motion's corners inside the cubes of their closed units."""
    times, states = motion_at_1ms(trajectory)
    size = trajectory.dimensions
    c, s = np.cos(states[:, 2]), np.sin(states[:, 2])
    margins = []
    for along in (
        size.rear_axle_to_centre_m + size.length_m / 2,
        size.rear_axle_to_centre_m - size.length_m / 2,
    ):
        for across in (size.width_m / 2, -size.width_m / 2):
            x, y = states[:, 0] + along * c - across * s, states[:, 1] + along * s + across * c
            for unit, (x_min, x_max, y_min, y_max) in enumerate(course.cubes):
                at = (times >= unit * course.unit_s - 1e-9) & (times <= (unit + 1) * course.unit_s + 1e-9)
                margins.append(min((x[at] - x_min).min(), (x_max - x[at]).min()))
                margins.append(min((y[at] - y_min).min(), (y_max - y[at]).min()))
    return float(min(margins))
