"""Distances to a goal around obstacles on a grid of cells: a lower bound that steers the search."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from istc_replay.datatypes import FloatArray
from istc_replay.guidance.clearance import Clearance

_CELL_M = 0.75
_CELLS_MAX = 20_000
#: Moves of a king and of a knight: lengths on the grid exceed true ones by at most 2.8 %.
_MOVES = [
    (dx, dy)
    for dx, dy in itertools.product(range(-2, 3), repeat=2)
    if math.gcd(dx, dy) == 1 and max(abs(dx), abs(dy)) * min(abs(dx), abs(dy)) <= 2
]
_EXCESS = 1.028


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Lower bounds of the length from each cell to the goal for the box centre.

    `lengths_m` (nx, ny) [m], infinite where the goal cannot be reached from.
    """

    x_min_m: float
    y_min_m: float
    cell_m: float
    lengths_m: FloatArray

    def at(self, points_m: FloatArray) -> FloatArray:
        """Lower bounds (...,) at points (..., 2) [m]."""
        offsets = (points_m - (self.x_min_m, self.y_min_m)) / self.cell_m
        column, row = (
            np.clip(offsets[..., axis].astype(np.int64), 0, self.lengths_m.shape[axis] - 1) for axis in (0, 1)
        )
        return np.asarray(self.lengths_m[column, row])


def distances_to(goal_m: FloatArray, clearance: Clearance) -> DistanceGrid:
    """Measure distances to the goal's box centre (2,) past all obstacles.

    A cell is blocked only if the largest disc within the box, and its margin, would overlap an
    obstacle wherever in the cell it is: what the grid finds out of reach is out of reach.
    """
    bounds, radius = clearance.bounds, clearance.car.width_m / 2.0
    sides = (bounds.x_max_m - bounds.x_min_m, bounds.y_max_m - bounds.y_min_m)
    cell = max(_CELL_M, math.sqrt(sides[0] * sides[1] / _CELLS_MAX), max(sides) / _CELLS_MAX)
    counts = [max(1, math.ceil(side / cell)) for side in sides]
    xs, ys = (
        low + (np.arange(count) + 0.5) * cell
        for low, count in zip((bounds.x_min_m, bounds.y_min_m), counts, strict=True)
    )
    blocked = np.zeros((len(xs), len(ys)), dtype=bool)
    for (x, y, heading, p, q), margin in zip(clearance.obstacles, clearance.margins_m, strict=True):
        reach = radius + margin - cell * math.sqrt(0.5)
        if reach <= 0.0:
            continue
        outer = math.hypot(p, q) + reach
        here = np.ix_(np.abs(xs - x) <= outer, np.abs(ys - y) <= outer)
        dx, dy = (xs - x)[np.abs(xs - x) <= outer][:, None], (ys - y)[np.abs(ys - y) <= outer][None, :]
        along = np.abs(dx * math.cos(heading) + dy * math.sin(heading)) - p
        across = np.abs(dy * math.cos(heading) - dx * math.sin(heading)) - q
        blocked[here] |= np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0)) < reach
    grid = DistanceGrid(bounds.x_min_m, bounds.y_min_m, cell, np.where(blocked, np.inf, 0.0))
    steps = _relaxed(blocked, *(int(v) for v in _cell_of(grid, goal_m)))
    # The goal and the point may each lie half a diagonal from the middle of their cells.
    return DistanceGrid(
        bounds.x_min_m, bounds.y_min_m, cell, np.maximum(steps / _EXCESS - math.sqrt(2.0), 0.0) * cell
    )


def _cell_of(grid: DistanceGrid, point_m: FloatArray) -> tuple[int, int]:
    offsets = (point_m - (grid.x_min_m, grid.y_min_m)) / grid.cell_m
    column, row = (int(np.clip(offsets[a], 0, grid.lengths_m.shape[a] - 1)) for a in (0, 1))
    return column, row


def _relaxed(blocked: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], column: int, row: int) -> FloatArray:
    """Shortest moves (nx, ny), in cells, to one cell: all cells are relaxed until none gets nearer."""
    nx, ny = blocked.shape
    steps = np.full((nx + 4, ny + 4), np.inf)  # a frame of two cells spares the tests at the edges
    steps[column + 2, row + 2] = 0.0
    inner, free = steps[2:-2, 2:-2], ~blocked
    while True:
        before = inner.copy()
        for dx, dy in _MOVES:
            nearer = steps[2 + dx : 2 + dx + nx, 2 + dy : 2 + dy + ny] + math.hypot(dx, dy)
            np.minimum(inner, nearer, out=inner, where=free)
        if np.array_equal(inner, before):
            return before
