"""Stage C: the convex QP of pivotal points and cubes together, with every choice made."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi
import numpy as np

from istc_replay.corridors.miqp import option_rows
from istc_replay.datatypes import FloatArray, read_only

if TYPE_CHECKING:
    from collections.abc import Sequence

    from istc_replay.corridors.problem import CorridorProblem

#: A solution that misses a row by more than this is no solution.
FEASIBLE_M = 1e-6


def polish(problem: CorridorProblem, choice: Sequence[int] | None) -> FloatArray | None:
    """Minimise eq. (4) with one option of each disjunction enforced.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    choice : sequence of int, optional
        The option of each disjunction; None leaves all of them out, which bounds eq. (4) below.

    Returns
    -------
    (n,) array or None
        The optimum, or None where the choices contradict each other.
    """
    rows = [*problem.rows, *(option_rows(problem, choice) if choice is not None else [])]
    row_index = np.repeat(np.arange(len(rows)), [len(row.index) for row in rows])
    columns = np.concatenate([row.index for row in rows])
    weights = np.concatenate([row.weight for row in rows])
    matrix = casadi.DM.triplet(
        row_index.tolist(), columns.tolist(), casadi.DM(weights), len(rows), problem.size
    )
    hessian = casadi.sparsify(casadi.diag(casadi.DM(2.0 * problem.quadratic)))
    solver = casadi.conic(
        "polish",
        "piqp",
        {"h": hessian.sparsity(), "a": matrix.sparsity()},
        {"error_on_fail": False, "piqp": {"eps_abs": 1e-9, "eps_rel": 1e-10}},
    )
    lower = np.array([row.lower for row in rows])
    upper = np.array([row.upper for row in rows])
    solution = solver(
        h=hessian,
        g=problem.linear - 2.0 * problem.quadratic * problem.reference,
        a=matrix,
        lba=lower,
        uba=upper,
        lbx=problem.lower,
        ubx=problem.upper,
    )
    z = np.asarray(solution["x"]).ravel()
    if not np.isfinite(z).all():
        return None
    z = np.clip(z, problem.lower, problem.upper)
    value = np.bincount(row_index, weights * z[columns], minlength=len(rows))
    excess = max(float((lower - value).max()), float((value - upper).max()))
    return read_only(z) if excess <= FEASIBLE_M else None
