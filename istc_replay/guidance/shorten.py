"""Shortening a found path to a few Dubins words."""

from __future__ import annotations

import numpy as np

from istc_replay.datatypes import FloatArray
from istc_replay.guidance.links import Space

_POSES_TRIED = 12
#: Of two chains alike, the one with fewer poses: each of them can then be moved farther.
_POSE_COST_M = 5e-3
_NO_ARC_M = 1e-6


def shortest_chain(poses: FloatArray, goal: FloatArray, space: Space) -> FloatArray | None:
    """Choose poses (V, 3), start and goal included, whose joining words are free and shortest.

    Parameters
    ----------
    poses : ndarray
        (M, 3) the poses of a free path, its start first.
    goal : ndarray
        (3,) where a free word leads from the last of them.
    """
    for count in dict.fromkeys((min(_POSES_TRIED, len(poses)), len(poses))):
        some = poses[np.unique(np.linspace(0, len(poses) - 1, count).round().astype(int))]
        chain = _cheapest(np.vstack([some, goal]), space)
        if chain is not None:
            return chain
    return None


def _cheapest(poses: FloatArray, space: Space) -> FloatArray | None:
    """Dynamic programme over the poses in order: the cheapest chain from the first to the last."""
    count = len(poses)
    before, after = np.triu_indices(count, 1)
    links = space.link(poses[before], poses[after], np.full(len(before), np.inf), 3)
    table = np.full((count, count), np.inf)
    table[before, after] = links.costs_m + _POSE_COST_M
    cost, came = np.full(count, np.inf), np.zeros(count, dtype=int)
    cost[0] = 0.0
    for node in range(1, count):
        through = cost[:node] + table[:node, node]
        came[node] = int(np.argmin(through))
        cost[node] = through[came[node]]
    if np.isinf(cost[-1]):
        return None
    chain = [count - 1]
    while chain[-1]:
        chain.append(int(came[chain[-1]]))
    return poses[chain[::-1]]


def arcs_of(chain: FloatArray, space: Space) -> tuple[FloatArray, FloatArray]:
    """Lengths and curvatures (A,) of the arcs along a chain [m, 1/m]."""
    links = space.link(chain[:-1], chain[1:], np.full(len(chain) - 1, np.inf), 6)
    lengths, bends = links.lengths_m.ravel(), links.curvatures_1pm.ravel()
    kept = lengths > _NO_ARC_M
    lengths, bends = lengths[kept], bends[kept]
    first = np.flatnonzero(np.concatenate([[True], np.diff(bends) != 0.0]))
    return np.add.reduceat(lengths, first), bends[first]
