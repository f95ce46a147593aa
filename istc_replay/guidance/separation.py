"""Gaps between pairs of boxes along the axes of either, and how they change with the first one's pose."""

from __future__ import annotations

import numpy as np

from istc_replay.datatypes import FloatArray


def axis_gaps(x: FloatArray, y: FloatArray, angle: FloatArray, sizes: FloatArray) -> FloatArray:
    """Gaps (4, ...) along the car's two axes and the obstacle's two, negative where they overlap [m].

    Parameters
    ----------
    x, y, angle : ndarray
        (...) the obstacle's centre from the car's, and the car's heading, in the obstacle's frame [m, rad].
    sizes : ndarray
        (4, ...) half length and half width of the car, then of the obstacle [m].
    """
    a, b, p, q = sizes
    c, s = np.cos(angle), np.sin(angle)
    along, across = np.abs(c), np.abs(s)
    return np.stack(
        [
            np.abs(x * c + y * s) - a - (p * along + q * across),
            np.abs(y * c - x * s) - b - (p * across + q * along),
            np.abs(x) - p - (a * along + b * across),
            np.abs(y) - q - (a * across + b * along),
        ]
    )


def axis_slopes(
    axis: np.ndarray, x: FloatArray, y: FloatArray, angle: FloatArray, sizes: FloatArray
) -> FloatArray:
    """Slopes (3, N) of the gap along one axis (N,) of each pair by x, y and angle; see `axis_gaps`."""
    a, b, p, q = sizes
    c, s = np.cos(angle), np.sin(angle)
    along, across = -np.sign(c) * s, np.sign(s) * c  # slopes of |c| and |s|
    ahead, aside = np.sign(x * c + y * s), np.sign(y * c - x * s)
    nothing = np.zeros_like(x)
    return np.stack(
        [
            np.choose(axis, [ahead * c, -aside * s, np.sign(x), nothing]),
            np.choose(axis, [ahead * s, aside * c, nothing, np.sign(y)]),
            np.choose(
                axis,
                [
                    ahead * (y * c - x * s) - (p * along + q * across),
                    -aside * (y * s + x * c) - (p * across + q * along),
                    -(a * along + b * across),
                    -(a * across + b * along),
                ],
            ),
        ]
    )
