"""The kinematic bicycle, eq. (17), against CVODES and by its own algebra."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from istc_replay.bicycle import dense_motion

from .support.integrators import simulate

WHEELBASE_M = 2.7
START = np.array([3.0, -2.0, 0.4, 0.1, 5.0, 0.5])
CONTROLS = np.array([[0.5, 1.0], [-0.8, -6.0], [0.2, 4.0], [-0.6, 0.0], [0.7, 2.0]])
STEP_S = 0.2


def exact_motion(start: NDArray, controls: NDArray, times_s: NDArray) -> NDArray:
    """States (len(times), 6) under controls (5, 2) held for STEP_S each, by CVODES."""
    state, held = ca.SX.sym("state", 6), ca.SX.sym("held", 2)
    rates = ca.vertcat(
        state[4] * ca.cos(state[2]),
        state[4] * ca.sin(state[2]),
        state[4] * ca.tan(state[3]) / WHEELBASE_M,
        held[0],
        state[5],
        held[1],
    )
    system = {"x": state, "p": held, "ode": rates}
    options = {"abstol": 1e-12, "reltol": 1e-12}
    states = []
    for time_s in times_s:
        reached, interval = start, 0
        while interval * STEP_S < time_s - 1e-12:
            span = min(STEP_S, time_s - interval * STEP_S)
            flow = ca.integrator("flow", "cvodes", system, 0.0, span, options)
            reached = np.asarray(flow(x0=reached, p=controls[interval])["xf"]).ravel()
            interval += 1
        states.append(reached)
    return np.array(states)


def test_dense_motion_is_that_of_many_small_steps() -> None:
    states, _, _ = dense_motion(START, CONTROLS, STEP_S, WHEELBASE_M, 0.01)
    steps = simulate(START, np.repeat(CONTROLS, 20, axis=0), 0.01, WHEELBASE_M, substeps=4)
    np.testing.assert_allclose(states[:, :-1].reshape(100, 6), steps[:-1], atol=1e-9)
    np.testing.assert_allclose(states[-1, -1], steps[-1], atol=1e-9)


def test_steps_of_runge_kutta_come_to_the_exact_motion_with_fourth_order() -> None:
    exact = exact_motion(START, CONTROLS, np.array([1.0]))[0]
    errors = [
        np.abs(simulate(START, CONTROLS, STEP_S, WHEELBASE_M, substeps=substeps)[-1] - exact)[:2].max()
        for substeps in (2, 4)
    ]
    assert 12.0 < errors[0] / errors[1] < 20.0


def test_dense_motion_is_the_exact_motion_between_knots_too() -> None:
    states, rates, spacing_s = dense_motion(START, CONTROLS, STEP_S, WHEELBASE_M, 0.01)
    assert spacing_s == pytest.approx(0.01)
    assert states.shape == (5, 21, 6)
    for interval, sample in [(0, 0), (0, 7), (2, 13), (4, 20)]:
        time_s = interval * STEP_S + sample * spacing_s
        exact = exact_motion(START, CONTROLS, np.array([time_s]))[0]
        assert states[interval, sample] == pytest.approx(exact, abs=1e-8)
    assert states[:-1, -1] == pytest.approx(states[1:, 0], abs=1e-12)
    slopes = np.diff(rates[..., 0], axis=1) / spacing_s
    assert slopes == pytest.approx((rates[:, 1:, 1] + rates[:, :-1, 1]) / 2, abs=1e-3)


def test_dense_motion_takes_the_whole_interval_where_samples_may_be_far_apart() -> None:
    states, _, spacing_s = dense_motion(START, CONTROLS, STEP_S, WHEELBASE_M, 1.0)
    assert spacing_s == STEP_S
    assert states.shape == (5, 2, 6)


def test_a_standing_car_with_turned_wheels_stays_where_it_is() -> None:
    parked = np.array([1.0, 2.0, 3.0, 0.5, 0.0, 0.0])
    states, rates, _ = dense_motion(parked, np.zeros((10, 2)), 0.2, WHEELBASE_M, 0.1)
    assert (states == parked).all()
    assert (rates == 0.0).all()


def test_a_circle_at_constant_steering_closes() -> None:
    delta = 0.3
    radius = WHEELBASE_M / np.tan(delta)
    start = np.array([0.0, 0.0, 0.0, delta, 5.0, 0.0])
    around_s = 2 * np.pi * radius / 5.0
    states, rates, _ = dense_motion(start, np.zeros((100, 2)), around_s / 100, WHEELBASE_M, around_s / 400)
    assert states[-1, -1, :3] == pytest.approx([0.0, 0.0, 2 * np.pi], abs=1e-6)
    np.testing.assert_allclose(rates[..., 0], 5.0 / radius)
    np.testing.assert_allclose(rates[..., 1], 0.0)
