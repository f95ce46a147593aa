"""Choices of a seed made consistent: where they contradict each other, the least missed option is taken."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

import casadi
import numpy as np

from istc_replay.corridors.polish import MOST_ITERATIONS, polish_about, with_near_rows
from istc_replay.corridors.problem import CONSTANT, Rows

if TYPE_CHECKING:
    from collections.abc import Mapping

    from istc_replay.corridors.problem import CorridorProblem
    from istc_replay.datatypes import FloatArray

_ROUNDS = 6
_PRICE = 3e4  # of a metre that a separation is missed by
_MISSED_M = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Mended:
    """A solution z of eq. (4) to (12), or by how much [m] separations (their numbers) are missed."""

    z: FloatArray | None = None
    missed_m: Mapping[int, float] = field(default_factory=dict)


def mended(problem: CorridorProblem, z: FloatArray) -> Mended:
    """Minimise eq. (4) with options near those that z meets best.

    Where these contradict each other the separations are softened, and each that is missed takes
    the option which it then misses least, for a few rounds.
    """
    choice = problem.separations.best(z)
    tried: set[bytes] = set()
    missed_m: dict[int, float] = {}
    while choice.tobytes() not in tried and len(tried) < _ROUNDS:
        tried.add(choice.tobytes())
        soft = with_near_rows(problem.separations.rows(choice), z, partial(_softened, problem))
        if soft is None:
            break
        slack = problem.separations.slack(soft)
        chosen = slack[np.arange(len(choice)), choice]
        missed = chosen < -_MISSED_M
        if not missed.any():
            return Mended(polish_about(problem, soft, choice))
        missed_m = {int(d): float(-chosen[d]) for d in np.flatnonzero(missed)}
        choice = np.where(missed, slack.argmax(axis=1), choice)
    return Mended(missed_m=missed_m)


def _softened(problem: CorridorProblem, chosen: Rows) -> FloatArray | None:
    """The optimum where some rows may be missed at a price."""
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
        {"error_on_fail": False, "piqp": {"eps_abs": 1e-6, "eps_rel": 1e-7, "max_iter": MOST_ITERATIONS}},
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
