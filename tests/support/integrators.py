"""The bicycle of eq. (17) integrated step by step, as references for what the product integrates at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def derivative(states: ArrayLike, controls: ArrayLike, wheelbase_m: ArrayLike) -> FloatArray:
    """Time derivative of the states, eq. (17) before discretisation.

    Parameters
    ----------
    states : array_like
        (..., 6) [m, m, rad, rad, m/s, m/s^2].
    controls : array_like
        (..., 2) [rad/s, m/s^3].
    wheelbase_m : array_like
        (...) [m].

    Returns
    -------
    ndarray
        (..., 6), each state's unit a second.
    """
    states = np.asarray(states, dtype=np.float64)
    controls = np.asarray(controls, dtype=np.float64)
    theta, delta, v, a = (states[..., column] for column in (2, 3, 4, 5))
    beta, j = controls[..., 0], controls[..., 1]
    yaw_rate = v * np.tan(delta) / wheelbase_m
    rates = np.broadcast_arrays(v * np.cos(theta), v * np.sin(theta), yaw_rate, beta, a, j)
    return np.stack(rates, axis=-1)


def rk4_step(states: ArrayLike, controls: ArrayLike, step_s: float, wheelbase_m: ArrayLike) -> FloatArray:
    """Advance states (..., 6) by one classic Runge-Kutta step with the controls held."""
    states = np.asarray(states, dtype=np.float64)
    k1 = derivative(states, controls, wheelbase_m)
    k2 = derivative(states + step_s / 2 * k1, controls, wheelbase_m)
    k3 = derivative(states + step_s / 2 * k2, controls, wheelbase_m)
    k4 = derivative(states + step_s * k3, controls, wheelbase_m)
    return states + step_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def euler_step(states: ArrayLike, controls: ArrayLike, step_s: float, wheelbase_m: ArrayLike) -> FloatArray:
    """Advance states (..., 6) by the update printed as eq. (17)."""
    states = np.asarray(states, dtype=np.float64)
    return states + step_s * derivative(states, controls, wheelbase_m)


def simulate(
    start: ArrayLike, controls: ArrayLike, step_s: float, wheelbase_m: ArrayLike, substeps: int = 1
) -> FloatArray:
    """Integrate held controls with Runge-Kutta.

    Parameters
    ----------
    start : array_like
        (..., 6) first state.
    controls : array_like
        (S-1, ..., 2), each row held for `step_s`.
    step_s : float
        Length of a control interval [s].
    wheelbase_m : array_like
        (...) [m].
    substeps : int
        Runge-Kutta steps in a control interval.

    Returns
    -------
    ndarray
        (S, ..., 6) states at the ends of the control intervals, the start first.
    """
    states = [np.array(start, dtype=np.float64)]
    for held in np.asarray(controls, dtype=np.float64):
        state = states[-1]
        for _ in range(substeps):
            state = rk4_step(state, held, step_s / substeps, wheelbase_m)
        states.append(state)
    return np.stack(states)
