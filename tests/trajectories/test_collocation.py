"""Control intervals end where the bicycle's true motion ends."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from istc_replay.trajectories.collocation import interval_end

from ..support.integrators import euler_step, simulate

WHEELBASE_M = 2.7
#: From standing to fast and turning, at the limits of steering rate and jerk.
KNOTS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.8, 8.0],
        [3.0, -2.0, 2.0, 0.6, 5.0, 1.0, -0.8, -8.0],
        [3.0, -2.0, -1.0, -0.3, 8.0, -4.0, 0.5, 3.0],
        [1.0, 5.0, 3.1, 0.05, 30.0, 2.0, 0.1, -1.0],
    ]
)


def end(integrator: str, step_s: float) -> np.ndarray:
    knot = ca.SX.sym("knot", 8)
    function = ca.Function("end", [knot], [interval_end(knot, WHEELBASE_M, step_s, integrator)])
    return np.array([np.asarray(function(row)).ravel() for row in KNOTS])


@pytest.mark.parametrize("step_s", [0.125, 0.2, 0.25])
def test_the_collocation_ends_where_the_true_motion_ends(step_s: float) -> None:
    true = simulate(KNOTS[:, :6], KNOTS[None, :, 6:], step_s, WHEELBASE_M, substeps=400)[-1]
    assert np.abs(end("gauss", step_s) - true).max() < 2e-7


def test_it_is_nearer_to_it_than_two_steps_of_runge_kutta() -> None:
    true = simulate(KNOTS[:, :6], KNOTS[None, :, 6:], 0.2, WHEELBASE_M, substeps=400)[-1]
    two = simulate(KNOTS[:, :6], KNOTS[None, :, 6:], 0.2, WHEELBASE_M, substeps=2)[-1]
    assert np.abs(end("gauss", 0.2) - true).max() < 0.05 * np.abs(two - true).max()


def test_euler_is_the_printed_update() -> None:
    np.testing.assert_allclose(
        end("euler", 0.1), euler_step(KNOTS[:, :6], KNOTS[:, 6:], 0.1, WHEELBASE_M), atol=1e-12
    )
