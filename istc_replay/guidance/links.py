"""Dubins words between poses, past obstacles, for many pairs at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from istc_replay.datatypes import FloatArray
from istc_replay.guidance.clearance import Clearance
from istc_replay.guidance.curves import arc_poses
from istc_replay.guidance.dubins import WORD_CURVATURES, word_lengths

_CHECK_STEP_M = 0.5
_FIRST_LOOK = np.array([0.1, 0.3, 0.5, 0.7, 0.9, 0.97])


@dataclass(frozen=True, eq=False)
class Links:
    """A word for each of N pairs: `costs_m` (N,) is infinite where none is free.

    `lengths_m` and `curvatures_1pm` (N, 3): its arcs.
    """

    costs_m: FloatArray
    lengths_m: FloatArray
    curvatures_1pm: FloatArray


@dataclass(frozen=True, eq=False)
class Space:
    """Where one car drives: at one turning radius, clear of obstacles."""

    radius_m: float
    clearance: Clearance

    def widened(self, by_m: float) -> Space:
        """The same with more room asked for."""
        return replace(self, clearance=self.clearance.widened(by_m))

    def link(self, starts: FloatArray, goals: FloatArray, limits_m: FloatArray, tries: int) -> Links:
        """Find the shortest free word of each pair.

        Parameters
        ----------
        starts, goals : ndarray
            (N, 3) poses [m, rad].
        limits_m : ndarray
            (N,) words that are not shorter are not looked at [m].
        tries : int
            How many words of a pair are looked at, from the shortest on.
        """
        words = word_lengths(starts, goals, self.radius_m)  # (N, 6, 3)
        totals, bends = words.sum(axis=2), WORD_CURVATURES / self.radius_m
        order = np.argsort(totals, axis=1, kind="stable")
        count = len(starts)
        costs, chosen = np.full(count, np.inf), order[:, 0].copy()
        for rank in range(tries):
            word = order[:, rank]
            length = totals[np.arange(count), word]
            left = np.flatnonzero(np.isinf(costs) & (length < limits_m))
            if left.size:
                # Most that are not free show it at a few poses already.
                few = length[left, None] * _FIRST_LOOK
                glanced = arc_poses(starts[left], words[left, word[left]], bends[word[left]], few)
                left = left[self.clearance.free(glanced).all(axis=1)]
            if not left.size:
                continue
            arcs = words[left, word[left]]
            samples = np.arange(int(length[left].max() / _CHECK_STEP_M) + 2) * _CHECK_STEP_M
            s = np.minimum(samples[None, :], length[left, None])
            poses = arc_poses(starts[left], arcs, bends[word[left]], s)
            free = self.clearance.free(poses).all(axis=1)
            costs[left[free]] = length[left[free]]
            chosen[left[free]] = word[left[free]]
        lengths = np.where(np.isinf(words[np.arange(count), chosen]), 0.0, words[np.arange(count), chosen])
        return Links(costs, lengths, bends[chosen])
