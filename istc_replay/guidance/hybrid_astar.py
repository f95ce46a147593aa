"""Forward hybrid A* (Dolgov et al. 2010): a first free path, as poses to be joined by Dubins words."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, field

import numpy as np

from istc_replay.datatypes import FloatArray
from istc_replay.geometry import shift_along
from istc_replay.guidance.clearance import Clearance
from istc_replay.guidance.curves import arc_poses
from istc_replay.guidance.dubins import word_lengths
from istc_replay.guidance.grid import DistanceGrid
from istc_replay.guidance.links import Space

_STEP_M = 1.2
_CHECKS = 3  # per step
_CURVATURES = np.array([0.0, 0.5, -0.5, 1.0, -1.0])  # at radius 1
_BATCH = 16
_CELL_M = 0.6
_CELL_RAD = 0.1
#: A path this near the lower bound of what is left is good enough: shortening comes after.
_GOOD_ENOUGH_M = 0.3
#: Nodes expanded after the first path, for a better way round.
_NODES_AFTER = 100
_HASTE = 1.05
_WORDS_TRIED = 1
_WAY_OUT_STEPS = 6


@dataclass(eq=False)
class _Tree:
    """The nodes by index, and the least cost found for each cell of poses."""

    poses: list[FloatArray]
    costs_m: list[float]
    parents: list[int]
    cells: list[tuple[int, int, int]]
    least_m: dict[tuple[int, int, int], float] = field(default_factory=dict)

    def chain(self, node: int) -> FloatArray:
        """Poses (M, 3) from the root to a node."""
        chain = []
        while node >= 0:
            chain.append(self.poses[node])
            node = self.parents[node]
        return np.array(chain[::-1])


@dataclass(frozen=True, eq=False)
class Found:
    """Poses (M, 3) from the start to one from which a free word leads to the goal, if any."""

    poses: FloatArray | None
    nodes: int
    exhausted: bool  # nothing was left to expand


def search(
    start: FloatArray, goal: FloatArray, space: Space, grid: DistanceGrid | None, budget: int, limit_m: float
) -> Found:
    """Search for a free path from start to goal, poses (3,) of the rear axle.

    Nodes are expanded sixteen at a time by steps of 1.2 m at five curvatures, those first whose cost
    and lower bound of what is left (the larger of Dubins' and the grid's) are least.

    Parameters
    ----------
    start, goal : (3,) arrays
        x, y, heading of the rear axle [m, rad].
    space : Space
        Where the car fits, and its turning radius.
    grid : DistanceGrid, optional
        Tells lower bounds of the way to the goal; Dubins' alone otherwise.
    budget : int
        Nodes to expand at most.
    limit_m : float
        Paths of this length [m] or more are of no use.
    """
    tree = _Tree([start], [0.0], [-1], [(0, 0, 0)], {(0, 0, 0): 0.0})
    best, best_node, nodes, stop_at = limit_m, -1, 0, budget
    queue = [(float(_bounds(start[None, :], goal, space, grid)[0]), 0)]
    while queue and nodes < stop_at:
        batch = _next(queue, tree, best - _GOOD_ENOUGH_M)
        if not batch:
            queue = []
            break
        nodes += len(batch)
        costs = _shots(tree, batch, goal, space, best)
        if costs.min() < best:
            best, best_node = float(costs.min()), batch[int(np.argmin(costs))]
            stop_at = min(stop_at, nodes + _NODES_AFTER)
        _expand(tree, batch, goal, space, grid, queue, best, start)
    poses = tree.chain(best_node) if best_node >= 0 else None
    return Found(poses, nodes, not queue)


def is_dead_end(pose: FloatArray, radius_m: float, clearance: Clearance, *, arriving: bool) -> bool:
    """Whether no free motion of some metres leads out of a pose (3,), or into it where arriving."""
    # Into a pose leads what leads out of it backwards: with the heading turned about.
    about = math.pi if arriving else 0.0
    front = pose[None, :] + (0.0, 0.0, about)
    s = np.arange(1, _CHECKS + 1) * (_STEP_M / _CHECKS)
    for _ in range(_WAY_OUT_STEPS):
        roots = np.repeat(front, len(_CURVATURES), axis=0)
        bends = np.tile(_CURVATURES / radius_m, len(front))[:, None]
        poses = arc_poses(roots, np.full((len(roots), 1), _STEP_M), bends, np.tile(s, (len(roots), 1)))
        free = clearance.free(poses - (0.0, 0.0, about)).all(axis=1)
        front = poses[free, -1]
        if not len(front):
            return True
        _, first = np.unique(_cells(front, pose), axis=0, return_index=True)
        front = front[np.sort(first)]
    return False


def _next(queue: list[tuple[float, int]], tree: _Tree, limit: float) -> list[int]:
    """Take the most promising nodes that were not reached more cheaply since."""
    batch: list[int] = []
    while queue and len(batch) < _BATCH and queue[0][0] < _HASTE * limit:
        _, node = heapq.heappop(queue)
        if tree.costs_m[node] <= tree.least_m[tree.cells[node]]:
            batch.append(node)
    return batch


def _shots(tree: _Tree, batch: list[int], goal: FloatArray, space: Space, best: float) -> FloatArray:
    """Costs (B,) of reaching the goal from each node by its shortest word, infinite if that is not free."""
    costs = np.array([tree.costs_m[node] for node in batch])
    poses = np.array([tree.poses[node] for node in batch])
    links = space.link(poses, np.tile(goal, (len(batch), 1)), best - costs, _WORDS_TRIED)
    return np.asarray(costs + links.costs_m)


def _expand(
    tree: _Tree,
    batch: list[int],
    goal: FloatArray,
    space: Space,
    grid: DistanceGrid | None,
    queue: list[tuple[float, int]],
    best: float,
    start: FloatArray,
) -> None:
    """Add the free successors of a batch of nodes that reach their cell more cheaply than before."""
    roots = np.repeat([tree.poses[node] for node in batch], len(_CURVATURES), axis=0)
    bends = np.tile(_CURVATURES / space.radius_m, len(batch))[:, None]
    s = np.tile(np.arange(1, _CHECKS + 1) * (_STEP_M / _CHECKS), (len(roots), 1))
    poses = arc_poses(roots, np.full((len(roots), 1), _STEP_M), bends, s)  # (N, checks, 3)
    parents = np.repeat(batch, len(_CURVATURES))
    costs = np.array([tree.costs_m[node] for node in parents]) + _STEP_M
    keep = np.flatnonzero(space.clearance.free(poses).all(axis=1))
    ends = poses[keep, -1]
    left = _bounds(ends, goal, space, grid)
    for index, cell, rest, pose in zip(keep, _cells(ends, start), left, ends, strict=True):
        cost = float(costs[index])
        if cost + rest < best - _GOOD_ENOUGH_M and cost < tree.least_m.get(cell, math.inf) - 1e-9:
            tree.least_m[cell] = cost
            tree.cells.append(cell)
            tree.poses.append(pose)
            tree.costs_m.append(cost)
            tree.parents.append(int(parents[index]))
            heapq.heappush(queue, (cost + _HASTE * float(rest), len(tree.poses) - 1))


def _bounds(poses: FloatArray, goal: FloatArray, space: Space, grid: DistanceGrid | None) -> FloatArray:
    """Lower bounds (N,) of the length from poses (N, 3) to the goal [m]."""
    bound = word_lengths(poses, goal, space.radius_m).sum(axis=2).min(axis=1)
    if grid is None:
        return np.asarray(bound)
    ahead = space.clearance.car.rear_axle_to_centre_m
    centres = shift_along(poses[:, 0], poses[:, 1], poses[:, 2], ahead)
    # The box centre drives farther than the rear axle where the car turns.
    return np.asarray(np.maximum(bound, grid.at(centres) / math.hypot(1.0, ahead / space.radius_m)))


def _cells(poses: FloatArray, start: FloatArray) -> list[tuple[int, int, int]]:
    """Cells of poses (N, 3) about the start, alike for a scene and its mirror image."""
    c, s = math.cos(start[2]), math.sin(start[2])
    dx, dy = poses[:, 0] - start[0], poses[:, 1] - start[1]
    turned = np.rint((poses[:, 2] - start[2]) / _CELL_RAD) % round(2.0 * math.pi / _CELL_RAD)
    cells = np.stack([np.rint((c * dx + s * dy) / _CELL_M), np.rint((c * dy - s * dx) / _CELL_M), turned], 1)
    return [(a, b, h) for a, b, h in cells.astype(np.int64).tolist()]
