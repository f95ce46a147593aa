"""The kinematic bicycle, eq. (17), against CVODES and by its own algebra."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from istc_replay.bicycle import dense_motion, derivative, euler_step, rk4_step, simulate

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


def end_error(step_s: float, step: object) -> float:
    """Position error at 1 s of a one-step method with steps of `step_s`."""
    state = START
    for held in np.repeat(CONTROLS, round(STEP_S / step_s), axis=0):
        state = step(state, held, step_s, WHEELBASE_M)
    return float(np.abs(state - exact_motion(START, CONTROLS, np.array([1.0]))[0])[:2].max())


def test_runge_kutta_converges_with_fourth_order() -> None:
    ratio = end_error(0.1, rk4_step) / end_error(0.05, rk4_step)
    assert 12.0 < ratio < 20.0


def test_the_printed_euler_update_converges_with_first_order() -> None:
    ratio = end_error(0.02, euler_step) / end_error(0.01, euler_step)
    assert 1.8 < ratio < 2.2


def test_the_printed_euler_update_is_equation_17() -> None:
    x, y, theta, delta, v, a = START
    beta, j = CONTROLS[0]
    h = 0.1
    printed = [
        x + v * np.cos(theta) * h,
        y + v * np.sin(theta) * h,
        theta + v * np.tan(delta) / WHEELBASE_M * h,
        delta + h * beta,
        v + a * h,
        a + h * j,
    ]
    assert euler_step(START, CONTROLS[0], h, WHEELBASE_M) == pytest.approx(printed, abs=1e-15)


def test_two_substeps_of_a_control_interval_drift_less_than_a_millimetre() -> None:
    ends = simulate(START, CONTROLS, STEP_S, WHEELBASE_M, substeps=2)
    exact = exact_motion(START, CONTROLS, np.arange(6) * STEP_S)
    assert np.abs(ends - exact).max() < 1e-3


def test_controls_are_read_back_from_the_states_they_caused() -> None:
    states = simulate(START, CONTROLS, STEP_S, WHEELBASE_M, substeps=2)
    assert np.diff(states[:, [3, 5]], axis=0) / STEP_S == pytest.approx(CONTROLS, abs=1e-12)


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


def test_many_vehicles_move_as_each_alone() -> None:
    starts = np.stack([START, START + [1.0, 2.0, 0.3, -0.2, 2.0, 0.0]])
    wheelbases = np.array([2.7, 3.5])
    together = simulate(starts, np.repeat(CONTROLS[:, None], 2, axis=1), STEP_S, wheelbases)
    for row in range(2):
        alone = simulate(starts[row], CONTROLS, STEP_S, wheelbases[row])
        assert together[:, row] == pytest.approx(alone, abs=1e-13)


def test_a_standing_car_with_turned_wheels_stays_where_it_is() -> None:
    parked = np.array([1.0, 2.0, 3.0, 0.5, 0.0, 0.0])
    assert simulate(parked, np.zeros((10, 2)), 0.2, WHEELBASE_M)[-1] == pytest.approx(parked, abs=0.0)


def test_a_circle_at_constant_steering_closes() -> None:
    delta = 0.3
    radius = WHEELBASE_M / np.tan(delta)
    start = np.array([0.0, 0.0, 0.0, delta, 5.0, 0.0])
    around_s = 2 * np.pi * radius / 5.0
    end = simulate(start, np.zeros((100, 2)), around_s / 100, WHEELBASE_M)[-1]
    assert end[:3] == pytest.approx([0.0, 0.0, 2 * np.pi], abs=1e-4)


def test_the_derivative_names_each_rate() -> None:
    rates = derivative([0.0, 0.0, np.pi / 2, np.arctan(0.27), 5.0, -1.0], [0.1, 2.0], WHEELBASE_M)
    assert rates == pytest.approx([0.0, 5.0, 0.5, 0.1, -1.0, 2.0], abs=1e-12)
