"""Frames that follow the plan: eq. (9) to (12) written anew about a solution's own motion.

The frames of a unit are those of the guidance at its time. A vehicle that gave way is elsewhere
then, heading elsewhere. Written about its own pivotal points, with the headings that its guidance
has at those places, the rows fit what it really does. The steps stay feasible, since their limits
are widened to the frames' own motion; only the car-boxes, which turn with the headings, may not. A plan
that moves far from those headings is no motion of a car, and frames about it would lead further astray.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.datatypes import FloatArray, read_only

if TYPE_CHECKING:
    from collections.abc import Sequence

    from istc_replay.corridors.problem import CorridorProblem
    from istc_replay.datatypes import Guidance

#: Who steps less in a unit creeps, in no direction to speak of.
_CREEPS_M, _ASIDE_RAD = 0.5, math.radians(25.0)


def frames_about(
    problem: CorridorProblem, z: FloatArray, guidance: Sequence[Guidance]
) -> tuple[Guidance, ...]:
    """Give each guidance the points of a solution, and the headings that it has at those places.

    Who would move aside there, by more than 25 degrees, keeps the frames that it has.
    """
    moved = []
    for corridor, guide in zip(problem.corridors(z), guidance, strict=True):
        headings = headings_beside(corridor.pivots_m, guide.poses)
        headings[0] = guide.headings_rad[0]
        if _goes_ahead(corridor.pivots_m, headings):
            guide = replace(guide, points_m=corridor.pivots_m, headings_rad=read_only(headings))
        moved.append(guide)
    return tuple(moved)


def _goes_ahead(points_m: FloatArray, headings_rad: FloatArray) -> bool:
    """Whether steps between points (K+1, 2) lead where headings (K+1,) do, halfway between both ends'."""
    steps = np.diff(points_m, axis=0)
    ahead = np.stack([np.cos(headings_rad), np.sin(headings_rad)], axis=-1)
    ahead = ahead[:-1] + ahead[1:]
    across = ahead[:, 0] * steps[:, 1] - ahead[:, 1] * steps[:, 0]
    aside_rad = np.abs(np.arctan2(across, (ahead * steps).sum(axis=-1)))
    return not np.any(aside_rad[np.hypot(*steps.T) > _CREEPS_M] > _ASIDE_RAD)


def headings_beside(points_m: FloatArray, poses: FloatArray) -> FloatArray:
    """Headings (K+1,) of the path's nearest poses (S, 3), never going back along it."""
    headings = np.empty(len(points_m))
    reached = 0
    for k, point in enumerate(points_m):
        distance = np.hypot(*(poses[reached:, :2] - point).T)
        reached += int(np.argmin(distance))
        headings[k] = poses[reached, 2]
    return headings


def with_references(problem: CorridorProblem, guidance: Sequence[Guidance]) -> CorridorProblem:
    """Measure eq. (3) from the guidance again, whatever the frames follow."""
    reference = np.array(problem.reference)
    blocks = []
    for block, guide in zip(problem.blocks, guidance, strict=True):
        reference[block.pivot[1:]] = guide.points_m[1:]
        blocks.append(replace(block, reference_m=guide.points_m))
    return replace(problem, blocks=tuple(blocks), reference=read_only(reference))
