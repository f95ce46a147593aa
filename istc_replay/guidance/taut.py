"""Pulling a path taut: the shortest smooth one near a given one that keeps clear of everything."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import daqp
import numpy as np

from istc_replay.datatypes import FloatArray, read_only
from istc_replay.guidance.clearance import Clearance
from istc_replay.guidance.curves import Curve, Pose

_PIECE_M = 1.0  # between the break points of the curvature
_PIECES_MAX = 200
_SAMPLES = 3  # poses checked a piece
_NEAR_M = 1.0  # gaps larger than the margin by this cannot bind in one step
_RESERVE_M = 0.015  # kept beyond the margins, for what lies between samples
_ROUNDS = 30
_EASING = 0.85  # what is left of a too sharp bend after a round
_CHANGE_M, _CHANGE_1PM = 0.5, 0.05  # largest changes in a round, at first
_TRUST_MIN = 1e-3  # share of them where to stop
_GAIN_M = 2e-3
_MISS_M = 0.01
_END_PRICE, _GAP_PRICE = 50.0, 20.0
_EVENNESS = 1.0  # price of squared changes of curvature
_END_TOLERANCE = 1e-10
_NUDGE = 1e-5
_DECIMALS = 6


@dataclass(frozen=True, eq=False)
class Limits:
    """What a path keeps to: largest curvature [1/m], change of curvature [1/m^2], clearance."""

    curvature_1pm: float
    sharpness_1pm2: float
    clearance: Clearance


@dataclass(frozen=True, eq=False)
class _Driven:
    """A path as driven: its gaps beyond the margins (C,), the miss at the goal (3,), and their slopes."""

    gaps: FloatArray
    miss: FloatArray
    gap_slopes: FloatArray  # (C, M + 2), rows only where the gap is near
    miss_slopes: FloatArray  # (3, M + 2)


def pull_taut(
    start: Pose, goal: Pose, lengths_m: FloatArray, bends_1pm: FloatArray, limits: Limits
) -> Curve | None:
    """Make a sharp path smooth, and as short as it gets nearby.

    The curvature is linear between about one break point a metre. Its values and the length are
    found by sequential quadratic programming in a trust region: the length is minimised subject to
    limits on curvature and its change, and to the linearised miss at the goal and gaps to
    obstacles and bounds, either of which may be violated at a price. Bends too sharp at first are
    eased from round to round, so that the path stays on its side of the obstacles.

    Parameters
    ----------
    start, goal : Pose
        The ends, met exactly.
    lengths_m, bends_1pm : ndarray
        (A,) arcs of the sharp path [m, 1/m].
    limits : Limits
        What the path keeps to.

    Returns
    -------
    Curve or None
        The path; None where the goal is not reached. It may still come too near to something.
    """
    length = float(lengths_m.sum())
    pieces = max(8, min(_PIECES_MAX, math.ceil(length / _PIECE_M)))
    # Each break point gets the mean curvature half a piece about it, so that the turns are kept.
    ends = np.concatenate([[0.0], np.cumsum(lengths_m)])
    turned = np.concatenate([[0.0], np.cumsum(lengths_m * bends_1pm)])
    halves = np.interp((np.arange(pieces + 2) - 0.5) * (length / pieces), ends, turned)
    values = np.append(np.diff(halves) * (pieces / length), length)  # curvatures and the length
    values[[1, pieces - 1]] += values[[0, pieces]]
    values[[0, pieces]] = 0.0
    values = _optimised(values, start.as_array(), goal.as_array(), limits)
    # Rounded, so that the last digits do not depend on the processor.
    return _exact(np.round(values, _DECIMALS), start, goal)


def _optimised(values: FloatArray, start: FloatArray, goal: FloatArray, limits: Limits) -> FloatArray:
    trust = 1.0
    now = _drive(values, start, goal, limits.clearance)
    merit = _merit(values, now)
    for _ in range(_ROUNDS):
        limit = limits.sharpness_1pm2 * values[-1] / (len(values) - 2)
        sharp = bool(np.abs(np.diff(values[:-1])).max() > 1.001 * limit)
        step = _step(values, now, now.miss, limits, trust)
        after = _drive(values + step, start, goal, limits.clearance)
        if np.abs(after.miss).max() > _MISS_M:
            # The same step again, now with what bending of the way to the goal it had left out.
            step = _step(values, now, after.miss - now.miss_slopes @ step, limits, trust)
            after = _drive(values + step, start, goal, limits.clearance)
        gain = merit - _merit(values + step, after)
        if gain > 0.0 or sharp:
            values, now, merit = values + step, after, merit - gain
            trust = min(2.0 * trust, 1.0)
        else:
            trust /= 4.0
        if not sharp and (0.0 < gain < _GAIN_M or trust < _TRUST_MIN):
            break
    return values


@cache
def _integrals(pieces: int) -> FloatArray:
    """Integrals (F + 1, M + 1) of the hat functions from 0 to each of F fine steps of [0, 1]."""
    fine = np.linspace(0.0, pieces, 2 * _SAMPLES * pieces + 1)[:, None] - np.arange(pieces + 1)
    rising, falling = np.clip(fine + 1.0, 0.0, 1.0), np.clip(fine, 0.0, 1.0)
    integrals = rising**2 / 2.0 + falling - falling**2 / 2.0
    integrals[:, 0] -= 0.5  # the first hat has no rising half
    return read_only(integrals / pieces)


def _simpson(values: FloatArray) -> FloatArray:
    """Integrals (S + 1, ...) from 0 to every second of the fine steps of [0, 1]."""
    pairs = values[:-2:2] + 4.0 * values[1::2] + values[2::2]
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(pairs, axis=0)]) / (
        3.0 * (len(values) - 1)
    )


def _drive(values: FloatArray, start: FloatArray, goal: FloatArray, clearance: Clearance) -> _Driven:
    kappa, length = values[:-1], values[-1]
    integrals = _integrals(len(kappa) - 1)
    heading = start[2] + length * (integrals @ kappa)
    c, s = np.cos(heading), np.sin(heading)
    turns = np.column_stack([length * integrals, integrals @ kappa])  # (F + 1, M + 2) slopes of the heading
    along = np.column_stack([_simpson(c), _simpson(s)])
    poses = np.column_stack([start[:2] + length * along, heading[::2]])
    slopes = np.stack(
        [-length * _simpson(s[:, None] * turns), length * _simpson(c[:, None] * turns), turns[::2]], axis=1
    )  # (S + 1, 3, M + 2)
    slopes[:, :2, -1] += along
    miss = poses[-1] - goal
    miss[2] = math.remainder(miss[2], 2.0 * math.pi)

    def gaps(poses: FloatArray) -> FloatArray:
        far = clearance.gaps(poses) - clearance.margins_m - _RESERVE_M
        return np.column_stack([far, clearance.rooms(poses)])

    here = gaps(poses)
    sample, thing = np.nonzero(here < _NEAR_M)
    some, index = np.unique(sample, return_inverse=True)
    row_slopes = np.zeros((len(sample), len(values)))
    for axis, nudge in enumerate(np.eye(3) * _NUDGE):
        change = (gaps(poses[some] + nudge)[index, thing] - here[sample, thing]) / _NUDGE
        row_slopes += change[:, None] * slopes[sample, axis]
    return _Driven(here[sample, thing], miss, row_slopes, slopes[-1])


def _merit(values: FloatArray, driven: _Driven) -> float:
    """Length, and the price of the worst miss and the worst gap."""
    gap = max(0.0, -float(driven.gaps.min(initial=0.0)))
    evenness = _EVENNESS / 2.0 * float((np.diff(values[:-1]) ** 2).sum())
    return float(values[-1]) + evenness + _END_PRICE * float(np.abs(driven.miss).max()) + _GAP_PRICE * gap


def _step(values: FloatArray, now: _Driven, miss: FloatArray, limits: Limits, trust: float) -> FloatArray:
    """Change (M + 2,) of the values within the trust region: a QP in it and the two amounts violated."""
    count, rows = len(values), len(now.gaps)
    kappa, length = values[:-1], values[-1]
    differ = np.diff(np.eye(count - 1), axis=0)
    jumps = differ @ kappa
    limit = limits.sharpness_1pm2 / len(jumps)
    none = np.zeros((len(jumps), 1))
    rate = np.column_stack([differ, np.full(len(jumps), -limit), none, none])
    back = np.column_stack([-differ, np.full(len(jumps), -limit), none, none])
    ones, nothing = np.ones((3, 1)), np.zeros((3, 1))
    matrix = np.vstack(
        [
            rate,
            back,
            np.hstack([now.miss_slopes, -ones, nothing]),
            np.hstack([-now.miss_slopes, -ones, nothing]),
            np.hstack([-now.gap_slopes, np.zeros((rows, 1)), -np.ones((rows, 1))]),
        ]
    )
    allowed = np.maximum(limit * length, _EASING * np.abs(jumps))
    upper = np.concatenate([allowed - jumps, allowed + jumps, -miss, miss, now.gaps])
    change = np.append(np.full(count - 1, _CHANGE_1PM * trust), _CHANGE_M * trust)
    high = np.minimum(change[:-1], np.maximum(limits.curvature_1pm - kappa, -change[:-1]))
    shorter = min(change[-1], 0.3 * length)
    low = np.maximum(-change[:-1], np.minimum(-limits.curvature_1pm - kappa, change[:-1]))
    high[[0, -1]] = low[[0, -1]] = 0.0
    hessian = np.diag(np.full(count + 2, 1e-3))
    hessian[: count - 1, : count - 1] += _EVENNESS * differ.T @ differ
    cost = np.concatenate([_EVENNESS * differ.T @ jumps, [1.0, _END_PRICE, _GAP_PRICE]])
    solution, _, flag, _ = daqp.solve(
        hessian,
        cost,
        np.ascontiguousarray(matrix),
        np.concatenate([high, [change[-1], 1e3, 1e3], upper]),
        np.concatenate([low, [-shorter, 0.0, 0.0], np.full(len(upper), -1e30)]),
    )
    return np.asarray(solution[:count]) if flag > 0 else np.zeros(count)


def _exact(values: FloatArray, start: Pose, goal: Pose) -> Curve | None:
    """Mend the rest of the miss at the goal by the least change of the curvatures and the length."""
    free = np.ones(len(values), dtype=bool)
    free[[0, -2]] = False
    for _ in range(10):
        curve = Curve(start, read_only(np.linspace(0.0, values[-1], len(values) - 1)), read_only(values[:-1]))
        miss = curve.end - goal.as_array()
        miss[2] = math.remainder(miss[2], 2.0 * math.pi)
        if np.abs(miss).max() < _END_TOLERANCE:
            return curve
        if np.abs(miss).max() > 0.1:
            return None
        slopes = _miss_slopes(values, start.as_array())
        values = values.copy()
        values[free] -= np.linalg.lstsq(slopes[:, free], miss, rcond=None)[0]
    return None


def _miss_slopes(values: FloatArray, start: FloatArray) -> FloatArray:
    kappa, length = values[:-1], values[-1]
    integrals = _integrals(len(kappa) - 1)
    heading = start[2] + length * (integrals @ kappa)
    c, s = np.cos(heading), np.sin(heading)
    turns = np.column_stack([length * integrals, integrals @ kappa])
    slopes = np.stack(
        [-length * _simpson(s[:, None] * turns)[-1], length * _simpson(c[:, None] * turns)[-1], turns[-1]]
    )
    slopes[:2, -1] += _simpson(c)[-1], _simpson(s)[-1]
    return slopes
