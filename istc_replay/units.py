"""Time and angle conversions, in the one place where they happen."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

NS_PER_S = 1_000_000_000


def seconds_to_ns(seconds: float) -> int:
    """Round float seconds to integer nanoseconds."""
    return round(seconds * NS_PER_S)


def median_step(times: ArrayLike) -> float:
    """Median step of increasing times (S,), in their unit; 0 where there are less than two."""
    steps = np.diff(np.asarray(times))
    return float(np.median(steps)) if steps.size else 0.0


def wrap_angle(angle_rad: ArrayLike) -> NDArray[np.float64]:
    """Wrap angles to [-pi, pi).

    Parameters
    ----------
    angle_rad : array_like
        Angles of any shape [rad].

    Returns
    -------
    ndarray
        The same shape, in [-pi, pi) [rad].
    """
    wrapped = (np.asarray(angle_rad, dtype=np.float64) + np.pi) % (2.0 * np.pi) - np.pi
    # The sum can round up to a whole turn for angles just below -pi.
    return np.asarray(np.where(wrapped >= np.pi, -np.pi, wrapped))
