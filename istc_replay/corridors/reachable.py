"""Interval bounds of one vehicle's variables: what it can reach from its start."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from istc_replay.corridors.problem import Block
    from istc_replay.corridors.steps import Steps
    from istc_replay.datatypes import FloatArray


def reachable_bounds(
    block: Block,
    steps: Steps,
    tube: FloatArray,
    bounds_m: tuple[float, float, float, float] | None,
    offset: int,
) -> tuple[FloatArray, FloatArray]:
    """Interval bounds of one vehicle's variables: what the start and eq. (12) let it reach."""
    low, high = block.start_m.copy(), block.start_m.copy()
    pivots_low, pivots_high = [low], [high]
    step_low = step_high = None
    cones, changes = _cone_hulls(steps), _change_hulls(steps)
    for k in range(block.units):
        cone_low, cone_high = cones[:, k]
        if step_low is not None and step_high is not None:
            cone_low = np.maximum(cone_low, step_low + changes[0, k])
            cone_high = np.minimum(cone_high, step_high + changes[1, k])
        step_low, step_high = cone_low, cone_high
        low, high = low + step_low, high + step_high
        pivots_low.append(low)
        pivots_high.append(high)
    pivot_low, pivot_high = np.array(pivots_low), np.array(pivots_high)
    if bounds_m is not None:
        x_min, x_max, y_min, y_max = bounds_m
        half = block.half_gamma_m[1:]
        pivot_low[1:] = np.maximum(pivot_low[1:], (x_min, y_min) + half)
        pivot_high[1:] = np.minimum(pivot_high[1:], (x_max, y_max) - half)

    lower = np.empty(6 * block.units)
    upper = np.empty(6 * block.units)
    lower[block.pivot[1:] - offset], upper[block.pivot[1:] - offset] = pivot_low[1:], pivot_high[1:]
    half = block.half_gamma_m
    for side in range(4):
        axis, walls = side // 2, block.cube[:, side] - offset
        if side % 2 == 0:
            lower[walls] = pivot_low[:-1, axis] + tube[:, side]
            reach = pivot_high[:, axis] - half[:, axis]
            upper[walls] = np.minimum(reach[:-1], reach[1:])
        else:
            upper[walls] = pivot_high[:-1, axis] + tube[:, side]
            reach = pivot_low[:, axis] + half[:, axis]
            lower[walls] = np.maximum(reach[:-1], reach[1:])
        if bounds_m is not None:
            (np.maximum if side % 2 == 0 else np.minimum).at(
                lower if side % 2 == 0 else upper, walls, bounds_m[side]
            )
    return lower, upper


def _cone_hulls(steps: Steps) -> FloatArray:
    """Least and largest (2, K, 2) of each step along the axes."""
    along, cone = steps.along, steps.cone[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    sides = along - cone * across, along + cone * across
    corners = np.stack([length[:, None] * side for length in steps.step_m.T for side in sides])
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def _change_hulls(steps: Steps) -> FloatArray:
    """Least and largest (2, K+1, 2) of each second difference along the axes."""
    heading = steps.heading
    across = np.stack([-heading[:, 1], heading[:, 0]], axis=-1)
    lengthwise, sideways = (steps.second_m[:, columns].T[..., None] for columns in ([0, 1], [2, 3]))
    corners = np.stack([s * heading + w * across for s in lengthwise for w in sideways])
    return np.stack([corners.min(axis=0), corners.max(axis=0)])
