"""The kinematic bicycle of eq. (17), in continuous time with held controls.

States (..., 6) are x, y, heading theta, steering delta, speed v, acceleration a of the rear axle;
controls (..., 2) are steering rate beta and jerk j.

    x' = v cos(theta)   y' = v sin(theta)   theta' = v tan(delta) / L   delta' = beta   v' = a   a' = j
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from istc_replay.datatypes import FloatArray


def dense_motion(
    start: ArrayLike, controls: ArrayLike, step_s: float, wheelbase_m: float, longest_s: float
) -> tuple[FloatArray, FloatArray, float]:
    """Sample the continuous motion of one vehicle finely.

    The bicycle is a cascade: delta, a and v are polynomials of time, theta an integral of these
    and x, y integrals of all, so that Simpson's rule needs no loop over time.

    Parameters
    ----------
    start : array_like
        (6,) first state.
    controls : array_like
        (S-1, 2), each row held for `step_s`.
    step_s : float
        Length of a control interval [s].
    wheelbase_m : float
        [m].
    longest_s : float
        Longest distance between samples [s]; a whole number of them fills a control interval.

    Returns
    -------
    states : ndarray
        (S-1, m+1, 6), row i from the start to the end of control interval i.
    rates : ndarray
        (S-1, m+1, 2): yaw rate [rad/s] and its derivative [rad/s^2].
    spacing_s : float
        Distance between samples.
    """
    first = np.asarray(start, dtype=np.float64)
    held = np.asarray(controls, dtype=np.float64)
    samples = max(1, math.ceil(step_s / longest_s - 1e-9))
    spacing = step_s / samples
    # Samples at quarter spacing: Simpson on theta at half spacing, then on x and y at whole spacing.
    t = np.arange(4 * samples + 1) * (spacing / 4)  # (Q,)
    beta, j = held[:, :1], held[:, 1:]
    before = np.cumsum(np.vstack([[0.0, 0.0], held[:-1] * step_s]), axis=0)
    delta = first[3] + before[:, :1] + beta * t  # (S-1, Q)
    a = first[5] + before[:, 1:] + j * t
    gained = (a[:, :1] + a[:, -1:]) / 2 * step_s  # speed gained in each interval, a being linear
    v = first[4] + (np.cumsum(gained, axis=0) - gained) + a[:, :1] * t + j * t**2 / 2
    tangent = np.tan(delta)
    yaw_rate = v * tangent / wheelbase_m
    theta = first[2] + _simpson(yaw_rate, spacing / 2)  # (S-1, 2m+1)
    coarse = v[:, ::2]
    x = first[0] + _simpson(coarse * np.cos(theta), spacing)
    y = first[1] + _simpson(coarse * np.sin(theta), spacing)
    states = np.stack([x, y, theta[:, ::2], delta[:, ::4], v[:, ::4], a[:, ::4]], axis=-1)
    slope = (a * tangent + v * beta * (1 + tangent**2)) / wheelbase_m
    return states, np.stack([yaw_rate[:, ::4], slope[:, ::4]], axis=-1), spacing


def in_a_row(dense: FloatArray) -> FloatArray:
    """States (M, 6) of a `dense_motion` (S-1, m+1, 6) one after the other, those between intervals once."""
    return np.vstack([dense[:, :-1].reshape(-1, 6), dense[-1, -1]])


def _simpson(values: FloatArray, spacing_s: float) -> FloatArray:
    """Running integral over rows one after the other; (n, 2m+1) values give (n, m+1) integrals."""
    panels = spacing_s / 6 * (values[:, :-2:2] + 4 * values[:, 1::2] + values[:, 2::2])
    inside = np.cumsum(np.hstack([np.zeros((len(panels), 1)), panels]), axis=1)
    before = np.cumsum(np.concatenate([[0.0], inside[:-1, -1]]))
    return np.asarray(inside + before[:, None])
