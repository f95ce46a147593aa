"""Choices of a seed made consistent: where they contradict each other, the least missed option is taken."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi
import numpy as np

from istc_replay.corridors.polish import polish
from istc_replay.corridors.problem import CONSTANT, Rows

if TYPE_CHECKING:
    from istc_replay.corridors.problem import CorridorProblem, IntArray
    from istc_replay.datatypes import FloatArray

_ROUNDS = 6
_PRICE = 3e4  # of a metre that a separation is missed by
_MISSED_M = 1e-4


def mended(problem: CorridorProblem, z: FloatArray) -> FloatArray | None:
    """Minimise eq. (4) with options near those that z meets best.

    Where these contradict each other the separations are softened, and each that is missed takes
    the option which it then misses least, for a few rounds.

    Returns
    -------
    (n,) array or None
        A solution of eq. (4) to (12), or None where none was found.
    """
    choice = problem.separations.best(z)
    tried = set()
    for _ in range(_ROUNDS):
        if choice.tobytes() in tried:
            return None
        tried.add(choice.tobytes())
        soft = _softened(problem, choice)
        if soft is None:
            return None
        slack = problem.separations.slack(soft)
        missed = slack[np.arange(len(choice)), choice] < -_MISSED_M
        if not missed.any():
            return polish(problem, choice)
        choice = np.where(missed, slack.argmax(axis=1), choice)
    return None


def _softened(problem: CorridorProblem, choice: IntArray) -> FloatArray | None:
    """The optimum where separations may be missed at a price."""
    chosen = problem.separations.rows(choice)
    rows = Rows.join([problem.rows, chosen])
    place, entry = np.nonzero(rows.index != CONSTANT)
    column, weight = rows.index[place, entry], rows.weight[place, entry]
    count, own, size = len(chosen.lower), len(problem.rows.lower), problem.size
    place = np.concatenate([place, own + np.arange(count)])
    column = np.concatenate([column, size + np.arange(count)])
    weight = np.concatenate([weight, np.ones(count)])
    matrix = casadi.DM.triplet(
        place.tolist(), column.tolist(), casadi.DM(weight), len(rows.lower), size + count
    )
    squares = np.concatenate([problem.quadratic, np.full(count, 1.0)])
    hessian = casadi.sparsify(casadi.diag(casadi.DM(2.0 * squares)))
    solver = casadi.conic(
        "softened",
        "piqp",
        {"h": hessian.sparsity(), "a": matrix.sparsity()},
        {"error_on_fail": False, "piqp": {"eps_abs": 1e-6, "eps_rel": 1e-7}},
    )
    linear = problem.linear - 2.0 * problem.quadratic * problem.reference
    solution = solver(
        h=hessian,
        g=np.concatenate([linear, np.full(count, _PRICE)]),
        a=matrix,
        lba=rows.lower,
        uba=rows.upper,
        lbx=np.concatenate([problem.lower, np.zeros(count)]),
        ubx=np.concatenate([problem.upper, np.full(count, np.inf)]),
    )
    z = np.asarray(solution["x"]).ravel()[:size]
    return z if np.isfinite(z).all() else None
