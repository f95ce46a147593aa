"""Polylines of the ground: points by the share of their length, middles, and lines beside a line."""

from __future__ import annotations

import numpy as np

from istc_replay.datatypes import FloatArray

#: A line of the road has no more points than this: what bounds a plan is found among all of them.
LINE_POINTS = 20_000


def resampled(points_m: FloatArray, shares: FloatArray) -> FloatArray:
    """Points (S, 2) at shares (S,) of the length of a polyline (P, 2)."""
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points_m, axis=0).T))])
    at = np.asarray(shares) * arc[-1]
    return np.stack([np.interp(at, arc, column) for column in points_m.T], axis=-1)


def middle_line(left_m: FloatArray, right_m: FloatArray) -> FloatArray:
    """The line (P, 2) between two: point by point where both have as many, else by share of their length."""
    if len(left_m) != len(right_m):
        shares = np.linspace(0.0, 1.0, max(len(left_m), len(right_m)))
        left_m, right_m = resampled(left_m, shares), resampled(right_m, shares)
    return np.asarray((left_m + right_m) / 2.0)


def beside(points_m: FloatArray, distance_m: float) -> FloatArray:
    """The line (P, 2) to the left of a polyline (P, 2), by a distance [m]; negative: to its right."""
    steps = np.diff(points_m, axis=0)
    along = steps / np.hypot(*steps.T)[:, None]
    normals = np.stack([-along[:, 1], along[:, 0]], axis=-1)  # (P-1, 2)
    before, after = np.vstack([normals[:1], normals]), np.vstack([normals, normals[-1:]])
    # The vertex of two parallels; a sharp turn is cut off at twice the distance.
    share = 1.0 / np.maximum((1.0 + (before * after).sum(axis=1)) / 2.0, 0.25)
    return np.asarray(points_m + distance_m * share[:, None] * (before + after) / 2.0)
