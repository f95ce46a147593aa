"""The printed formulation of eq. (5) to (12), kept for comparison.

Departures, each because the printed row has no solution or no meaning (docs/equations.md):
eq. (9) relaxes the displacement from p(k-1), not absolute coordinates, and both (9) and (12) get
a sideways allowance, without which a vehicle heading along an axis has no width; eq. (11) has
the two missing signs; gamma_s- counts backward.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.blocks import make_block
from istc_replay.corridors.formulation import assemble
from istc_replay.corridors.problem import (
    CONSTANT,
    X_MAX,
    X_MIN,
    Y_MAX,
    Y_MIN,
    Block,
    CorridorProblem,
    Limits,
    Rows,
)
from istc_replay.corridors.rows import apart
from istc_replay.datatypes import FloatArray

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from istc_replay.config import CorridorsConfig
    from istc_replay.datatypes import Guidance, Scenario

#: The "maximal number" M of eq. (5) and (6) [m].
PAPER_BIG_M = 1000.0


def build_paper_problem(
    scenario: Scenario,
    guidance: Sequence[Guidance],
    config: CorridorsConfig,
    limits: Mapping[str, Limits],  # noqa: ARG001 - the paper has none, layer 2 cannot tighten it
    speed_max_mps: float,  # noqa: ARG001 - gamma_s+ is fixed in the paper
) -> CorridorProblem:
    """Write the corridor problem as printed; arguments as of `formulation.build_problem`."""
    blocks, rows, lower, upper = [], [], [], []
    offset = 0
    for participant, guide in zip(scenario.participants, guidance, strict=True):
        block = make_block(participant, guide, np.pi, offset)  # any heading: gamma is the diagonal
        range_m = _driving_range(guide, config, scenario.window.unit_s)
        rows += [_pivot_rows(block), _size_rows(block), _range_rows(block, range_m, config)]
        rows += [_overlap_rows(block), _step_rows(block, guide, config, scenario.window.unit_s)]
        low, high = _bounds(block, config, scenario, offset)
        lower.append(low)
        upper.append(high)
        blocks.append(block)
        offset += len(low)
    return assemble(
        tuple(blocks),
        Rows.join(rows),
        (np.concatenate(lower), np.concatenate(upper)),
        scenario,
        config,
        decide=False,
    )


def _driving_range(guide: Guidance, config: CorridorsConfig, unit_s: float) -> FloatArray:
    """Displacements of eq. (10) from p(k-1), (K, 2, 2): axis, then least and largest."""
    headings = guide.headings_rad[:-1]
    direction = np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    reach = np.stack([-config.paper_backward_m * direction, config.forward_m * direction], axis=-1)
    return np.sort(reach * unit_s, axis=-1)


def _pivot_rows(block: Block) -> Rows:
    """Eq. (1): the scale vector is not negative, so that a cube holds its pivotal point."""
    cube = block.cube[np.minimum(np.arange(1, block.units + 1), block.units - 1)]
    parts = []
    for axis in (0, 1):
        pivot = block.pivot[1:, axis]
        parts.append(apart("eq. (1)", pivot, cube[:, 2 * axis], 0.0, np.inf))
        parts.append(apart("eq. (1)", cube[:, 2 * axis + 1], pivot, 0.0, np.inf))
    return Rows.join(parts)


def _size_rows(block: Block) -> Rows:
    """Eq. (7): each cube has room for the car."""
    return Rows.join(
        apart("eq. (7)", block.cube[:, high], block.cube[:, low], 2.0 * block.half_gamma_m[1, axis], np.inf)
        for axis, (low, high) in enumerate(((X_MIN, X_MAX), (Y_MIN, Y_MAX)))
    )


def _range_rows(block: Block, range_m: FloatArray, config: CorridorsConfig) -> Rows:
    """Eq. (9): cube k lies within alpha times the driving range from p(k-1)."""
    parts = []
    for axis in (0, 1):
        pivot = block.pivot[:-2, axis]
        start = np.where(pivot == CONSTANT, block.start_m[axis], 0.0)
        allowance = config.sideways_m + block.half_gamma_m[1:-1, axis]
        low = config.paper_relaxation * range_m[:-1, axis, 0] - allowance + start
        high = config.paper_relaxation * range_m[:-1, axis, 1] + allowance + start
        for side, bounds in ((2 * axis, (low, np.inf)), (2 * axis + 1, (-np.inf, high))):
            parts.append(apart("eq. (9), (10)", block.cube[1:, side], pivot, *bounds))
    return Rows.join(parts)


def _overlap_rows(block: Block) -> Rows:
    """Eq. (11), with its signs: consecutive cubes overlap by the car."""
    parts = []
    for axis, (low, high) in enumerate(((X_MIN, X_MAX), (Y_MIN, Y_MAX))):
        gamma = 2.0 * block.half_gamma_m[1, axis]
        parts.append(apart("eq. (11)", block.cube[1:, high], block.cube[:-1, low], gamma, np.inf))
        parts.append(apart("eq. (11)", block.cube[:-1, high], block.cube[1:, low], gamma, np.inf))
    return Rows.join(parts)


def _step_rows(block: Block, guide: Guidance, config: CorridorsConfig, unit_s: float) -> Rows:
    """Eq. (12): a pivotal point's step is bounded axis by axis."""
    headings = guide.headings_rad[:-1]
    components = np.abs(np.stack([np.cos(headings), np.sin(headings)], axis=-1))
    reach = config.forward_m * unit_s * components + config.sideways_m
    parts = []
    for axis in (0, 1):
        here, there = block.pivot[:-1, axis], block.pivot[1:, axis]
        start = np.where(here == CONSTANT, block.start_m[axis], 0.0)
        parts.append(apart("eq. (12)", there, here, start - reach[:, axis], start + reach[:, axis]))
    return Rows.join(parts)


def _bounds(
    block: Block, config: CorridorsConfig, scenario: Scenario, offset: int
) -> tuple[FloatArray, FloatArray]:
    """Bounds wide enough to decide nothing, but the start box of eq. (8) and the map's bounds."""
    far = (block.units + 2) * config.paper_relaxation * (config.forward_m + config.sideways_m) + 20.0
    x_min, x_max, y_min, y_max = scenario.bounds_m or (-np.inf, np.inf, -np.inf, np.inf)
    lower, upper = np.empty(6 * block.units), np.empty(6 * block.units)
    for axis, (least, most) in enumerate(((x_min, x_max), (y_min, y_max))):
        low, high = max(block.start_m[axis] - far, least), min(block.start_m[axis] + far, most)
        for index in (block.pivot[1:, axis], block.cube[:, 2 * axis], block.cube[:, 2 * axis + 1]):
            lower[index - offset], upper[index - offset] = low, high
        half = block.half_gamma_m[0, axis]
        first_low, first_high = block.cube[0, 2 * axis] - offset, block.cube[0, 2 * axis + 1] - offset
        upper[first_low] = block.start_m[axis] - half
        lower[first_high] = block.start_m[axis] + half
    return lower, upper
