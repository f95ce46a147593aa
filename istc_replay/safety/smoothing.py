"""Derivatives of recorded values by Savitzky-Golay filters, never across gaps."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray

#: Even stamps for each recorded one, at most.
_MOST_EVEN = 4


def smoothed(times_s: FloatArray, values: FloatArray, pieces: NDArray[np.int64], window: int) -> FloatArray:
    """Values, first and second derivatives of the quadratics that fit best.

    Each piece is taken to even spacing, its own median step, and each sample to the parabola of
    least squares through the `window` samples around it.

    Parameters
    ----------
    times_s : ndarray
        (n,) strictly increasing within a piece.
    values : ndarray
        (n,) or (C, n) values; NaN in any row ends a piece of all.
    pieces : ndarray
        (n,) piece of each sample, not decreasing: no fit crosses from one to the next.
    window : int
        Odd number of samples of a fit, 3 at least.

    Returns
    -------
    ndarray
        (3, n) or (3, C, n) value, rate and curvature; NaN for samples nearer to an end of their piece than
        half a window.
    """
    rows, count = np.atleast_2d(values), values.shape[-1]
    out = np.full((3, len(rows), count), np.nan)
    if count >= window:
        kernels = _kernels(window)
        finite = np.asarray(np.isfinite(rows).all(axis=0))
        cut = np.flatnonzero((np.diff(pieces) != 0) | (np.diff(finite.astype(np.int8)) != 0)) + 1
        edges = np.concatenate([[0], cut, [count]])
        for start, end in pairwise(edges):
            if end - start >= window and finite[start]:
                out[..., start:end] = _piece(times_s[start:end], rows[:, start:end], kernels)
    return out.reshape(3, *values.shape)


def pieces_of(times_ns: NDArray[np.int64], longest_ns: float) -> NDArray[np.int64]:
    """(n,) number of the piece of each sample: a longer pause begins the next."""
    breaks = np.diff(times_ns, prepend=times_ns[:1]) > longest_ns
    return np.cumsum(breaks).astype(np.int64)


@lru_cache(maxsize=64)
def _kernels(window: int) -> FloatArray:
    """(3, window) weights of value, rate and curvature at the middle, for unit spacing."""
    offset = np.arange(window) - window // 2
    fit = np.linalg.pinv(np.stack([np.ones(window), offset, offset**2], axis=1).astype(np.float64))
    return np.asarray(fit * np.array([[1.0], [1.0], [2.0]]))


def _piece(times: FloatArray, values: FloatArray, kernels: FloatArray) -> FloatArray:
    window, duration = kernels.shape[1], times[-1] - times[0]
    # However odd the stamps, the even ones are no more than a few times as many.
    step = max(float(np.median(np.diff(times))), duration / (_MOST_EVEN * times.size))
    even = times[0] + step * np.arange(max(round(duration / step) + 1, window))
    # About the first value: what is far from zero would lose digits.
    spaced = np.stack([np.interp(even, times, row - row[0]) for row in values])
    # (3, C, m) of windows (C, m, w) and kernels (3, w).
    fitted = np.einsum("cmw,kw->kcm", sliding_window_view(spaced, window, axis=-1), kernels)
    fitted /= np.array([1.0, step, step**2])[:, None, None]
    fitted[0] += values[:, :1]
    half = window // 2
    middle = even[half : even.size - half]
    slack = step * 1e-3
    inside = (times >= middle[0] - slack) & (times <= middle[-1] + slack)
    flat = fitted.reshape(-1, middle.size)
    at = np.stack([np.interp(times, middle, row) for row in flat]).reshape(*fitted.shape[:2], times.size)
    return np.where(inside, at, np.nan)
