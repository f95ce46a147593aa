"""Solving NLPs over the knots of one bicycle: quadratic programmes lead near a solution, IPOPT finds it.

IPOPT follows a barrier from far inside, whatever it starts from, unless it gets multipliers. A few
passes of sequential quadratic programming (PIQP, Gauss-Newton Hessian) give both, each for the price
of an iteration of IPOPT or two, so that of 15 iterations 3 are left: those that make it exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from istc_replay.datatypes import FloatArray, SolveStatus
from istc_replay.trajectories.mapped import KNOT, STATES, Mapped, Model

#: As solves are recorded.
SOLVERS = "piqp, ipopt"
_STATUS = {
    "Solve_Succeeded": SolveStatus.OPTIMAL,
    "Solved_To_Acceptable_Level": SolveStatus.FEASIBLE,
    "Infeasible_Problem_Detected": SolveStatus.INFEASIBLE,
    "Maximum_Iterations_Exceeded": SolveStatus.LIMIT,
    "Linearisation_Infeasible": SolveStatus.INFEASIBLE,
}
#: IPOPT takes over after a pass that moves no pose by so much [m, rad].
_NEAR = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Where the solver stopped: states (S, 6), controls (S-1, 2), slacks, the cost's terms, its report."""

    states: FloatArray
    controls: FloatArray
    slack: FloatArray
    costs: FloatArray
    objective: float
    status: SolveStatus
    reason: str
    iterations: int


class KnotNlp:
    """minimise the costs of all knots + the slacks' price, subject to end(knot i) = states i+1 and the rows.

    Parameters
    ----------
    model : Model
    intervals : int
        Control intervals, one fewer than knots.
    iterations : int
        IPOPT's budget.
    passes : int
        How many quadratic programmes may lead to a solution.
    slacks : int
        How many slacks there are, at least 0 each.
    price : float
        Of one unit of slack.
    """

    def __init__(
        self,
        model: Model,
        intervals: int,
        iterations: int,
        passes: int,
        slacks: int = 0,
        price: float = 0.0,
    ) -> None:
        self._intervals, self._slacks, self._passes = intervals, slacks, passes
        self._variables = KNOT * intervals + STATES
        build = Mapped(model, intervals, slacks, price)
        self._costs = ca.Function("costs", [build.x, build.p], [build.costs, build.objective])
        self._linearised = build.linearised()
        shapes = {"h": self._linearised.sparsity_out(0), "a": self._linearised.sparsity_out(3)}
        self._programme = ca.conic("programme", "piqp", shapes, _PROGRAMME)
        problem = {"x": build.x, "p": build.p, "f": build.objective, "g": build.values}
        options = _options(iterations) | build.derivatives()
        self._near = ca.nlpsol("near", "ipopt", problem, options | _FROM_NEAR)
        self._far = ca.nlpsol("far", "ipopt", problem, options)

    def solve(
        self,
        guess: tuple[FloatArray, FloatArray],
        states: tuple[FloatArray, FloatArray],
        controls_most: FloatArray,
        rows: tuple[FloatArray, FloatArray],
        shared: FloatArray,
        own: FloatArray,
        *,
        insist: bool = True,
    ) -> Answer:
        """Solve from a first guess of states (S, 6) and controls (S-1, 2).

        `states` are their bounds (S, 6), `controls_most` (2,) those of the controls to either side,
        `rows` the bounds of the rows in their order; `own` (S, o) are the parameters of each knot.
        Where the passes lead nowhere, IPOPT starts from the guess itself if told to `insist`.
        """
        n, slack = self._intervals, np.zeros(self._slacks)
        limit = np.tile(controls_most, (n, 1))
        driven = np.zeros(STATES * n)
        x = ca.DM(np.concatenate([_pack(*guess), slack]))
        given = {
            "p": ca.DM(np.concatenate([shared, own.ravel()])),
            "lbx": ca.DM(np.concatenate([_pack(states[0], -limit), slack])),
            "ubx": ca.DM(np.concatenate([_pack(states[1], limit), slack + np.inf])),
            "lbg": ca.DM(np.concatenate([driven, rows[0]])),
            "ubg": ca.DM(np.concatenate([driven, rows[1]])),
        }
        reason, iterations = "Linearisation_Infeasible", 0
        near = self._approached(x, **given) if self._passes else None
        far = {"x0": x} if insist or not self._passes else None
        for solver, start in ((self._near, near), (self._far, far)):
            if start is None:
                continue
            x = solver(**start, **given)["x"]
            reason = solver.stats()["return_status"]
            iterations += int(solver.stats()["iter_count"])
            if solver.stats()["success"]:
                break
        costs, objective = self._costs(x, given["p"])
        found = x.full().ravel()
        held = found[: KNOT * n].reshape(-1, KNOT)
        return Answer(
            states=np.vstack([held[:, :STATES], found[KNOT * n : self._variables]]),
            controls=held[:, STATES:].copy(),
            slack=found[self._variables :],
            costs=costs.full().ravel(),
            objective=float(objective),
            status=_STATUS.get(reason, SolveStatus.ERROR),
            reason=reason,
            iterations=iterations,
        )

    def _approached(self, x: Any, p: Any, lbx: Any, ubx: Any, lbg: Any, ubg: Any) -> dict[str, Any] | None:
        """Variables and multipliers near a solution, None where a linearisation about x has none."""
        for _ in range(self._passes):
            hessian, gradient, values, jacobian = self._linearised(x, p)
            step = self._programme(
                h=hessian,
                g=gradient,
                a=jacobian,
                lbx=lbx - x,
                ubx=ubx - x,
                lba=lbg - values,
                uba=ubg - values,
            )
            if not self._programme.stats()["success"]:
                return None
            x = x + step["x"]
            moved = step["x"].full()[: KNOT * self._intervals].reshape(-1, KNOT)
            if abs(moved[:, :3]).max() < _NEAR:
                break
        return {"x0": x, "lam_x0": step["lam_x"], "lam_g0": step["lam_a"]}


def _pack(states: FloatArray, controls: FloatArray) -> FloatArray:
    """States (S, 6) and controls (S-1, 2) in the order of the variables."""
    return np.concatenate([np.hstack([states[:-1], controls]).ravel(), states[-1]])


#: A pass need not be exact: what is wrong by centimetres is mended by the next, or by IPOPT.
_PROGRAMME: dict[str, Any] = {
    "error_on_fail": False,
    "piqp": {
        "eps_abs": 1e-3,
        "eps_rel": 1e-3,
        "eps_duality_gap_abs": 1e-2,
        "eps_duality_gap_rel": 1e-2,
        "max_iter": 40,
        "preconditioner_iter": 2,
    },
}
#: From near a solution the barrier is where it ends from the start.
_FROM_NEAR: dict[str, Any] = {"ipopt.warm_start_init_point": "yes", "ipopt.mu_init": 1e-5} | {
    f"ipopt.warm_start_{what}": 1e-4
    for what in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
}


def _options(iterations: int) -> dict[str, Any]:
    return {
        "print_time": False,
        "show_eval_warnings": False,
        "error_on_fail": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.linear_solver": "mumps",
        # In SI all rows are of one size: scaling costs an eighth of the time and changes nothing.
        "ipopt.mumps_scaling": 0,
        "ipopt.mumps_permuting_scaling": 0,
        "ipopt.mumps_pivot_order": 0,
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
