"""From a scenario to lattices, and from seed motions to frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.seed.lattice import CLEAR_M, DEEPEST_M, Lattice
from istc_replay.corridors.seed.moves import Moves
from istc_replay.corridors.seed.paths import SeedPath, Surroundings, along_others, candidate_paths, detours
from istc_replay.corridors.seed.repair import Repair
from istc_replay.datatypes import FloatArray, Guidance, read_only

if TYPE_CHECKING:
    from istc_replay.config import CorridorsConfig
    from istc_replay.datatypes import Participant, Scenario

#: Who has fewer candidate paths past the obstacles gets detours too.
_FEW_PATHS = 6


def make_lattices(
    scenario: Scenario, guidance: Sequence[Guidance], config: CorridorsConfig
) -> tuple[Lattice, ...]:
    """The lattice of every participant: along its guidance, and along that's other routes."""
    boxes = [o.boxes_m[0] for o in scenario.obstacles if (o.boxes_m == o.boxes_m[0]).all()]
    standing = np.array(boxes).reshape(-1, 4)

    def lattice(participant: Participant, guide: Guidance) -> Lattice:
        gap = config.obstacle_gap_m
        around = Surroundings(participant.dimensions, standing, scenario.bounds_m, gap)
        paths = candidate_paths(guide, around)

        def moves(some: Sequence[SeedPath]) -> Moves:
            unit_s = scenario.window.unit_s
            return Moves(participant, some, unit_s, scenario.obstacles, scenario.bounds_m, gap)

        def reachable(some: Sequence[SeedPath]) -> list[SeedPath]:
            known = moves(some).reachable(CLEAR_M) if some else ()
            return [path for path, ok in zip(some, known, strict=True) if ok]

        clear = reachable(paths)
        clear += reachable(along_others(guide, around))
        if len(standing) and len(clear) < _FEW_PATHS:
            clear += reachable(detours(guide, around))
        return Lattice(
            participant,
            guide,
            moves(clear or paths),
            scenario.window.unit_s,
            scenario.obstacles,
            gap,
            participant.priority * config.reference_weight,
            stops=participant.recording.ends_standing,
            overlap_max_m=CLEAR_M if clear else DEEPEST_M,
        )

    return tuple(lattice(p, g) for p, g in zip(scenario.participants, guidance, strict=True))


def frames_of(repair: Repair, guidance: Sequence[Guidance]) -> tuple[Guidance, ...]:
    """The motions of a repair as guidance, what eq. (9) to (12) are written about.

    Parameters
    ----------
    repair : Repair
        Has a motion for everybody.
    guidance : sequence of Guidance
        One a vehicle.
    """
    frames = []
    for lattice, motion, guide in zip(repair.lattices, repair.motions, guidance, strict=True):
        poses = np.array(lattice.poses(motion))
        poses[0] = *guide.points_m[0], guide.headings_rad[0]
        poses[:, 2] = np.unwrap(poses[:, 2])
        path: FloatArray = lattice.paths[motion.path].poses
        frames.append(
            replace(
                guide,
                points_m=read_only(poses[:, :2]),
                headings_rad=read_only(poses[:, 2]),
                poses=read_only(path),
                slack_rad=read_only(lattice.slack_rad(motion)),
                fastest_mps=read_only(lattice.fastest_mps(motion)),
            )
        )
    return tuple(frames)
