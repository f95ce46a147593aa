"""Eq. (5) and (6): the pairs of boxes that must keep apart, unit by unit."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from istc_replay.corridors.problem import CONSTANT, X_MAX, X_MIN, Y_MAX, Y_MIN, Block, Separations

if TYPE_CHECKING:
    from collections.abc import Sequence

    from istc_replay.datatypes import Obstacle

#: The columns of `Separations`, in its order.
_Columns = tuple[NDArray[Any], ...]


def all_separations(
    blocks: Sequence[Block], obstacles: Sequence[Obstacle], vehicle_gap_m: float, obstacle_gap_m: float
) -> Separations:
    """All pairs of cubes and of a cube and an obstacle's box that share a unit, with all four options."""
    parts = [
        _vehicles(i, j, blocks, vehicle_gap_m)
        for i, j in combinations(range(len(blocks)), 2)
        if max(blocks[i].first_unit, blocks[j].first_unit) < min(blocks[i].end_unit, blocks[j].end_unit)
    ]
    parts += [
        _obstacle(i, m, block, obstacle, obstacle_gap_m)
        for i, block in enumerate(blocks)
        for m, obstacle in enumerate(obstacles)
    ]
    if not parts:
        empty, wide = np.zeros(0, dtype=np.int64), np.zeros((0, 4), dtype=np.int64)
        return Separations(empty, empty, empty, empty.astype(bool), wide, wide, wide.astype(float))
    columns = zip(*parts, strict=True)
    return Separations(*(np.concatenate(column) for column in columns))


def _vehicles(i: int, j: int, blocks: Sequence[Block], gap_m: float) -> _Columns:
    """Eq. (5): in each common unit one of the four separations of two cubes."""
    one, other = blocks[i], blocks[j]
    unit = np.arange(max(one.first_unit, other.first_unit), min(one.end_unit, other.end_unit))
    a, b = one.cube[unit - one.first_unit], other.cube[unit - other.first_unit]
    larger = np.stack([a[:, X_MIN], b[:, X_MIN], a[:, Y_MIN], b[:, Y_MIN]], axis=-1)
    smaller = np.stack([b[:, X_MAX], a[:, X_MAX], b[:, Y_MAX], a[:, Y_MAX]], axis=-1)
    first, second = np.full_like(unit, i), np.full_like(unit, j)
    return unit, first, second, np.zeros(len(unit), dtype=bool), larger, smaller, np.full(a.shape, gap_m)


def _obstacle(i: int, m: int, block: Block, obstacle: Obstacle, gap_m: float) -> _Columns:
    """Eq. (6): in each unit one of the four separations of a cube and an obstacle's box."""
    unit = np.arange(block.first_unit, block.end_unit)
    unit = unit[~np.isnan(obstacle.boxes_m[unit]).any(axis=1)]
    box, cube = obstacle.boxes_m[unit], block.cube[unit - block.first_unit]
    none = np.full(len(unit), CONSTANT)
    larger = np.stack([cube[:, X_MIN], none, cube[:, Y_MIN], none], axis=-1)
    smaller = np.stack([none, cube[:, X_MAX], none, cube[:, Y_MAX]], axis=-1)
    gap = gap_m + box[:, [X_MAX, X_MIN, Y_MAX, Y_MIN]] * [1.0, -1.0, 1.0, -1.0]
    return (
        unit,
        np.full_like(unit, i),
        np.full_like(unit, m),
        np.ones(len(unit), dtype=bool),
        larger,
        smaller,
        gap,
    )
