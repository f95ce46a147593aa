"""Stage C: the convex QP of pivotal points and cubes together, with every choice made."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import casadi
import numpy as np

from istc_replay.corridors.problem import CONSTANT, Rows
from istc_replay.datatypes import FloatArray, read_only

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from istc_replay.corridors.problem import CorridorProblem, IntArray

#: A solution that misses a row by more than this is no solution.
FEASIBLE_M = 1e-6
#: Rows that hold by more than this are tried without [m].
_NEAR_M = 10.0
#: Solutions take 10 to 40 iterations; what has none, or stalls within the tolerance, would go on to 250.
MOST_ITERATIONS = 80


def polish(
    problem: CorridorProblem, choice: Sequence[int] | IntArray | None, *, share: float = 1.0
) -> FloatArray | None:
    """Minimise eq. (4) with one option of each separation enforced.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    choice : (D,) sequence of int, optional
        The option of each separation; None leaves all of them out, which bounds eq. (4) below.
    share : float
        Share of eq. (3) that counts; 1 is eq. (4).

    Returns
    -------
    (n,) array or None
        The optimum, or None where the choices contradict each other.
    """
    rows = problem.rows
    if choice is not None and len(problem.separations):
        rows = Rows.join([rows, problem.separations.rows(choice)])
    everything = np.arange(problem.size)
    return _least(problem, rows, everything, share)


def polish_about(
    problem: CorridorProblem, z: FloatArray, choice: IntArray | None = None
) -> FloatArray | None:
    """Minimise eq. (4) with an option of each separation enforced: those given, else what z meets best."""
    table = problem.separations
    if choice is None:
        choice = table.best(z)
    everything = np.arange(problem.size)

    def solved(chosen: Rows) -> FloatArray | None:
        return _least(problem, Rows.join([problem.rows, chosen]), everything, 1.0)

    return with_near_rows(table.rows(choice), z, solved)


def with_near_rows(
    rows: Rows, z: FloatArray, solved: Callable[[Rows], FloatArray | None]
) -> FloatArray | None:
    """Solve with those of some rows alone, of lower bounds, that z does not meet by far.

    Rows that never bind would fill a QP's factors. A solution that misses one of those left out is sought
    again with what is near to it.

    Parameters
    ----------
    rows : Rows
        What may be left out.
    z : (n,) array
        Near to the solution.
    solved : callable
        Gives z for some of the rows, or None.
    """
    near = rows.value(z) - rows.lower < _NEAR_M
    while True:
        found = solved(rows.taken(near))
        if found is None:
            return None
        slack = rows.value(found) - rows.lower
        if not (slack[~near] < -FEASIBLE_M).any():
            return found
        near |= slack < _NEAR_M


def polish_part(
    problem: CorridorProblem,
    vehicles: Sequence[int],
    choices: Sequence[tuple[int, int]],
    *,
    share: float = 1.0,
) -> FloatArray | None:
    """Minimise eq. (4) of some vehicles alone, with some options (separation, option) of theirs enforced.

    Returns
    -------
    array or None
        The optimum in the order of `problem.indices`, or None where none was found.
    """
    indices = problem.indices(vehicles)
    local = np.full(problem.size + 1, CONSTANT, dtype=np.int64)
    local[indices] = np.arange(len(indices))
    rows = problem.rows.taken(local[problem.rows.index[:, 0]] != CONSTANT)
    if choices:
        table = problem.separations.taken(np.array([d for d, _ in choices], dtype=np.int64))
        rows = Rows.join([rows, table.rows([option for _, option in choices])])
    return _least(problem, replace(rows, index=local[rows.index]), indices, share)


def _least(problem: CorridorProblem, rows: Rows, indices: IntArray, share: float) -> FloatArray | None:
    """The variables at some indices, at least eq. (4) with a share of eq. (3), within rows of these alone."""
    place, entry = np.nonzero(rows.index != CONSTANT)
    column, weight = rows.index[place, entry], rows.weight[place, entry]
    shape = len(rows.lower), len(indices)
    matrix = casadi.DM.triplet(place.tolist(), column.tolist(), casadi.DM(weight), *shape)
    quadratic = share * problem.quadratic[indices]
    lower, upper = problem.lower[indices], problem.upper[indices]
    hessian = _diagonal(2.0 * quadratic)
    solver = casadi.conic(
        "polish",
        "piqp",
        {"h": hessian.sparsity(), "a": matrix.sparsity()},
        {"error_on_fail": False, "piqp": {"eps_abs": 1e-9, "eps_rel": 1e-10, "max_iter": MOST_ITERATIONS}},
    )
    solution = solver(
        h=hessian,
        g=problem.linear[indices] - 2.0 * quadratic * problem.reference[indices],
        a=matrix,
        lba=rows.lower,
        uba=rows.upper,
        lbx=lower,
        ubx=upper,
    )
    z = np.asarray(solution["x"]).ravel()
    if not np.isfinite(z).all():
        return None
    z = np.clip(z, lower, upper)
    value = rows.value(z)
    excess = max(float((rows.lower - value).max()), float((value - rows.upper).max()))
    return read_only(z) if excess <= FEASIBLE_M else None


def _diagonal(values: FloatArray) -> casadi.DM:
    """A diagonal matrix without its zeros."""
    at = np.flatnonzero(values)
    size = len(values)
    return casadi.DM.triplet(at.tolist(), at.tolist(), casadi.DM(values[at]), size, size)
