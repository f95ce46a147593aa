"""Pulling a path taut: the shortest smooth one near a given one that keeps clear of everything."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import daqp
import numpy as np

from istc_replay.datatypes import FloatArray, read_only
from istc_replay.guidance.clearance import Clearance
from istc_replay.guidance.curves import Curve, Pose
from istc_replay.guidance.tangents import Sharp

_PIECE_M = 1.0  # between the break points of the curvature
_PIECES_MAX = 200
_SAMPLES = 3  # poses checked a piece
_FINE = 2 * _SAMPLES  # steps of the integration a piece
_NEAR_M = 1.0  # gaps larger than the margin by this cannot bind in one step
_RESERVE_M = 0.015  # kept beyond the margins, for what lies between samples
_ROUNDS = 30
_EASING = 0.85  # what is left of a too sharp bend after a round
_CHANGE_M, _CHANGE_1PM = 0.5, 0.05  # largest changes in a round, at first
_TRUST_MIN = 0.02  # share of them where to stop
_GAIN_M = 5e-3
#: A path that still lacks more after so many rounds, and gains less in one, does not get past.
_STUCK_M, _ROUNDS_MIN = 0.1, 3
_MISS_M = 0.01
_END_PRICE, _GAP_PRICE = 50.0, 20.0
_BEND_PRICE_M2 = 5.0  # of the largest curvature beyond the preferred one
_EVENNESS = 0.1  # price of squared changes of curvature
_SAFE = 0.999  # of a limit, which the last digits must not break
_END_TOLERANCE = 1e-10
_DECIMALS = 6


@dataclass(frozen=True, eq=False)
class Limits:
    """What a path keeps to.

    The largest curvature, and the largest one without need [1/m]; change of curvature [1/m^2]; clearance.
    """

    curvature_1pm: float
    preferred_1pm: float
    sharpness_1pm2: float
    clearance: Clearance


@dataclass(frozen=True, eq=False)
class _Driven:
    """A path as driven: its gaps beyond the margins (C,), the miss at the goal (3,), and their slopes."""

    gaps: FloatArray
    miss: FloatArray
    gap_slopes: FloatArray  # (C, M + 2), only where the gap is near
    miss_slopes: FloatArray  # (3, M + 2)


def pull_taut(path: Sharp, goal: Pose, limits: Limits) -> Curve | None:
    """Make a sharp path smooth, and as short as it gets nearby.

    The curvature is linear between about one break point a metre. Its values and the length are
    found by sequential quadratic programming in a trust region: the length is minimised subject to
    limits on curvature and its change, and to the linearised miss at the goal and gaps to
    obstacles and bounds, either of which may be violated at a price; bends beyond the preferred
    curvature have a price too. The Hessian is that of a string under a tension of one. Bends too
    sharp at first are eased from round to round, so that the path stays on its side of the obstacles.

    Parameters
    ----------
    path : Sharp
        The sharp path; the curve starts where it does.
    goal : Pose
        Where the curve ends, exactly.
    limits : Limits
        What the path keeps to.

    Returns
    -------
    Curve or None
        The path; None where the goal is not reached. It may still come too near to something.
    """
    length, start = path.length_m, path.start
    pieces = max(8, min(_PIECES_MAX, math.ceil(length / _PIECE_M)))
    # Each break point gets the mean curvature about it, so that the turns are kept.
    ends = np.concatenate([[0.0], np.cumsum(path.lengths_m)])
    turned = np.concatenate([[0.0], np.cumsum(path.lengths_m * path.bends_1pm)])
    at = np.linspace(0.0, length, pieces + 1)
    half = max(path.ramp_m, length / pieces) / 2.0
    kappa = (np.interp(at + half, ends, turned) - np.interp(at - half, ends, turned)) / (2.0 * half)
    kappa[[0, -1]] = 0.0
    values = _optimised(np.append(kappa, length), start.as_array(), goal.as_array(), limits)
    # Rounded, so that the last digits do not depend on the processor.
    return _exact(np.round(values, _DECIMALS), start, goal)


def _optimised(values: FloatArray, start: FloatArray, goal: FloatArray, limits: Limits) -> FloatArray:
    trust = 1.0
    now = _drive(values, start, goal, limits.clearance)
    merit = _merit(values, now, limits)
    for number in range(_ROUNDS):
        limit = limits.sharpness_1pm2 * values[-1] / (len(values) - 2)
        sharp = bool(np.abs(np.diff(values[:-1])).max() > 1.001 * limit)
        step = _step(values, now, now.miss, limits, trust)
        after = _drive(values + step, start, goal, limits.clearance)
        if np.abs(after.miss).max() > _MISS_M:
            # The same step again, now with what bending of the way to the goal it had left out.
            step = _step(values, now, after.miss - now.miss_slopes @ step, limits, trust)
            after = _drive(values + step, start, goal, limits.clearance)
        gain = merit - _merit(values + step, after, limits)
        if gain > 0.0 or sharp:
            values, now, merit = values + step, after, merit - gain
            trust = min(2.0 * trust, 1.0)
        else:
            trust /= 4.0
        stuck = number >= _ROUNDS_MIN and gain < _STUCK_M and now.gaps.min(initial=0.0) < -_STUCK_M
        if stuck or (not sharp and (abs(gain) < _GAIN_M or trust < _TRUST_MIN)):
            break
    return values


@lru_cache(maxsize=32)
def _integrals(pieces: int) -> FloatArray:
    """Integrals (F + 1, M + 1) of the hat functions from 0 to each of F fine steps of [0, 1]."""
    fine = np.linspace(0.0, pieces, _FINE * pieces + 1)[:, None] - np.arange(pieces + 1)
    rising, falling = np.clip(fine + 1.0, 0.0, 1.0), np.clip(fine, 0.0, 1.0)
    integrals = rising**2 / 2.0 + falling - falling**2 / 2.0
    integrals[:, 0] -= 0.5  # the first hat has no rising half
    return read_only(integrals / pieces)


@lru_cache(maxsize=32)
def _differences(pieces: int) -> FloatArray:
    """Changes (M, M - 1) from break point to break point by the curvatures of the inner ones."""
    return read_only(np.diff(np.eye(pieces + 1), axis=0)[:, 1:-1])


@lru_cache(maxsize=32)
def _evenness(pieces: int) -> FloatArray:
    """Hessian (M - 1, M - 1) of half the sum of squared changes."""
    differences = _differences(pieces)
    return read_only(differences.T @ differences)


def _drive(values: FloatArray, start: FloatArray, goal: FloatArray, clearance: Clearance) -> _Driven:
    kappa, length = values[:-1], values[-1]
    heading = start[2] + length * (_integrals(len(kappa) - 1) @ kappa)
    way = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    # Simpson's rule, from 0 to every second of the fine steps.
    steps = (way[:-2:2] + 4.0 * way[1::2] + way[2::2]) * (length / (3.0 * (len(way) - 1)))
    poses = np.empty((len(steps) + 1, 3))
    poses[0, :2], poses[1:, :2], poses[:, 2] = start[:2], start[:2] + np.cumsum(steps, axis=0), heading[::2]
    miss = poses[-1] - goal
    miss[2] = math.remainder(miss[2], 2.0 * math.pi)
    who, gaps, slopes = clearance.near_gaps(poses, _NEAR_M)
    rows = _pose_slopes(np.append(who, len(poses) - 1), poses, values)  # (C + 1, 3, M + 2)
    return _Driven(gaps - _RESERVE_M, miss, np.einsum("ca,cam->cm", slopes, rows[:-1]), rows[-1])


def _pose_slopes(who: np.ndarray, poses: FloatArray, values: FloatArray) -> FloatArray:
    """Slopes (C, 3, M + 2) of some poses: a bend turns what lies behind it about itself.

    The bend of a hat function counts at its break point; within its reach that is an approximation.
    """
    kappa, length = values[:-1], values[-1]
    turns = length * _integrals(len(kappa) - 1)[::2][who]  # (C, M + 1)
    pivots = poses[::_SAMPLES, :2]
    behind = np.arange(len(pivots)) * _SAMPLES <= who[:, None]
    slopes = np.empty((len(who), 3, len(values)))
    slopes[:, 0, :-1] = (pivots[:, 1] - poses[who, 1:2]) * turns * behind
    slopes[:, 1, :-1] = (poses[who, :1] - pivots[:, 0]) * turns * behind
    slopes[:, 2, :-1] = turns
    slopes[:, :, -1] = slopes[:, :, :-1] @ kappa / length
    slopes[:, :2, -1] += (poses[who, :2] - poses[0, :2]) / length
    return slopes


def _merit(values: FloatArray, driven: _Driven, limits: Limits) -> float:
    """Length, and the price of the worst miss and the worst gap."""
    gap = max(0.0, -float(driven.gaps.min(initial=0.0)))
    bend = max(0.0, float(np.abs(values[:-1]).max()) - limits.preferred_1pm)
    evenness = _EVENNESS / 2.0 * float((np.diff(values[:-1]) ** 2).sum())
    miss = float(np.abs(driven.miss).max())
    return float(values[-1]) + evenness + _END_PRICE * miss + _GAP_PRICE * gap + _BEND_PRICE_M2 * bend


def _step(values: FloatArray, now: _Driven, miss: FloatArray, limits: Limits, trust: float) -> FloatArray:
    """Change (M + 2,) of the values within the trust region: a QP in it and the amounts violated."""
    kappa, length = values[1:-2], values[-1]
    inner, pieces = len(kappa), len(kappa) + 1
    jumps = np.diff(values[:-1])
    near = np.flatnonzero(np.abs(kappa) > limits.preferred_1pm - _CHANGE_1PM * trust)
    # Columns: the inner break points, the length, the miss, what gaps lack, the bend beyond.
    columns = [*range(1, inner + 1), -1]
    rows = np.cumsum([pieces, 3, 3, len(now.gaps), len(near)])
    matrix = np.zeros((rows[-1], inner + 4))
    matrix[: rows[0], :inner] = _differences(pieces)
    matrix[rows[0] : rows[1], : inner + 1] = now.miss_slopes[:, columns]
    matrix[rows[1] : rows[2], : inner + 1] = -now.miss_slopes[:, columns]
    matrix[rows[0] : rows[2], inner + 1] = -1.0
    matrix[rows[2] : rows[3], : inner + 1] = -now.gap_slopes[:, columns]
    matrix[rows[2] : rows[3], inner + 2] = -1.0
    matrix[np.arange(rows[3], rows[4]), near] = np.sign(kappa[near])
    matrix[rows[3] :, inner + 3] = -1.0
    allowed = np.maximum(_SAFE * limits.sharpness_1pm2 * length / pieces, _EASING * np.abs(jumps))
    upper = np.concatenate(
        [allowed - jumps, -miss, miss, now.gaps, limits.preferred_1pm - np.abs(kappa[near])]
    )
    lower = np.concatenate([-allowed - jumps, np.full(len(upper) - pieces, -1e30)])
    change, longer = _CHANGE_1PM * trust, _CHANGE_M * trust
    high = np.minimum(change, np.maximum(limits.curvature_1pm - kappa, -change))
    low = np.maximum(-change, np.minimum(-limits.curvature_1pm - kappa, change))
    integrals = _integrals(pieces)[::_FINE]
    turning = np.column_stack([length * integrals[:, 1:-1], integrals @ values[:-1]])
    hessian = np.diag(np.full(inner + 4, 1e-3))
    hessian[:inner, :inner] += _EVENNESS * _evenness(pieces)
    # A taut string of tension one: turning a piece aside costs half the square of the angle.
    hessian[: inner + 1, : inner + 1] += length / pieces * (turning.T @ turning)
    cost = np.concatenate(
        [_EVENNESS * jumps @ _differences(pieces), [1.0, _END_PRICE, _GAP_PRICE, _BEND_PRICE_M2]]
    )
    solution, _, flag, _ = daqp.solve(
        hessian,
        cost,
        matrix,
        np.concatenate([high, [longer, 1e3, 1e3, 1e3], upper]),
        np.concatenate([low, [-min(longer, 0.3 * length), 0.0, 0.0, 0.0], lower]),
    )
    step = np.zeros(len(values))
    if flag > 0:
        step[columns] = solution[: inner + 1]
    return step


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
        poses = curve.poses(np.linspace(0.0, values[-1], _SAMPLES * (len(values) - 2) + 1))
        slopes = _pose_slopes(np.array([len(poses) - 1]), poses, values)[0]
        values = values.copy()
        values[free] -= np.linalg.lstsq(slopes[:, free], miss, rcond=None)[0]
    return None
