"""Our reading of eq. (2) to (12): what a corridor must hold, and why a car can drive it.

The car-box gamma around a pivotal point p(k) lies in cube k-1 and in cube k ("pivot overlap"):
that implies eq. (7) and the sign-corrected eq. (11), and makes the pivotal points a witness of a
drivable motion. Distances along and across are taken in the frame of the guidance's chord from
k to k+1, so that nothing depends on the map's axes or origin but the cubes themselves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.blocks import make_block
from istc_replay.corridors.problem import CONSTANT, Block, CorridorProblem, Limits, Rows
from istc_replay.corridors.reachable import reachable_bounds
from istc_replay.corridors.rows import first_step_rows, lateral_rows, overlap_rows, range_rows, step_rows
from istc_replay.corridors.separations import all_separations
from istc_replay.corridors.steps import make_steps, standing_in_the_end, tube_m
from istc_replay.lateral import centre_reach_m

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from istc_replay.config import CorridorsConfig
    from istc_replay.datatypes import FloatArray, Guidance, Scenario

#: Bounds may decide an option only by more than this, so that rounding never does.
_DECISIVE_M = 1e-9
#: A pivotal step may go sideways by this share even where the car hardly turns.
_LEAST_CONE = 0.03


def default_limits(config: CorridorsConfig) -> Limits:
    """Return the configuration's limits of the pivotal points."""
    return Limits(
        config.cone, config.acceleration_mps2, config.deceleration_mps2, config.lateral_acceleration_mps2
    )


def build_problem(
    scenario: Scenario,
    guidance: Sequence[Guidance],
    config: CorridorsConfig,
    limits: Mapping[str, Limits],
    speed_max_mps: float,
) -> CorridorProblem:
    """Write the corridor problem of a window.

    Parameters
    ----------
    scenario : Scenario
        Participants, obstacles and bounds, corridor frame.
    guidance : sequence of Guidance
        One a participant, in the same order.
    config : CorridorsConfig
        Weights, reaches and gaps.
    limits : mapping
        Limits of the pivotal points by vehicle id.
    speed_max_mps : float
        Largest speed of a plan: widens gamma_s+ where traffic is faster than the paper's.
    """
    unit_s = scenario.window.unit_s
    reach_m = max(config.forward_m, speed_max_mps) * unit_s
    blocks: list[Block] = []
    rows: list[Rows] = []
    lower, upper = [], []
    offset = 0
    for participant, guide in zip(scenario.participants, guidance, strict=True):
        slack = config.heading_slack_rad if guide.slack_rad is None else guide.slack_rad
        block = make_block(participant, guide, slack, offset)
        own = limits[block.vehicle_id]
        steps = make_steps(guide, own, reach_m, unit_s, participant.start.speed_mps)
        if participant.goes_on:
            steps = standing_in_the_end(steps, config.deceleration_mps2 * unit_s**2 / 2.0)
        if participant.lateral is not None:
            reach = centre_reach_m(participant.lateral, participant.dimensions.width_m)
            rows.append(lateral_rows(block, guide, participant.lateral.path_m, reach, own.room_m))
        if guide.slack_rad is not None:
            steps = replace(steps, cone=np.minimum(_narrow_cone(guide.slack_rad, own.tightness), own.cone))
        tube = tube_m(block, steps.along, (config.backward_m, reach_m, config.sideways_m))
        rows += [overlap_rows(block), range_rows(block, tube), step_rows(block, steps)]
        if participant.ahead is not None:
            rows.append(first_step_rows(block, participant, own, unit_s))
        low, high = reachable_bounds(block, steps, tube, scenario.bounds_m, offset)
        lower.append(low)
        upper.append(high)
        blocks.append(block)
        offset += len(low)
    bounds = np.concatenate(lower), np.concatenate(upper)
    return assemble(tuple(blocks), Rows.join(rows), bounds, scenario, config)


def _narrow_cone(slack_rad: FloatArray, share: float) -> FloatArray:
    """The cone (K,) of a car that turns from its guidance by little; a share of it where tightened."""
    wider = np.maximum(slack_rad[:-1], slack_rad[1:])
    return np.asarray(share * np.maximum(np.tan(wider), _LEAST_CONE))


def assemble(
    blocks: tuple[Block, ...],
    rows: Rows,
    bounds: tuple[FloatArray, FloatArray],
    scenario: Scenario,
    config: CorridorsConfig,
    *,
    decide: bool = True,
) -> CorridorProblem:
    """Add objective, witnesses and separations to the rows of all vehicles.

    Parameters
    ----------
    blocks : tuple of Block
        The vehicles' variables, in order.
    rows : Rows
        What always holds.
    bounds : tuple of (n,) arrays
        Least and largest value of each variable [m].
    scenario, config : Scenario, CorridorsConfig
        Obstacles; weights and gaps.
    decide : bool
        Whether to leave out separations and options that the bounds decide.
    """
    lower, upper = bounds
    size = len(lower)
    quadratic, reference, linear = np.zeros(size), np.zeros(size), np.zeros(size)
    witness = np.full((size, 2), CONSTANT, dtype=np.int64)
    witness_offset = np.zeros((size, 2))
    for block in blocks:
        quadratic[block.pivot[1:]] = block.priority * config.reference_weight  # eq. (3)
        reference[block.pivot[1:]] = block.reference_m[1:]
        for side in range(4):
            sign = 1.0 if side % 2 else -1.0
            linear[block.cube[:, side]] = -sign * block.priority * config.area_weight  # eq. (2)
            axis, walls = side // 2, block.cube[:, side]
            witness[walls] = np.stack([block.pivot[:-1, axis], block.pivot[1:, axis]], axis=-1)
            ends = sign * block.half_gamma_m[:, axis]
            witness_offset[walls] = np.stack([ends[:-1], ends[1:]], axis=-1)
            witness_offset[walls[0], 0] += block.start_m[axis]
    separations = all_separations(blocks, scenario.obstacles, config.vehicle_gap_m, config.obstacle_gap_m)
    if decide:
        separations, _ = separations.undecided(lower, upper, _DECISIVE_M)
    names = tuple(obstacle.obstacle_id for obstacle in scenario.obstacles)
    return CorridorProblem(
        blocks,
        names,
        rows,
        separations,
        quadratic,
        reference,
        linear,
        lower,
        upper,
        witness,
        witness_offset,
    )
