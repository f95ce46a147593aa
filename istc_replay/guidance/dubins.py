"""Shortest paths of bounded curvature (Dubins 1957), for one pair of poses or many at once.

A word is three arcs, each left (L), right (R) or straight (S). The lengths of the six words in
closed form are those of Shkel and Lumelsky, "Classification of the Dubins set" (2001).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from istc_replay.datatypes import FloatArray

#: The words in the order of every array here; each second is the one before, mirrored.
WORD_NAMES = ("LSL", "RSR", "LSR", "RSL", "LRL", "RLR")
_SIGNS = {"L": 1.0, "R": -1.0, "S": 0.0}
#: Signed curvatures (6, 3) of the words' arcs at radius 1.
WORD_CURVATURES = np.array([[_SIGNS[letter] for letter in name] for name in WORD_NAMES])
_SAME = 1e-9


class _Ends(NamedTuple):
    """Headings `a`, `b` (..., 2) at start and goal from the line between them, as they are and mirrored.

    `d` (..., 1) is the distance in radii; `ca`, `sa`, `cb`, `sb` are the headings' cosines and sines.
    """

    a: FloatArray
    b: FloatArray
    d: FloatArray
    ca: FloatArray
    sa: FloatArray
    cb: FloatArray
    sb: FloatArray


def word_lengths(starts: FloatArray, goals: FloatArray, radius_m: float) -> FloatArray:
    """Lengths of the arcs of all six words between many pairs of poses.

    Parameters
    ----------
    starts, goals : ndarray
        (..., 3) poses, broadcast to one shape [m, rad].
    radius_m : float
        Turning radius [m].

    Returns
    -------
    ndarray
        (..., 6, 3) lengths [m] in the order of `WORD_NAMES`; infinite where a word does not exist.
    """
    dx, dy = (goals[..., axis] - starts[..., axis] for axis in (0, 1))
    bearing = np.arctan2(dy, dx)
    d = np.hypot(dx, dy)[..., None] / radius_m
    # Headings from the line between the poses; a mirrored word is the word of the mirrored scene.
    a, b = starts[..., 2] - bearing, goals[..., 2] - bearing
    a, b = np.stack([a, -a], axis=-1), np.stack([b, -b], axis=-1)
    ends = _Ends(a, b, d, np.cos(a), np.sin(a), np.cos(b), np.sin(b))
    pairs = [lengths(ends) for lengths in (_lsl, _lsr, _lrl)]
    return np.asarray(radius_m * np.concatenate(pairs, axis=-2))


def _turn(angle_rad: FloatArray) -> FloatArray:
    """Wrap to [0, 2 pi), a whole turn less a rounding error counting as none."""
    turn = angle_rad % (2.0 * math.pi)
    return np.where(2.0 * math.pi - turn < 1e-12, 0.0, turn)


def _lsl(ends: _Ends) -> FloatArray:
    a, b, d, ca, sa, cb, sb = ends
    x, y = d + sa - sb, cb - ca
    p = np.hypot(x, y)
    # Where start and goal lie on one circle the straight arc has no direction.
    heading = np.where(p < _SAME, b, np.arctan2(y, x))
    return np.stack([_turn(heading - a), np.where(p < _SAME, 0.0, p), _turn(b - heading)], axis=-1)


def _lsr(ends: _Ends) -> FloatArray:
    a, b, d, ca, sa, cb, sb = ends
    x, y = d + sa + sb, -ca - cb
    square = x * x + y * y - 4.0
    p = np.sqrt(np.maximum(square, 0.0))
    heading = np.arctan2(y, x) - np.arctan2(-2.0, p)
    lengths = np.stack([_turn(heading - a), p, _turn(heading - b)], axis=-1)
    return np.where((square < -_SAME)[..., None], np.inf, lengths)


def _lrl(ends: _Ends) -> FloatArray:
    a, b, d, ca, sa, cb, sb = ends
    x, y = d + sa - sb, cb - ca
    distance = np.hypot(x, y)
    p = 2.0 * math.pi - 2.0 * np.arcsin(np.minimum(distance / 4.0, 1.0))
    t = _turn(np.arctan2(y, x) - a + p / 2.0)
    lengths = np.stack([t, p, _turn(b - a - t + p)], axis=-1)
    return np.where((distance > 4.0)[..., None], np.inf, lengths)
