"""Shortest paths of bounded curvature (Dubins 1957), and their smoothed versions.

A word is three arcs, each left (L), right (R) or straight (S). The lengths of the six words in
closed form are those of Shkel and Lumelsky, "Classification of the Dubins set" (2001).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from istc_replay.datatypes import FloatArray
from istc_replay.samples.paths import Curve, Pose, smooth_curve

_SIGNS = {"L": 1.0, "R": -1.0, "S": 0.0}
_NEWTON_ROUNDS = 25
_END_TOLERANCE = 1e-10
_SAME = 1e-9

#: Normalised lengths t, p, q of the three arcs (radius 1), or None where the word does not exist.
Lengths = tuple[float, float, float] | None


@dataclass(frozen=True, slots=True)
class Word:
    """One of the six words with the lengths of its arcs [m] at one turning radius [m]."""

    name: str
    radius_m: float
    lengths_m: tuple[float, float, float]

    @property
    def length_m(self) -> float:
        """Length of the whole path."""
        return sum(self.lengths_m)

    @property
    def curvatures_1pm(self) -> tuple[float, ...]:
        """Signed curvature of each arc."""
        return tuple(_SIGNS[letter] / self.radius_m for letter in self.name)


def dubins_words(start: Pose, goal: Pose, radius_m: float) -> list[Word]:
    """Return the words that lead from start to goal, the shortest first."""
    dx, dy = goal.x_m - start.x_m, goal.y_m - start.y_m
    bearing = math.atan2(dy, dx)
    d = math.hypot(dx, dy) / radius_m
    a, b = _turn(start.heading_rad - bearing), _turn(goal.heading_rad - bearing)
    words = []
    for name, solve in _WORDS.items():
        lengths = solve(a, b, d)
        if lengths is not None:
            t, p, q = (radius_m * length for length in lengths)
            words.append(Word(name, radius_m, (t, p, q)))
    return sorted(words, key=lambda word: word.length_m)


def smooth_word(word: Word, start: Pose, goal: Pose, ramp_m: float) -> Curve | None:
    """Spread the word's changes of curvature over ramps and still end exactly at the goal.

    Newton's method on the three lengths; None where a length would have to be negative.
    """
    target = np.array([goal.x_m, goal.y_m, goal.heading_rad])

    def miss(lengths: FloatArray) -> FloatArray:
        curve = smooth_curve(start, lengths, word.curvatures_1pm, ramp_m)
        error = curve.poses([curve.length_m])[0] - target
        error[2] = math.remainder(error[2], 2.0 * math.pi)
        return np.asarray(error)

    lengths = np.array(word.lengths_m)
    for _ in range(_NEWTON_ROUNDS):
        error = miss(lengths)
        if np.abs(error).max() < _END_TOLERANCE:
            return smooth_curve(start, lengths, word.curvatures_1pm, ramp_m)
        step = 1e-6
        slopes = np.column_stack([(miss(lengths + step * axis) - error) / step for axis in np.eye(3)])
        lengths = lengths - np.linalg.lstsq(slopes, error, rcond=None)[0]
        if lengths.min() < -1e-9:
            return None
        lengths = np.maximum(lengths, 0.0)
    return None


# --- the six words: a and b are the headings at start and goal from the line between them --------


def _turn(angle_rad: float) -> float:
    """Wrap to [0, 2 pi), a whole turn less a rounding error counting as none."""
    turn = angle_rad % (2.0 * math.pi)
    return 0.0 if 2.0 * math.pi - turn < 1e-12 else turn


def _lsl(a: float, b: float, d: float) -> Lengths:
    x, y = d + math.sin(a) - math.sin(b), math.cos(b) - math.cos(a)
    p = math.hypot(x, y)
    if p < _SAME:
        # Start and goal lie on one circle: the straight arc has no direction.
        return _turn(b - a), 0.0, 0.0
    heading = math.atan2(y, x)
    return _turn(heading - a), p, _turn(b - heading)


def _lsr(a: float, b: float, d: float) -> Lengths:
    x, y = d + math.sin(a) + math.sin(b), -math.cos(a) - math.cos(b)
    square = x * x + y * y - 4.0
    if square < -_SAME:
        return None
    p = math.sqrt(max(square, 0.0))
    heading = math.atan2(y, x) - math.atan2(-2.0, p)
    return _turn(heading - a), p, _turn(heading - b)


def _lrl(a: float, b: float, d: float) -> Lengths:
    x, y = d + math.sin(a) - math.sin(b), math.cos(b) - math.cos(a)
    distance = math.hypot(x, y)
    if distance > 4.0:
        return None
    p = 2.0 * math.pi - 2.0 * math.asin(distance / 4.0)
    t = _turn(math.atan2(y, x) - a + p / 2.0)
    return t, p, _turn(b - a - t + p)


def _mirrored(word: Callable[[float, float, float], Lengths]) -> Callable[[float, float, float], Lengths]:
    """The word with left and right exchanged: the same lengths in the mirrored scene."""
    return lambda a, b, d: word(-a, -b, d)


_WORDS = {
    "LSL": _lsl,
    "RSR": _mirrored(_lsl),
    "LSR": _lsr,
    "RSL": _mirrored(_lsr),
    "LRL": _lrl,
    "RLR": _mirrored(_lrl),
}
