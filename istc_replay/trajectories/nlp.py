"""The NLP of eq. (16) for one horizon length, and its soft twin.

Vehicle, pivotal points and weights are parameters, walls and limits are bounds. One NLP so serves
every vehicle of its horizon.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from istc_replay.config import TrajectoriesConfig
from istc_replay.datatypes import Dimensions, FloatArray, SolveStatus
from istc_replay.trajectories.collocation import interval_end
from istc_replay.trajectories.knots import KnotNlp
from istc_replay.trajectories.mapped import STATES, Model, Rows
from istc_replay.trajectories.walls import Grid

#: Price of a metre of slack; far above what a metre of wall is worth to eq. (16).
_SLACK_WEIGHT = 1e4
#: Names of the cost terms, eq. (13), (14), (15).
COSTS = ("smoothness", "comfort", "pivotal")


@dataclass(frozen=True, slots=True, eq=False)
class NlpData:
    """What one vehicle brings to the NLP.

    `lower` and `upper` (S, 6) bound the states; `walls_m` (S-1, 4) bound the corners at the
    ends of the control intervals; `targets_m` (S, 2) are the pivotal points interpolated in time.
    """

    dimensions: Dimensions
    lower: FloatArray
    upper: FloatArray
    walls_m: FloatArray
    targets_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class NlpSolution:
    """Where IPOPT stopped: states (S, 6), controls (S-1, 2), the most that a wall gave way, its report."""

    states: FloatArray
    controls: FloatArray
    slack_m: float
    costs: tuple[float, float, float]
    objective: float
    status: SolveStatus
    reason: str
    iterations: int
    wall_s: float

    @property
    def solved(self) -> bool:
        """Whether states and controls satisfy the NLP."""
        return self.status in (SolveStatus.OPTIMAL, SolveStatus.FEASIBLE)


class CorridorNlp:
    """The parametric NLP of one horizon length, compiled once.

    minimise the sum of eq. (13), (14), (15) subject to the bicycle, eq. (17), its limits, eq.
    (18), and the corners of the car-box inside the cubes, eq. (19). With `soft`, each unit's
    walls may move out by a slack that costs `_SLACK_WEIGHT` a metre.
    """

    def __init__(self, grid: Grid, config: TrajectoriesConfig, soft: bool) -> None:
        self._config = config
        self._soft = soft
        n = grid.intervals
        slack = np.arange(n) // grid.per_unit if soft else None
        slacks = grid.units if soft else 0
        model = _model(grid, config.integrator, slack)
        self._nlp = KnotNlp(model, n, config.iteration_budget, config.quadratic_passes, slacks, _SLACK_WEIGHT)

    def _row_bounds(self, data: NlpData) -> tuple[FloatArray, FloatArray]:
        """Bounds of the rows of `_model`."""
        low, high = np.tile(data.walls_m[:, [0, 2]], 4).ravel(), np.tile(data.walls_m[:, [1, 3]], 4).ravel()
        if self._soft:
            free = np.full_like(low, np.inf)
            low, high = np.concatenate([low, -free]), np.concatenate([free, high])
        return np.concatenate([data.lower[1:, 4], low]), np.concatenate([data.upper[1:, 4], high])

    def solve(
        self, data: NlpData, states: FloatArray, controls: FloatArray, *, insist: bool = True
    ) -> NlpSolution:
        """Solve for one vehicle from a first guess, states (S, 6) and controls (S-1, 2).

        With `insist`, also where quadratic programmes lead nowhere from there.
        """
        config, size = self._config, data.dimensions
        vehicle = [size.wheelbase_m, size.rear_axle_to_centre_m, size.length_m / 2, size.width_m / 2]
        weights = [
            config.curvature_weight,
            config.steering_rate_weight,
            config.jerk_weight,
            config.pivotal_x_weight,
            config.pivotal_y_weight,
        ]
        began = time.perf_counter()
        found = self._nlp.solve(
            guess=(states, controls),
            states=(data.lower, data.upper),
            controls_most=np.array([config.steering_rate_max_radps, config.jerk_max_mps3]),
            rows=self._row_bounds(data),
            shared=np.array([*vehicle, *weights]),
            own=data.targets_m,
            insist=insist,
        )
        smoothness, comfort, pivotal = found.costs.tolist()
        return NlpSolution(
            states=found.states,
            controls=found.controls,
            slack_m=float(found.slack.max(initial=0.0)),
            costs=(smoothness, comfort, pivotal),
            objective=found.objective,
            status=found.status,
            reason=found.reason,
            iterations=found.iterations,
            wall_s=time.perf_counter() - began,
        )


def _model(grid: Grid, integrator: str, slack: Any) -> Model:
    """The expressions of one knot; corners stay within walls at the intervals' ends."""
    knot, target = ca.SX.sym("knot", 8), ca.SX.sym("target", 2)
    vehicle = ca.SX.sym("vehicle", 4)  # wheelbase, axle to centre, half length, half width
    weights = ca.SX.sym("weights", 5)
    # The speed's Bezier point: with it, the speed keeps its limits between the knots too.
    between = knot[4] + knot[5] * (grid.step_s / 2)
    n = grid.intervals
    return Model(
        knot=knot,
        shared=ca.vertcat(vehicle, weights),
        own=target,
        end=interval_end(knot, vehicle[0], grid.step_s, integrator),
        residuals=_residuals(knot, vehicle, weights, target),
        rows=(Rows(between, range(n)), Rows(_corners(knot, vehicle), range(1, n + 1), slack)),
    )


def _corners(knot: Any, vehicle: Any) -> Any:
    """x, y of fl, fr, rl, rr one after the other, eq. (19)."""
    c, s = ca.cos(knot[2]), ca.sin(knot[2])
    front, rear, half = vehicle[1] + vehicle[2], vehicle[1] - vehicle[2], vehicle[3]
    corners = []
    for along in (front, rear):
        for across in (half, -half):
            corners += [knot[0] + along * c - across * s, knot[1] + along * s + across * c]
    return ca.vertcat(*corners)


def _residuals(knot: Any, vehicle: Any, weights: Any, target: Any) -> tuple[Any, ...]:
    """What eq. (13), (14), (15) square at a knot: they are summed as printed, without the step."""
    scale = ca.sqrt(weights)
    centre = knot[:2] + vehicle[1] * ca.vertcat(ca.cos(knot[2]), ca.sin(knot[2]))
    return scale[0] * ca.tan(knot[3]) / vehicle[0], scale[1:3] * knot[STATES:], scale[3:] * (centre - target)
