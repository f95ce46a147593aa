"""The derivatives that are put together from one knot's equal those of the whole NLP."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from istc_replay.config import TrajectoriesConfig
from istc_replay.trajectories.mapped import Mapped
from istc_replay.trajectories.nlp import _model
from istc_replay.trajectories.repair import _model as repair_model
from istc_replay.trajectories.walls import Grid

GRID = Grid.cut(4, 0.5, TrajectoriesConfig())


def builds() -> dict[str, Mapped]:
    slack = np.arange(GRID.intervals) // GRID.per_unit
    return {
        "hard": Mapped(_model(GRID, "gauss", None), GRID.intervals, 0, 0.0),
        "soft": Mapped(_model(GRID, "gauss", slack), GRID.intervals, GRID.units, 1e4),
        "euler": Mapped(_model(GRID, "euler", None), GRID.intervals, 0, 0.0),
        "repair": Mapped(repair_model(GRID.intervals, 0.25), GRID.intervals, 0, 0.0),
    }


def numbers(size: int, seed: int) -> Any:
    return ca.DM(np.random.default_rng(seed).uniform(0.2, 0.6, size))


@pytest.mark.parametrize("name", ["hard", "soft", "euler", "repair"])
def test_gradient_jacobian_and_hessian_are_those_of_automatic_differentiation(name: str) -> None:
    build = builds()[name]
    given, x, p = build.derivatives(), build.x, build.p
    factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", build.values.numel())
    lagrangian = factor * build.objective + ca.dot(multipliers, build.values)
    whole = ca.Function(
        "whole",
        [x, p, factor, multipliers],
        [
            build.objective,
            ca.gradient(build.objective, x),
            build.values,
            ca.jacobian(build.values, x),
            ca.triu(ca.hessian(lagrangian, x)[0]),
        ],
    )
    at = [numbers(x.numel(), 1), numbers(p.numel(), 2)]
    prices = [numbers(1, 3), numbers(build.values.numel(), 4)]
    expected = [np.array(part) for part in whole(*at, *prices)]
    found = [*given["grad_f"](*at), *given["jac_g"](*at), given["hess_lag"](*at, *prices)]
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(np.array(one), other, rtol=1e-9, atol=1e-9)
    assert found[4].is_triu()


def test_the_hessian_has_no_entries_between_knots() -> None:
    hessian = builds()["hard"].derivatives()["hess_lag"].sparsity_out(0)
    rows, columns = (np.array(part) for part in hessian.get_triplet())
    assert (rows // 8 == columns // 8).all()


@pytest.mark.parametrize("name", ["hard", "soft", "euler", "repair"])
def test_a_linearisation_is_a_convex_quadratic_programme_with_the_nlps_own_slopes(name: str) -> None:
    build = builds()[name]
    x, p = numbers(build.x.numel(), 1), numbers(build.p.numel(), 2)
    hessian, gradient, values, jacobian = (np.array(part) for part in build.linearised()(x, p))
    derivatives = build.derivatives()
    np.testing.assert_allclose(gradient, np.array(derivatives["grad_f"](x, p)[1]))
    for one, other in zip((values, jacobian), derivatives["jac_g"](x, p), strict=True):
        np.testing.assert_allclose(one, np.array(other))
    assert (hessian == hessian.T).all()
    assert np.linalg.eigvalsh(hessian).min() > -1e-9
    # Where the costs' residuals vanish, nothing is left out of their Hessian.
    shared = np.full(2 if name == "repair" else 9, 0.7)
    own = np.zeros((GRID.intervals + 1, 3 if name == "repair" else 2))
    own[:, 0] = shared[1]
    at = np.zeros(build.x.numel()), np.concatenate([shared, own.ravel()])
    exact = ca.Function("exact", [build.x, build.p], [ca.hessian(build.objective, build.x)[0]])
    np.testing.assert_allclose(np.array(build.linearised()(*at)[0]), np.array(exact(*at)), atol=1e-9)
