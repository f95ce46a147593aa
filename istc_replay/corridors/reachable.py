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
    for k in range(block.units):
        cone_low, cone_high = _cone_hull(steps.along[k], steps.step_m[k], float(steps.cone[k]))
        if step_low is not None and step_high is not None:
            change_low, change_high = _second_hull(steps.heading[k], steps.second_m[k])
            cone_low = np.maximum(cone_low, step_low + change_low)
            cone_high = np.minimum(cone_high, step_high + change_high)
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


def _cone_hull(along: FloatArray, step_m: FloatArray, cone: float) -> tuple[FloatArray, FloatArray]:
    across = np.array([-along[1], along[0]])
    corners = np.array([s * (along + mu * across) for s in step_m for mu in (-cone, cone)])
    return corners.min(axis=0), corners.max(axis=0)


def _second_hull(heading: FloatArray, second_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    across = np.array([-heading[1], heading[0]])
    corners = np.array([s * heading + w * across for s in second_m[:2] for w in second_m[2:]])
    return corners.min(axis=0), corners.max(axis=0)
