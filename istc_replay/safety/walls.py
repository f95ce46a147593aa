"""The least margin of moving boxes inside axis-aligned walls over continuous time, proven."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from istc_replay.datatypes import FloatArray, Frame
from istc_replay.geometry import to_map
from istc_replay.safety.motion import Motion, boxes_of
from istc_replay.safety.plan import IntArray
from istc_replay.safety.sweep import Least

#: Bisections of one interval, and intervals looked at in all.
_MOST_BISECTIONS = 32
_MOST_INTERVALS = 1_000_000


def wall_margin(boxes: FloatArray, walls_m: FloatArray) -> FloatArray:
    """Least distance of the corners of boxes (..., 5) inward from walls (..., 4) [m].

    Walls are x_min, x_max, y_min, y_max; the margin is negative where a corner is outside.
    """
    x, y, heading, length, width = np.moveaxis(boxes, -1, 0)
    c, s = np.abs(np.cos(heading)), np.abs(np.sin(heading))
    half_x, half_y = (length * c + width * s) / 2.0, (length * s + width * c) / 2.0
    x_min, x_max, y_min, y_max = np.moveaxis(walls_m, -1, 0)
    sides = [x - half_x - x_min, x_max - x - half_x, y - half_y - y_min, y_max - y - half_y]
    return np.asarray(np.minimum.reduce(np.broadcast_arrays(*sides)))


def least_inside(
    motion: Motion, walls_m: FloatArray, tolerance_m: float, map_frame: Frame | None = None
) -> Least:
    """Least margin of the moving boxes inside their walls, over closed pieces.

    A corner's coordinate between two instants h apart is at most the larger of its values there
    plus M h^2 / 8, M = |a| + |v w| + r (|dw/dt| + w^2) its largest acceleration, r its distance
    from the rear axle. Substeps that this does not decide are bisected.

    Parameters
    ----------
    motion : Motion
        The vehicles; those not judged are left out.
    walls_m : ndarray
        (V, P, 4) x_min, x_max, y_min, y_max [m]; NaN walls bind nothing.
    tolerance_m : float
        The margin may be this much below zero [m].
    map_frame : Frame, optional
        The corridor frame, where the walls are in the map frame.
    """
    walled = motion.present & motion.judged[:, None] & np.isfinite(walls_m).all(axis=2)
    vehicle, piece = np.nonzero(walled)
    if not vehicle.size:
        return Least()
    walls, dimensions = walls_m[vehicle, piece], motion.dimensions[vehicle]
    reach = np.hypot(
        np.abs(motion.dimensions[:, 3]) + motion.dimensions[:, 0] / 2.0, motion.dimensions[:, 1] / 2.0
    )
    bend = motion.point_acceleration(reach)[vehicle, piece]
    steps = motion.nodes.shape[2] - 1
    offsets = motion.durations_s[piece, None] * np.arange(steps + 1) / steps
    boxes = boxes_of(motion.nodes[vehicle, piece], dimensions[:, None])
    values = wall_margin(_turned(boxes, map_frame), walls[:, None])

    def margin(rows: IntArray, offset_s: FloatArray) -> FloatArray:
        boxes, _ = motion.sample(vehicle[rows], piece[rows], offset_s)
        return wall_margin(_turned(boxes, map_frame), walls[rows])

    row = np.repeat(np.arange(vehicle.size), steps)
    spans = np.stack(
        [array.ravel() for array in (offsets[:, :-1], offsets[:, 1:], values[:, :-1], values[:, 1:])]
    )
    found, proven, worst, offset_s = _bisect(margin, row, spans, bend, motion.error_m[vehicle], tolerance_m)
    time_s = float(motion.edges_s[piece[worst]]) + offset_s
    return Least(found, proven, int(vehicle[worst]), -1, time_s)


def _bisect(
    margin: Callable[[IntArray, FloatArray], FloatArray],
    row: IntArray,
    spans: FloatArray,
    bend: FloatArray,
    error_m: FloatArray,
    tolerance_m: float,
) -> tuple[float, float, int, float]:
    """Bisect intervals (4, m) of start, end and the margins there: least found and proven, row, offset."""
    found, proven, worst, offset_s, looked_at = np.inf, np.inf, 0, 0.0, 0
    for bisection in range(_MOST_BISECTIONS):
        low, high, at_low, at_high = spans
        lesser = np.minimum(at_low, at_high)
        least = int(np.argmin(lesser))
        if lesser[least] < found:
            found, worst = float(lesser[least]), int(row[least])
            offset_s = float(low[least] if at_low[least] <= at_high[least] else high[least])
        lower = lesser - bend[row] * (high - low) ** 2 / 8.0 - error_m[row]
        undecided = ~(lower >= -tolerance_m)
        looked_at += 2 * int(np.count_nonzero(undecided))
        stop = looked_at > _MOST_INTERVALS or bisection == _MOST_BISECTIONS - 1
        if found < -tolerance_m or stop or not undecided.any():
            proven = np.minimum(proven, np.min(lower))
            break
        proven = np.minimum(proven, np.min(lower, where=~undecided, initial=np.inf))
        row, (low, high, at_low, at_high) = row[undecided], spans[:, undecided]
        middle = (low + high) / 2.0
        at_middle = margin(row, middle)
        row = np.tile(row, 2)
        spans = np.hstack(
            [np.stack([low, middle, at_low, at_middle]), np.stack([middle, high, at_middle, at_high])]
        )
    return found, float(np.minimum(found, proven)), worst, offset_s


def _turned(boxes: FloatArray, frame: Frame | None) -> FloatArray:
    """Boxes (..., 5) of the corridor frame in the map frame, where a frame is given."""
    if frame is None:
        return boxes
    turned = boxes.copy()
    turned[..., :2] = to_map(boxes[..., :2], frame)
    turned[..., 2] += frame.yaw_rad
    return turned
