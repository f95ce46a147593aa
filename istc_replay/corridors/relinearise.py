"""Frames that follow the plan: eq. (9) to (12) written anew about a solution's own motion.

The frames of a unit are those of the guidance at its time. A vehicle that gave way is elsewhere
then, heading elsewhere. Written about its own pivotal points, with the headings that its guidance
has at those places, the rows fit what it really does. The steps stay feasible, since their limits
are widened to the frames' own motion; only the car-boxes, which turn with the headings, may not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.datatypes import FloatArray, read_only

if TYPE_CHECKING:
    from collections.abc import Sequence

    from istc_replay.corridors.problem import CorridorProblem
    from istc_replay.datatypes import Guidance


def frames_about(
    problem: CorridorProblem, z: FloatArray, guidance: Sequence[Guidance]
) -> tuple[Guidance, ...]:
    """Give each guidance the points of a solution, and the headings that it has at those places."""
    moved = []
    for corridor, guide in zip(problem.corridors(z), guidance, strict=True):
        headings = headings_beside(corridor.pivots_m, guide.poses)
        headings[0] = guide.headings_rad[0]
        moved.append(replace(guide, points_m=corridor.pivots_m, headings_rad=read_only(headings)))
    return tuple(moved)


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
