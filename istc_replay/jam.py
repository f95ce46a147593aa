"""Whether vehicles that stand at the end of a window's plan stand in each other's way."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from istc_replay.geometry import box_poses, shift_along
from istc_replay.guidance.path import Path

if TYPE_CHECKING:
    from istc_replay.datatypes import Dimensions, FloatArray, WindowPlan

#: So far ahead a way has to be free of who waits for this one, in steps [m].
_AHEAD_M, _STEP_M = 10.0, 1.0


def jammed(plan: WindowPlan) -> bool:
    """Whether some vehicles end so that each has another of them standing on its way.

    Nobody can go back: such a plan is safe, and leads nowhere.
    """
    ends, ways, sizes = [], [], []
    for participant, trajectory in zip(plan.scenario.participants, plan.trajectories, strict=True):
        size = trajectory.dimensions
        pose = box_poses(trajectory.states[-1], size.rear_axle_to_centre_m)
        way = np.empty((0, 3))
        if participant.goes_on and participant.route is not None:
            path = Path.through(participant.route.poses[:, :2], participant.route.poses[:, 2])
            arc = path.place(pose[:2], float(pose[2])) + np.arange(_STEP_M, _AHEAD_M + _STEP_M, _STEP_M)
            way = path.at(arc[arc <= path.length_m])
        ends.append(pose)
        ways.append(way)
        sizes.append(size)
    waits = np.zeros((len(ends), len(ends)), dtype=bool)
    for row, way in enumerate(ways):
        for other, pose in enumerate(ends):
            if row != other:
                waits[row, other] = _meets(way, sizes[row], pose[None], sizes[other])
    # Who waits for nobody goes, and then who waited for it alone: a jam is what is left.
    left = np.ones(len(ends), dtype=bool)
    while (free := left & ~waits[:, left].any(axis=1)).any():
        left &= ~free
    return bool(left.any())


def _meets(one: FloatArray, own: Dimensions, two: FloatArray, others: Dimensions) -> bool:
    """Whether a box at any of some poses (P, 3) overlaps another at any of its own (Q, 3), both as discs."""
    if not len(one):
        return False
    apart = _discs(one, own)[:, None] - _discs(two, others)[None]
    reach = (own.width_m + others.width_m) / 2.0
    return bool((np.hypot(apart[..., 0], apart[..., 1]) < reach).any())


def _discs(poses: FloatArray, size: Dimensions) -> FloatArray:
    """Centres (3 P, 2) of three discs as wide as the box along each pose."""
    half = max(size.length_m - size.width_m, 0.0) / 2.0
    return np.concatenate([shift_along(poses[:, 0], poses[:, 1], poses[:, 2], d) for d in (-half, 0.0, half)])
