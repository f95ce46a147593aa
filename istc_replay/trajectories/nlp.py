"""The NLP of eq. (16) for one horizon length, and its soft twin.

Variables are the states (6) at the knots and the controls (2) held between them, a knot's controls
after its states; vehicle, pivotal points and weights are parameters, walls and limits are bounds.
One NLP so serves every vehicle of its horizon.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from istc_replay.config import TrajectoriesConfig
from istc_replay.datatypes import Dimensions, FloatArray, SolveStatus
from istc_replay.trajectories.walls import Grid

#: Price of a metre of slack; far above what a metre of wall is worth to eq. (16).
_SLACK_WEIGHT = 1e4
#: Names of the cost terms, eq. (13), (14), (15).
COSTS = ("smoothness", "comfort", "pivotal")
_STATUS = {
    "Solve_Succeeded": SolveStatus.OPTIMAL,
    "Solved_To_Acceptable_Level": SolveStatus.FEASIBLE,
    "Infeasible_Problem_Detected": SolveStatus.INFEASIBLE,
    "Maximum_Iterations_Exceeded": SolveStatus.LIMIT,
}


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
    """Where IPOPT stopped: states (S, 6), controls (S-1, 2), slack (K,) and its report."""

    states: FloatArray
    controls: FloatArray
    slack_m: FloatArray
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
        self._grid = grid
        self._config = config
        self._soft = soft
        n = grid.intervals
        states = [ca.SX.sym(f"s{i}", 6) for i in range(n + 1)]
        controls = [ca.SX.sym(f"u{i}", 2) for i in range(n)]
        slack = ca.SX.sym("slack", grid.units if soft else 0)
        vehicle = ca.SX.sym("vehicle", 4)  # wheelbase, axle to centre, half length, half width
        weights = ca.SX.sym("weights", 5)
        targets = ca.SX.sym("targets", 2, n + 1)
        knots = [ca.vertcat(*pair) for pair in zip(states, controls, strict=False)]
        x = ca.vertcat(*knots, states[n], slack)
        parameters = ca.vertcat(vehicle, weights, ca.vec(targets))
        costs = _costs(states, controls, vehicle, weights, targets)
        rows = self._rows(states, controls, slack, vehicle)
        objective = ca.sum1(costs) + (_SLACK_WEIGHT * ca.sum1(slack) if soft else 0.0)
        self._costs = ca.Function("costs", [x, parameters], [costs])
        problem = {"x": x, "p": parameters, "f": objective, "g": ca.vertcat(*rows)}
        self._solver = ca.nlpsol("trajectory", "ipopt", problem, _options(config.iteration_budget))

    def _rows(self, states: list[Any], controls: list[Any], slack: Any, vehicle: Any) -> list[Any]:
        """Constraint rows, interval after interval; `_row_bounds` gives their bounds in this order."""
        grid, rows = self._grid, []
        driven = _interval_end(grid, self._config.integrator)
        for i in range(grid.intervals):
            rows.append(driven(states[i], controls[i], vehicle) - states[i + 1])
            # The speed's Bezier point: with it, the speed keeps its limits between the knots too.
            rows.append(states[i][4] + states[i][5] * (grid.step_s / 2))
            corners = _corners(states[i + 1], vehicle)
            if self._soft:
                give = slack[i // grid.per_unit]
                rows += [corners + give, corners - give]
            else:
                rows.append(corners)
        return rows

    def _row_bounds(self, data: NlpData) -> tuple[FloatArray, FloatArray]:
        grid = self._grid
        low, high = np.tile(data.walls_m[:, [0, 2]], 4), np.tile(data.walls_m[:, [1, 3]], 4)  # (S-1, 8)
        if self._soft:
            free = np.full_like(low, np.inf)
            low, high = np.hstack([low, -free]), np.hstack([free, high])
        n = grid.intervals
        head = np.zeros((n, 7))
        lower = np.hstack([head, low.reshape(n, -1)])
        upper = np.hstack([head, high.reshape(n, -1)])
        lower[:, 6], upper[:, 6] = data.lower[1:, 4], data.upper[1:, 4]
        return lower.ravel(), upper.ravel()

    def solve(self, data: NlpData, states: FloatArray, controls: FloatArray) -> NlpSolution:
        """Solve for one vehicle from a first guess, states (S, 6) and controls (S-1, 2)."""
        grid, config = self._grid, self._config
        rate = np.full((grid.intervals, 1), config.steering_rate_max_radps)
        limit = np.hstack([rate, np.full_like(rate, config.jerk_max_mps3)])
        slack = np.zeros(grid.units if self._soft else 0)
        row_lower, row_upper = self._row_bounds(data)
        parameters = self._parameters(data)
        began = time.perf_counter()
        answer = self._solver(
            x0=np.concatenate([_pack(states, controls), slack]),
            p=parameters,
            lbx=np.concatenate([_pack(data.lower, -limit), slack]),
            ubx=np.concatenate([_pack(data.upper, limit), slack + np.inf]),
            lbg=row_lower,
            ubg=row_upper,
        )
        wall_s = time.perf_counter() - began
        report = self._solver.stats()
        x = np.asarray(answer["x"], dtype=np.float64).ravel()
        held = x[: 8 * grid.intervals].reshape(-1, 8)
        last = x[8 * grid.intervals :][:6]
        smoothness, comfort, pivotal = np.asarray(self._costs(x, parameters)).ravel().tolist()
        return NlpSolution(
            states=np.vstack([held[:, :6], last]),
            controls=held[:, 6:].copy(),
            slack_m=x[8 * grid.intervals + 6 :],
            costs=(smoothness, comfort, pivotal),
            objective=float(answer["f"]),
            status=_STATUS.get(report["return_status"], SolveStatus.ERROR),
            reason=report["return_status"],
            iterations=int(report["iter_count"]),
            wall_s=wall_s,
        )

    def _parameters(self, data: NlpData) -> FloatArray:
        size, config = data.dimensions, self._config
        vehicle = [size.wheelbase_m, size.rear_axle_to_centre_m, size.length_m / 2, size.width_m / 2]
        weights = [
            config.curvature_weight,
            config.steering_rate_weight,
            config.jerk_weight,
            config.pivotal_x_weight,
            config.pivotal_y_weight,
        ]
        return np.concatenate([vehicle, weights, data.targets_m.ravel()])


def _interval_end(grid: Grid, integrator: str) -> Any:
    """Function of a knot's states and controls: the states at the interval's end, eq. (17)."""
    state, control, vehicle = ca.SX.sym("s", 6), ca.SX.sym("u", 2), ca.SX.sym("vehicle", 4)
    step = _rk4_step if integrator == "rk4" else _euler_step
    here = state
    for _ in range(grid.substeps):
        here = step(here, control, grid.step_s / grid.substeps, vehicle[0])
    return ca.Function("driven", [state, control, vehicle], [here])


def _derivative(state: Any, control: Any, wheelbase: Any) -> Any:
    theta, delta, v, a = state[2], state[3], state[4], state[5]
    yaw_rate = v * ca.tan(delta) / wheelbase
    return ca.vertcat(v * ca.cos(theta), v * ca.sin(theta), yaw_rate, control[0], a, control[1])


def _rk4_step(state: Any, control: Any, step_s: float, wheelbase: Any) -> Any:
    k1 = _derivative(state, control, wheelbase)
    k2 = _derivative(state + step_s / 2 * k1, control, wheelbase)
    k3 = _derivative(state + step_s / 2 * k2, control, wheelbase)
    k4 = _derivative(state + step_s * k3, control, wheelbase)
    return state + step_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _euler_step(state: Any, control: Any, step_s: float, wheelbase: Any) -> Any:
    return state + step_s * _derivative(state, control, wheelbase)


def _corners(state: Any, vehicle: Any) -> Any:
    """x, y of fl, fr, rl, rr one after the other, eq. (19)."""
    c, s = ca.cos(state[2]), ca.sin(state[2])
    front, rear, half = vehicle[1] + vehicle[2], vehicle[1] - vehicle[2], vehicle[3]
    corners = []
    for along in (front, rear):
        for across in (half, -half):
            corners += [state[0] + along * c - across * s, state[1] + along * s + across * c]
    return ca.vertcat(*corners)


def _costs(states: list[Any], controls: list[Any], vehicle: Any, weights: Any, targets: Any) -> Any:
    """The three costs, eq. (13), (14), (15): sums over knots, as printed without the step."""
    smoothness = comfort = pivotal = 0.0
    for i, state in enumerate(states):
        smoothness += weights[0] * (ca.tan(state[3]) / vehicle[0]) ** 2
        centre_x = state[0] + vehicle[1] * ca.cos(state[2])
        centre_y = state[1] + vehicle[1] * ca.sin(state[2])
        pivotal += weights[3] * (centre_x - targets[0, i]) ** 2 + weights[4] * (centre_y - targets[1, i]) ** 2
    for control in controls:
        comfort += weights[1] * control[0] ** 2 + weights[2] * control[1] ** 2
    return ca.vertcat(smoothness, comfort, pivotal)


def _pack(states: FloatArray, controls: FloatArray) -> FloatArray:
    """States (S, 6) and controls (S-1, 2) in the order of the variables."""
    return np.concatenate([np.hstack([states[:-1], controls]).ravel(), states[-1]])


def _options(iterations: int) -> dict[str, Any]:
    return {
        "print_time": False,
        "show_eval_warnings": False,
        "error_on_fail": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.linear_solver": "mumps",
        "ipopt.max_iter": iterations,
        # A cost that is off by a millionth saves a fifth of the iterations; walls are held to less.
        "ipopt.tol": 1e-4,
        "ipopt.constr_viol_tol": 1e-7,
        "ipopt.acceptable_iter": 0,
        "ipopt.nlp_scaling_method": "none",
        "ipopt.min_refinement_steps": 0,
        # Relative to the wall: the default of 1e-8 lets a car-box out by a micrometre at 100 m.
        "ipopt.bound_relax_factor": 1e-10,
    }
