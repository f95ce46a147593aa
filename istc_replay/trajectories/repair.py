"""The recording repaired: the nearest motion of a car to the recorded one, without any corridor.

A recorded track is noisy and need not be one that a car can drive. The bicycle NLP, eq. (17) and
(18), tracks the recorded box centres; its solution keeps the recorded law of time and can be driven.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from istc_replay.bicycle import dense_motion, in_a_row
from istc_replay.config import TrajectoriesConfig
from istc_replay.datatypes import (
    FloatArray,
    Frame,
    Participant,
    SolveRecord,
    SolveStatus,
    Trajectory,
    read_only,
)
from istc_replay.geometry import box_poses, shift_along, to_frame, to_map
from istc_replay.trajectories.collocation import interval_end
from istc_replay.trajectories.knots import SOLVERS, KnotNlp
from istc_replay.trajectories.mapped import STATES, Model, Rows

#: Weights of the distance to the recorded centres [1/m^2] and headings [1/rad^2], of steering rate, jerk
#: and curvature.
_POSITION, _HEADING, _STEERING_RATE, _JERK, _CURVATURE = 20.0, 5.0, 0.5, 0.02, 0.1
#: What the start may differ by from the recorded one: along x and y [m], heading [rad], speed [m/s].
_START_M, _START_RAD, _START_MPS = 0.025, math.radians(6.0), 2.0
_STEP_S = 0.25
#: Poses in a control interval: guidance has one at every unit boundary, down to half an interval.
_SUBSTEPS = 6


@dataclass(frozen=True, slots=True, eq=False)
class RepairedMotion:
    """A drivable motion near a recording, corridor frame.

    `driven` are its knots and controls, of the rear axle. `times_s` (S,) from the window's start and
    `poses` (S, 3) sample the box centre; `deviation_m` is its largest distance from what it tracks.
    """

    driven: Trajectory
    times_s: FloatArray
    poses: FloatArray
    deviation_m: float

    def moved(self, before: Frame, after: Frame) -> RepairedMotion:
        """The motion in another frame."""
        turn = before.yaw_rad - after.yaw_rad

        def placed(rows: FloatArray) -> FloatArray:
            points = to_frame(to_map(rows[:, :2], before), after)
            return read_only(np.column_stack([points, rows[:, 2] + turn, rows[:, 3:]]))

        driven = replace(self.driven, states=placed(self.driven.states))
        return replace(self, driven=driven, poses=placed(self.poses))


def recorded_poses(participant: Participant, at_s: FloatArray) -> FloatArray:
    """Recorded poses (S, 3) at times (S,) from the window's start."""
    recording = participant.recording
    return np.stack([np.interp(at_s, recording.times_s, column) for column in recording.poses.T], axis=-1)


class RecordingRepairer:
    """Repairs recordings; keeps compiled NLPs of few numbers of control intervals.

    Parameters
    ----------
    config : TrajectoriesConfig
        Limits of eq. (18) and the budget of iterations.
    """

    def __init__(self, config: TrajectoriesConfig) -> None:
        self._config = config
        self._compiled: dict[tuple[int, float], KnotNlp] = {}

    def repair(
        self,
        participant: Participant,
        unit_s: float,
        speed_max_mps: float,
        tracked: Callable[[Participant, FloatArray], FloatArray] = recorded_poses,
    ) -> tuple[RepairedMotion | None, SolveRecord]:
        """Repair one recording.

        Parameters
        ----------
        participant : Participant
            Its recording, box centres.
        unit_s : float
            Length of a time unit; control intervals divide it.
        speed_max_mps : float
            Largest speed.
        tracked : callable
            Gives the poses (S, 3) to keep to at times (S,).

        Returns
        -------
        tuple
            The motion, None where the NLP finds none, and the record of the solve.
        """
        step_s, intervals = _cut(participant.units, unit_s)
        size, first_s = participant.dimensions, participant.first_unit * unit_s
        at_s = np.asarray(first_s + np.arange(intervals + 1) * step_s, dtype=np.float64)
        targets = tracked(participant, at_s)
        origin = targets[0, :2].copy()
        centres = targets[:, :2] - origin
        states = self._guess(participant, at_s, np.column_stack([centres, targets[:, 2]]))
        headings = states[:, 2].copy()
        lower, upper = self._bounds(participant, intervals, speed_max_mps)
        states = np.clip(states, lower, upper)
        rate, jerk = self._config.steering_rate_max_radps, self._config.jerk_max_mps3
        began = time.perf_counter()
        found = self._solver(intervals, step_s).solve(
            guess=(states, np.zeros((intervals, 2))),
            states=(lower, upper),
            controls_most=np.array([rate, jerk]),
            rows=(
                np.concatenate([[-_START_M, -_START_M], np.zeros(intervals)]),
                np.concatenate([[_START_M, _START_M], np.full(intervals, speed_max_mps)]),
            ),
            shared=np.array([size.wheelbase_m, size.rear_axle_to_centre_m]),
            own=np.column_stack([centres, headings]),
        )
        record = SolveRecord(
            layer="guidance",
            stage="repair",
            solver=SOLVERS,
            status=found.status,
            vehicle_id=participant.vehicle_id,
            objective=found.objective,
            wall_s=time.perf_counter() - began,
            iterations=found.iterations,
            detail=found.reason,
        )
        if found.status not in (SolveStatus.OPTIMAL, SolveStatus.FEASIBLE):
            return None, record
        start = found.states[0]
        return _motion(participant, start, found.controls, step_s, (at_s, targets[:, :2]), origin), record

    def _guess(self, participant: Participant, times_s: FloatArray, targets: FloatArray) -> FloatArray:
        recording, heading = participant.recording, targets[:, 2]
        axle = shift_along(
            targets[:, 0], targets[:, 1], heading, -participant.dimensions.rear_axle_to_centre_m
        )
        speed = np.interp(times_s, recording.times_s, recording.speeds_mps)
        rest = np.zeros_like(speed)
        return np.column_stack([axle, heading, rest, speed, rest])

    def _bounds(
        self, participant: Participant, intervals: int, speed_max_mps: float
    ) -> tuple[FloatArray, FloatArray]:
        config, free, start = self._config, np.inf, participant.start
        low = [-free, -free, -free, -config.steering_max_rad, 0.0, -config.deceleration_max_mps2]
        high = [free, free, free, config.steering_max_rad, speed_max_mps, config.acceleration_max_mps2]
        lower, upper = np.tile(low, (intervals + 1, 1)), np.tile(high, (intervals + 1, 1))
        speed = float(np.clip(start.speed_mps, 0.0, speed_max_mps))
        lower[0, 4], upper[0, 4] = max(0.0, speed - _START_MPS), min(speed_max_mps, speed + _START_MPS)
        lower[0, 2], upper[0, 2] = start.heading_rad - _START_RAD, start.heading_rad + _START_RAD
        if participant.approach is not None:  # its plan goes on from this very state
            x, y = shift_along(0.0, 0.0, start.heading_rad, -participant.dimensions.rear_axle_to_centre_m)
            known = (x, y, start.heading_rad, start.steering_rad, start.speed_mps, start.acceleration_mps2)
            lower[0] = upper[0] = np.array(known, dtype=np.float64)
        return lower, upper

    def _solver(self, intervals: int, step_s: float) -> KnotNlp:
        key = (intervals, step_s)
        if key not in self._compiled:
            model = _model(intervals, step_s)
            budgets = self._config.iteration_budget, self._config.quadratic_passes
            self._compiled[key] = KnotNlp(model, intervals, *budgets)
        return self._compiled[key]


def _cut(units: int, unit_s: float) -> tuple[float, int]:
    """Length and number of control intervals: `_STEP_S` where whole ones fill the units, else finer."""
    samples = unit_s * _SUBSTEPS / _STEP_S
    whole = round(units * unit_s / _STEP_S)
    fills = whole >= 1 and abs(whole * _STEP_S - units * unit_s) < 1e-9
    if fills and abs(samples - round(samples)) < 1e-9:
        return _STEP_S, whole
    per_unit = max(1, math.ceil(unit_s / _STEP_S - 1e-9))
    return unit_s / per_unit, units * per_unit


def _model(intervals: int, step_s: float) -> Model:
    """The expressions of one knot: it tracks centres and headings, and starts near the first of them."""
    knot, size, target = ca.SX.sym("knot", 8), ca.SX.sym("size", 2), ca.SX.sym("target", 3)
    off = knot[:2] + size[1] * ca.vertcat(ca.cos(knot[2]), ca.sin(knot[2])) - target[:2]
    weights = (_POSITION, _POSITION, _HEADING, _CURVATURE, _STEERING_RATE, _JERK)
    weighted = ca.vertcat(off, knot[2] - target[2], ca.tan(knot[3]) / size[0], knot[STATES:])
    # The speed's Bezier point: with it, the speed keeps its limits between the knots too.
    between = knot[4] + knot[5] * (step_s / 2)
    return Model(
        knot=knot,
        shared=size,
        own=target,
        end=interval_end(knot, size[0], step_s, "gauss"),
        residuals=(np.sqrt(weights) * weighted,),
        # The plan has to begin where the vehicle was recorded.
        rows=(Rows(off, range(1)), Rows(between, range(intervals))),
    )


def _motion(
    participant: Participant,
    start: FloatArray,
    controls: FloatArray,
    step_s: float,
    tracked: tuple[FloatArray, FloatArray],
    origin_m: FloatArray,
) -> RepairedMotion:
    size, recording, first_s = participant.dimensions, participant.recording, float(tracked[0][0])
    dense, _, spacing_s = dense_motion(start, controls, step_s, size.wheelbase_m, _STEP_S / _SUBSTEPS)
    states = in_a_row(dense)
    states[:, :2] += origin_m
    per_interval = dense.shape[1] - 1
    poses = box_poses(states, size.rear_axle_to_centre_m)
    times = np.asarray(first_s + np.arange(len(states)) * spacing_s, dtype=np.float64)
    if participant.approach is None:
        tracked = recording.times_s, recording.poses[:, :2]
    off = poses[:, :2] - np.asarray(_at(*tracked, times))
    knots = Trajectory(
        vehicle_id=participant.vehicle_id,
        dimensions=size,
        times_s=read_only(first_s + np.arange(len(controls) + 1) * step_s),
        states=read_only(states[::per_interval]),
        controls=read_only(controls),
        cost=0.0,
    )
    return RepairedMotion(knots, read_only(times), read_only(poses), float(np.hypot(*off.T).max()))


def _at(times_s: FloatArray, points_m: FloatArray, at_s: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(at_s, times_s, column) for column in points_m.T])
