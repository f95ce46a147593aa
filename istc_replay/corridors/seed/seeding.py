"""From a scenario to frames: the guidance that each vehicle's seed motion is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.seed.lattice import CLEAR_M, Lattice
from istc_replay.corridors.seed.paths import SeedPath, candidate_paths
from istc_replay.corridors.seed.repair import Repair
from istc_replay.datatypes import FloatArray, Guidance, read_only

if TYPE_CHECKING:
    from istc_replay.config import CorridorsConfig
    from istc_replay.datatypes import Participant, Scenario

#: Below this speed at the end of its recording a vehicle has a goal there.
_STANDING_MPS = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Seed:
    """One motion a vehicle as guidance, its rounds of repair; `conflicts` are what is left."""

    frames: tuple[Guidance, ...]
    rounds: int
    cost: float
    conflicts: dict[tuple[int, int], list[int]]


def make_lattices(
    scenario: Scenario, guidance: Sequence[Guidance], config: CorridorsConfig
) -> tuple[Lattice, ...]:
    """The lattice of every participant."""
    boxes = [o.boxes_m[0] for o in scenario.obstacles if (o.boxes_m == o.boxes_m[0]).all()]
    standing = np.array(boxes).reshape(-1, 4)

    def lattice(participant: Participant, guide: Guidance) -> Lattice:
        car, gap = participant.dimensions, config.obstacle_gap_m
        paths = candidate_paths(guide, car, standing, scenario.bounds_m, gap)

        def along(some: Sequence[SeedPath], **options: float) -> Lattice:
            return Lattice(
                participant,
                guide,
                some,
                scenario.window.unit_s,
                scenario.obstacles,
                scenario.bounds_m,
                gap,
                participant.priority * config.reference_weight,
                stops=bool(participant.recording.speeds_mps[-1] < _STANDING_MPS),
                **options,
            )

        all_of_them = along(paths)
        clear = [path for path, ok in zip(paths, all_of_them.reachable(), strict=True) if ok]
        return along(clear, overlap_max_m=CLEAR_M) if clear else all_of_them

    return tuple(lattice(p, g) for p, g in zip(scenario.participants, guidance, strict=True))


def plant(
    lattices: Sequence[Lattice], guidance: Sequence[Guidance], config: CorridorsConfig, number: int
) -> Seed | None:
    """Motions that keep clear of each other; None where a vehicle has no way at all.

    Parameters
    ----------
    lattices : sequence of Lattice
        One a vehicle.
    guidance : sequence of Guidance
        One a vehicle.
    config : CorridorsConfig
        Gaps and budgets.
    number : int
        Of the random order.
    """
    repair = Repair(lattices, config.vehicle_gap_m, number)
    repair.run(config.seed_rounds, config.seed_improvements)
    if not repair.motions:
        return None
    frames = []
    for lattice, motion, guide in zip(lattices, repair.motions, guidance, strict=True):
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
            )
        )
    return Seed(tuple(frames), repair.rounds, repair.cost, repair.conflicts())
