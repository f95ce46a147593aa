"""The printed formulation of eq. (5) to (12), kept for comparison.

Departures, each because the printed row has no solution or no meaning (docs/equations.md):
eq. (9) relaxes the displacement from p(k-1), not absolute coordinates, and both (9) and (12) get
a sideways allowance, without which a vehicle heading along an axis has no width; eq. (11) has
the two missing signs; gamma_s- counts backward.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.formulation import assemble, make_block
from istc_replay.corridors.problem import CONSTANT, Block, CorridorProblem, Limits, Row
from istc_replay.datatypes import FloatArray

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

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
        rows += [*_pivot_rows(block), *_size_rows(block), *_range_rows(block, range_m, config)]
        rows += [*_overlap_rows(block), *_step_rows(block, guide, config, scenario.window.unit_s)]
        low, high = _bounds(block, config, scenario, offset)
        lower.append(low)
        upper.append(high)
        blocks.append(block)
        offset += len(low)
    return assemble(
        tuple(blocks),
        tuple(rows),
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


def _pivot_rows(block: Block) -> Iterator[Row]:
    """Eq. (1): the scale vector is not negative, so that a cube holds its pivotal point."""
    for k in range(1, block.units + 1):
        for axis in (0, 1):
            cube = block.cube[min(k, block.units - 1)]
            pivot = int(block.pivot[k, axis])
            yield Row("eq. (1)", (pivot, int(cube[2 * axis])), (1.0, -1.0), 0.0, np.inf)
            yield Row("eq. (1)", (int(cube[2 * axis + 1]), pivot), (1.0, -1.0), 0.0, np.inf)


def _size_rows(block: Block) -> Iterator[Row]:
    """Eq. (7): each cube has room for the car."""
    for k in range(block.units):
        for axis in (0, 1):
            low, high = int(block.cube[k, 2 * axis]), int(block.cube[k, 2 * axis + 1])
            yield Row("eq. (7)", (high, low), (1.0, -1.0), 2.0 * float(block.half_gamma_m[1, axis]), np.inf)


def _range_rows(block: Block, range_m: FloatArray, config: CorridorsConfig) -> Iterator[Row]:
    """Eq. (9): cube k lies within alpha times the driving range from p(k-1)."""
    for k in range(1, block.units):
        for axis in (0, 1):
            pivot = int(block.pivot[k - 1, axis])
            allowance = config.sideways_m + float(block.half_gamma_m[k, axis])
            low, high = config.paper_relaxation * range_m[k - 1, axis] + (-allowance, allowance)
            start = float(block.start_m[axis]) if pivot == CONSTANT else 0.0
            for side, bounds in ((2 * axis, (low + start, np.inf)), (2 * axis + 1, (-np.inf, high + start))):
                wall = int(block.cube[k, side])
                index, weight = ((wall,), (1.0,)) if pivot == CONSTANT else ((wall, pivot), (1.0, -1.0))
                yield Row("eq. (9), (10)", index, weight, float(bounds[0]), float(bounds[1]))


def _overlap_rows(block: Block) -> Iterator[Row]:
    """Eq. (11), with its signs: consecutive cubes overlap by the car."""
    for k in range(1, block.units):
        for axis in (0, 1):
            gamma = 2.0 * float(block.half_gamma_m[1, axis])
            low, high = 2 * axis, 2 * axis + 1
            for later, earlier in ((k, k - 1), (k - 1, k)):
                index = (int(block.cube[later, high]), int(block.cube[earlier, low]))
                yield Row("eq. (11)", index, (1.0, -1.0), gamma, np.inf)


def _step_rows(block: Block, guide: Guidance, config: CorridorsConfig, unit_s: float) -> Iterator[Row]:
    """Eq. (12): a pivotal point's step is bounded axis by axis."""
    headings = guide.headings_rad[:-1]
    components = np.abs(np.stack([np.cos(headings), np.sin(headings)], axis=-1))
    reach = config.forward_m * unit_s * components + config.sideways_m
    for k in range(block.units):
        for axis in (0, 1):
            here, there = int(block.pivot[k, axis]), int(block.pivot[k + 1, axis])
            start = float(block.start_m[axis]) if here == CONSTANT else 0.0
            index, weight = ((there,), (1.0,)) if here == CONSTANT else ((there, here), (1.0, -1.0))
            step = float(reach[k, axis])
            yield Row("eq. (12)", index, weight, start - step, start + step)


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
