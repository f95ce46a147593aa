"""The least separation of moving boxes over continuous time, proven by Lipschitz bisection.

A gap known in the middle of an interval, with a bound of how fast it can change, bounds the gap
over the whole interval. Intervals whose bound does not decide are cut in two, so often and no
more: what is still open then stays undecided, never passed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from istc_replay.datatypes import FloatArray
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.motion import Motion
from istc_replay.safety.plan import IntArray

#: Bisections of one interval, and intervals looked at for the proof on top of the first.
_MOST_BISECTIONS = 32
_MOST_INTERVALS = 400_000
#: The least separation is searched to this precision, with so many intervals on top of the first.
_RESOLUTION_M = 1e-3
_MOST_PRECISE = 40_000


@dataclass(frozen=True, slots=True)
class Least:
    """A least value over time: found somewhere, and proven everywhere (found >= least >= proven).

    Infinite where there was nothing to look at. `first` and `second` are the rows of what it was
    found between (second -1: nothing), `time_s` is from the window's start.
    """

    found: float = np.inf
    proven: float = np.inf
    first: int = -1
    second: int = -1
    time_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """Moving or standing boxes with bounds over each piece, for B bodies and P pieces.

    `sample(body, piece, offset_s)` gives boxes (m, 5) and velocities of their centres (m, 2).
    All else (B, P): `radius_m` of the half diagonal, bounds of the centre's `speed_mps` and
    `acceleration_mps2`, and `spin_mps` = radius |w|; NaN radius where a body is absent.
    """

    sample: Callable[[IntArray, IntArray, FloatArray], tuple[FloatArray, FloatArray]]
    radius_m: FloatArray
    speed_mps: FloatArray
    acceleration_mps2: FloatArray
    spin_mps: FloatArray


def moving_bodies(motion: Motion) -> Bodies:
    """The vehicles of a motion; those not judged are absent."""
    ahead, turn = np.abs(motion.dimensions[:, 3, None]), motion.bounds[..., 2]
    radius = np.hypot(motion.dimensions[:, 0, None], motion.dimensions[:, 1, None]) / 2.0
    radius = np.where(motion.present & motion.judged[:, None], radius, np.nan)
    return Bodies(
        sample=motion.sample,
        radius_m=radius,
        speed_mps=motion.bounds[..., 0] + ahead * turn,
        acceleration_mps2=motion.point_acceleration(ahead[:, 0]),
        spin_mps=radius * turn,
    )


def standing_bodies(walls_m: FloatArray) -> Bodies:
    """Axis-aligned boxes (B, P, 4) x_min, x_max, y_min, y_max that stand still in each piece."""
    low, high = walls_m[..., 0::2], walls_m[..., 1::2]
    boxes = np.concatenate([(low + high) / 2.0, np.zeros_like(low[..., :1]), high - low], axis=-1)
    still = np.zeros(walls_m.shape[:2])

    def sample(body: IntArray, piece: IntArray, offset_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return boxes[body, piece], np.zeros((offset_s.size, 2))

    return Bodies(sample, np.hypot(boxes[..., 3], boxes[..., 4]) / 2.0, still, still, still)


def least_gap(
    first: Bodies, second: Bodies | None, edges_s: FloatArray, limit_m: float, error_m: float
) -> Least:
    """Least signed gap of the boxes of two sets, or of all pairs of one set, over closed pieces.

    The gap is Lipschitz in time with L = |v_i - v_j| + rho_i |w_i| + rho_j |w_j|, v the velocities
    of the centres, rho the half diagonals. An interval of length 2 r is decided where gap(middle)
    - L r is above the limit and not below the least gap found by more than the resolution.

    Parameters
    ----------
    first, second : Bodies
        Every pair of a first and a second; None: every pair of the first.
    edges_s : ndarray
        (P+1,) the pieces' boundaries [s].
    limit_m, error_m : float
        The gap to prove [m], and the error of sampled gaps, taken off what is proven [m].
    """
    others, durations = second or first, np.diff(edges_s)
    i, j, piece = _near_pairs(first, second, durations, limit_m)
    low, high = np.zeros(piece.size), durations[piece]
    best, proven, looked_at = Least(), np.inf, -piece.size
    for bisection in range(_MOST_BISECTIONS):
        if not piece.size:
            break
        middle, radius = (low + high) / 2.0, (high - low) / 2.0
        (boxes_i, v_i), (boxes_j, v_j) = first.sample(i, piece, middle), others.sample(j, piece, middle)
        gap = box_gap(boxes_i, boxes_j)
        pull = first.acceleration_mps2[i, piece] + others.acceleration_mps2[j, piece]
        spin = first.spin_mps[i, piece] + others.spin_mps[j, piece]
        lower = gap - error_m - (np.hypot(*(v_i - v_j).T) + pull * radius / 2.0 + spin) * radius
        least = int(np.argmin(gap))
        if gap[least] < best.found:
            time_s = float(edges_s[piece[least]] + middle[least])
            best = Least(float(gap[least]), -np.inf, int(i[least]), int(j[least]), time_s)
        looked_at += gap.size
        failed, precise = best.found <= limit_m, best.found - _RESOLUTION_M
        undecided = ~(lower > (precise if failed else max(limit_m, precise)))
        imprecise = looked_at + 2 * np.count_nonzero(undecided) > _MOST_PRECISE
        if imprecise:
            undecided = ~(lower > limit_m)  # give up the precision, not the proof
        proven = np.minimum(proven, np.min(lower, where=~undecided, initial=np.inf))
        spent = looked_at + 2 * np.count_nonzero(undecided) > _MOST_INTERVALS
        if spent or (imprecise and failed) or bisection == _MOST_BISECTIONS - 1:
            proven = np.minimum(proven, np.min(lower))
            break
        i, j, piece = (np.tile(rows[undecided], 2) for rows in (i, j, piece))
        low, middle, high = low[undecided], middle[undecided], high[undecided]
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
    return replace(best, proven=float(np.minimum(best.found, proven)))


def _near_pairs(
    first: Bodies, second: Bodies | None, durations: FloatArray, limit_m: float
) -> tuple[IntArray, IntArray, IntArray]:
    """Rows i, j and pieces in which circles about the boxes do not rule out the least gap.

    The gap in the middle of a piece is at most the distance of the centres; where the circles,
    grown by what the piece's motion can add, stay further apart than the least of these
    distances and than the limit, neither a violation nor the least gap can be.
    """
    centres_i, reach_i = _circles(first, durations)
    centres_j, reach_j = (centres_i, reach_i) if second is None else _circles(second, durations)
    upper, kept = np.inf, []
    for row in range(reach_i.shape[0]):
        begin = row + 1 if second is None else 0
        distance = np.hypot(*np.moveaxis(centres_j[begin:] - centres_i[row], -1, 0))
        lower = distance - reach_i[row] - reach_j[begin:]  # NaN where one of them is absent
        upper = min(upper, float(np.min(distance, where=~np.isnan(lower), initial=np.inf)))
        rows, pieces = np.nonzero(lower <= max(upper, limit_m))
        kept.append((np.full(rows.size, row), rows + begin, pieces, lower[rows, pieces]))
    if not kept:
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.int64)
    i, j, piece, bound = (np.concatenate(values) for values in zip(*kept, strict=True))
    near = bound <= max(upper, limit_m)
    return i[near], j[near], piece[near]


def _circles(bodies: Bodies, durations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(B, P, 2) centres in the middle of the pieces, (B, P) radii that hold over the pieces."""
    body, piece = (index.ravel() for index in np.indices(bodies.radius_m.shape))
    with np.errstate(all="ignore"):
        boxes, _ = bodies.sample(body, piece, durations[piece] / 2.0)
        reach = bodies.radius_m + (bodies.speed_mps + bodies.spin_mps) * durations / 2.0
    return boxes[:, :2].reshape(*reach.shape, 2), reach
