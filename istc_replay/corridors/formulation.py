"""Our reading of eq. (2) to (12): what a corridor must hold, and why a car can drive it.

The car-box gamma around a pivotal point p(k) lies in cube k-1 and in cube k ("pivot overlap"):
that implies eq. (7) and the sign-corrected eq. (11), and makes the pivotal points a witness of a
drivable motion. Distances along and across are taken in the frame of the guidance's chord from
k to k+1, so that nothing depends on the map's axes or origin but the cubes themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.problem import CONSTANT, Block, CorridorProblem, IntArray, Limits, Rows
from istc_replay.corridors.separations import all_separations
from istc_replay.datatypes import FloatArray, read_only
from istc_replay.geometry import box_corners
from istc_replay.lateral import centre_reach_m

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from istc_replay.config import CorridorsConfig
    from istc_replay.datatypes import Guidance, Participant, Scenario

#: Bounds may decide an option only by more than this, so that rounding never does.
DECISIVE_M = 1e-9
_STANDING_M = 1e-6
#: A pivotal step may go sideways by this share even where the car hardly turns.
_LEAST_CONE = 0.03
#: Layer 1 may use this share of the sideways room, or all but the second [m]: layer 2 needs some too.
_LATERAL_SHARE, _LATERAL_ROOM_M = 0.8, 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """What bounds the pivotal steps of one vehicle.

    `along` (K, 2): unit chords. `step_m` (K, 2): least and largest step along the chord.
    `heading` (K+1, 2): unit headings. `second_m` (K+1, 4): bounds of the second difference at k,
    along (lower, upper) and across (lower, upper) the heading; rows 0 and K unused. `cone` (K,):
    sideways step per forward step.
    """

    along: FloatArray
    step_m: FloatArray
    heading: FloatArray
    second_m: FloatArray
    cone: FloatArray


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
        if participant.lateral is not None:
            reach = centre_reach_m(participant.lateral, participant.dimensions.width_m)
            rows.append(lateral_rows(block, guide, participant.lateral.path_m, reach, own.room_m))
        if guide.slack_rad is not None:
            steps = replace(steps, cone=np.minimum(_narrow_cone(guide.slack_rad, own.tightness), own.cone))
        tube = tube_m(block, steps.along, (config.backward_m, reach_m, config.sideways_m))
        rows += [overlap_rows(block), range_rows(block, tube), step_rows(block, steps)]
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


def make_block(
    participant: Participant, guide: Guidance, heading_slack_rad: float | FloatArray, offset: int
) -> Block:
    """Lay out one vehicle's variables from `offset` on."""
    units = participant.units
    pivot = np.full((units + 1, 2), CONSTANT, dtype=np.int64)
    pivot[1:] = offset + np.arange(2 * units).reshape(units, 2)
    cube = offset + 2 * units + np.arange(4 * units).reshape(units, 4)
    size = participant.dimensions
    start = participant.start
    half = car_box_m(guide.headings_rad, heading_slack_rad, size.length_m, size.width_m) / 2.0
    corners = box_corners(0.0, 0.0, start.heading_rad, size.length_m, size.width_m)
    half[0] = np.ptp(corners, axis=0) / 2.0
    return Block(
        vehicle_id=participant.vehicle_id,
        priority=participant.priority,
        first_unit=participant.first_unit,
        units=units,
        start_m=read_only([start.x_m, start.y_m]),
        reference_m=guide.points_m,
        half_gamma_m=read_only(half),
        pivot=pivot,
        cube=cube,
    )


def car_box_m(
    headings_rad: FloatArray, slack_rad: float | FloatArray, length_m: float, width_m: float
) -> FloatArray:
    """Extents (K+1, 2) of the car-box that holds the car at any heading within the slack, eq. (7)."""
    diagonal = np.arctan2(width_m, length_m)

    def extent(headings: FloatArray, peak: float) -> FloatArray:
        # l|cos| + w|sin| peaks at +-atan(w/l) modulo pi; elsewhere an end of the range is largest.
        ends = np.stack([headings - slack_rad, headings + slack_rad])
        largest = (length_m * np.abs(np.cos(ends)) + width_m * np.abs(np.sin(ends))).max(axis=0)
        for angle in (peak, -peak):
            off = np.abs((headings - angle + np.pi / 2) % np.pi - np.pi / 2)
            largest = np.where(off <= slack_rad, np.hypot(length_m, width_m), largest)
        return np.asarray(largest)

    headings = np.asarray(headings_rad)
    return np.stack([extent(headings, diagonal), extent(headings - np.pi / 2, diagonal)], axis=-1)


def make_steps(
    guide: Guidance, limits: Limits, reach_m: float, unit_s: float, start_speed_mps: float
) -> Steps:
    """Bounds of the pivotal steps, eq. (12), widened one-sidedly to what the guidance itself does."""
    points = guide.points_m
    chords = np.diff(points, axis=0)
    lengths = np.hypot(chords[:, 0], chords[:, 1])
    heading = np.stack([np.cos(guide.headings_rad), np.sin(guide.headings_rad)], axis=-1)
    standing = lengths < _STANDING_M
    along = np.where(standing[:, None], heading[:-1], chords / np.maximum(lengths, _STANDING_M)[:, None])
    step = np.stack([np.zeros(len(chords)), np.maximum(reach_m, lengths)], axis=-1)
    first = start_speed_mps * unit_s
    half_square = unit_s**2 / 2.0
    step[0, 0] = np.clip(min(first - limits.deceleration_mps2 * half_square, lengths[0]), 0.0, step[0, 1])
    step[0, 1] = min(step[0, 1], max(first + limits.acceleration_mps2 * half_square, lengths[0]))

    second = np.zeros((len(points), 4))
    square = unit_s**2
    bend = points[2:] - 2.0 * points[1:-1] + points[:-2]  # (K-1, 2)
    forward = np.einsum("ij,ij->i", bend, heading[1:-1])
    leftward = heading[1:-1, 0] * bend[:, 1] - heading[1:-1, 1] * bend[:, 0]
    second[1:-1, 0] = np.minimum(-limits.deceleration_mps2 * square, forward)
    second[1:-1, 1] = np.maximum(limits.acceleration_mps2 * square, forward)
    second[1:-1, 2] = np.minimum(-limits.lateral_acceleration_mps2 * square, leftward)
    second[1:-1, 3] = np.maximum(limits.lateral_acceleration_mps2 * square, leftward)
    return Steps(along, step, heading, second, np.full(len(chords), limits.cone))


def tube_m(block: Block, along: FloatArray, reach_m: tuple[float, float, float]) -> FloatArray:
    """How far the walls of cube k may lie from p(k), eq. (9) and (10).

    Parameters
    ----------
    block : Block
        The vehicle.
    along : (K, 2) array
        Unit chords.
    reach_m : tuple
        Backward, forward and sideways reach along and across the chord [m].

    Returns
    -------
    (K, 4) array
        Offsets of x_min, x_max, y_min, y_max [m]: the turned rectangle's hull, plus the car-box.
    """
    back, forward, side = reach_m
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    corners = np.stack([s * along + w * across for s in (-back, forward) for w in (-side, side)], axis=1)
    half = np.maximum(block.half_gamma_m[:-1], block.half_gamma_m[1:])
    low = corners.min(axis=1) - half
    high = corners.max(axis=1) + half
    return np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=-1)


def overlap_rows(block: Block) -> Rows:
    """Eq. (7), (8), (11): the car-box around each pivotal point lies in the cubes on both sides."""
    # The start box, eq. (8), bounds cube 0 directly: p(0) has no rows.
    ends = np.stack([np.arange(block.units), np.arange(1, block.units + 1)], axis=-1).ravel()
    cubes = np.repeat(np.arange(block.units), 2)
    ends, cubes = ends[1:], cubes[1:]
    parts = []
    for axis in (0, 1):
        pivot, half = block.pivot[ends, axis], block.half_gamma_m[ends, axis]
        low, high = block.cube[cubes, 2 * axis], block.cube[cubes, 2 * axis + 1]
        for larger, smaller in ((pivot, low), (high, pivot)):
            parts.append(apart("eq. (7), (11)", larger, smaller, half, np.inf))
    return Rows.join(parts)


def range_rows(block: Block, tube: FloatArray) -> Rows:
    """Eq. (9), (10): a cube stays within the driving range of its pivotal point."""
    parts = []
    for side in range(4):
        wall, pivot, reach = block.cube[1:, side], block.pivot[1:-1, side // 2], tube[1:, side]
        bounds = (reach, np.inf) if side % 2 == 0 else (-np.inf, reach)
        parts.append(apart("eq. (9), (10)", wall, pivot, *bounds))
    # Implied with eq. (11): the next car-box lies in the range too. Stated on the pivotal points
    # alone, so that stage A knows it.
    at = np.stack([np.arange(1, block.units + 1), np.arange(block.units)], axis=-1)
    for axis in (0, 1):
        half = block.half_gamma_m[1:, axis]
        weights = np.zeros((block.units, 2, 2))
        weights[:, 0, axis], weights[:, 1, axis] = 1.0, -1.0
        low, high = tube[:, 2 * axis] + half, tube[:, 2 * axis + 1] - half
        parts.append(difference_rows(block, "eq. (9), (10)", at, weights, low, high))
    return Rows.join(parts)


def step_rows(block: Block, steps: Steps) -> Rows:
    """Eq. (12): the pivotal steps stay in a cone about the chord, their change within limits."""
    at = np.stack([np.arange(1, block.units + 1), np.arange(block.units)], axis=-1)
    along, cone = steps.along, steps.cone[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)

    def step(direction: FloatArray, low: FloatArray | float, high: FloatArray | float) -> Rows:
        weights = np.stack([direction, -direction], axis=1)
        return difference_rows(block, "eq. (12)", at, weights, low, high)

    parts = [step(along, *steps.step_m.T)]
    parts += [step(cone * along - sign * across, 0.0, np.inf) for sign in (1.0, -1.0)]
    inner = np.arange(1, block.units)
    at = np.stack([inner + 1, inner, inner - 1], axis=-1)
    heading = steps.heading[inner]
    leftward = np.stack([-heading[:, 1], heading[:, 0]], axis=-1)
    for direction, bounds in ((heading, steps.second_m[inner, :2]), (leftward, steps.second_m[inner, 2:])):
        weights = np.stack([direction, -2.0 * direction, direction], axis=1)
        parts.append(difference_rows(block, "eq. (12)", at, weights, *bounds.T))
    return Rows.join(parts)


def lateral_rows(
    block: Block, guide: Guidance, path_m: FloatArray, reach_m: FloatArray, room_m: float = 0.0
) -> Rows:
    """Keep pivotal points beside the recorded path, across the guidance's heading at each unit.

    Where the path bends, the rows give way by as much as the path itself leaves its tangent: a car
    that is early or late is elsewhere on the path.

    Parameters
    ----------
    block, guide
        The vehicle, and the frames of its units.
    path_m : (P, 2) array
        Its recorded path.
    reach_m : (P, 2) array
        How far its centre may be to the left and right of the path.
    room_m : float
        What more is left to layer 2.
    """
    headings = guide.headings_rad[1:]
    normal = np.stack([-np.sin(headings), np.cos(headings)], axis=-1)  # (K, 2)
    offset = np.einsum("ij,ij->i", normal, guide.points_m[1:])
    path = path_m @ normal.T - offset  # (P, K)
    least_room = np.minimum((1.0 - _LATERAL_SHARE) * reach_m, _LATERAL_ROOM_M)
    reach = np.maximum(reach_m - least_room - room_m, 0.0)[..., None]  # (P, 2, 1)
    low, high = (path - reach[:, 1]).min(axis=0), (path + reach[:, 0]).max(axis=0)
    # What the guidance itself does is allowed.
    low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    return Rows.of("lateral bound", block.pivot[1:], normal, low + offset, high + offset)


def apart(
    equation: str,
    larger: IntArray,
    smaller: IntArray,
    lower: FloatArray | float,
    upper: FloatArray | float,
) -> Rows:
    """Rows lower <= z[larger] - z[smaller] <= upper."""
    index = np.stack([larger, smaller], axis=-1)
    return Rows.of(equation, index, np.broadcast_to([1.0, -1.0], index.shape), lower, upper)


def difference_rows(
    block: Block,
    equation: str,
    at: IntArray,
    weights: FloatArray,
    lower: FloatArray | float,
    upper: FloatArray | float,
) -> Rows:
    """Rows of weights (R, m, 2) times the pivotal points of units `at` (R, m); p(0) is a constant."""
    index = block.pivot[at]  # (R, m, 2)
    fixed = index == CONSTANT
    constant = np.where(fixed, weights * block.start_m, 0.0).sum(axis=(1, 2))
    shape = (len(at), 2 * at.shape[1])
    free = np.where(fixed, 0.0, weights).reshape(shape)
    return Rows.of(equation, index.reshape(shape), free, lower - constant, upper - constant)


def reachable_bounds(
    block: Block,
    steps: Steps,
    tube: FloatArray,
    bounds_m: tuple[float, float, float, float] | None,
    offset: int,
) -> tuple[FloatArray, FloatArray]:
    """Interval bounds of one vehicle's variables: what the start and eq. (12) let it reach."""
    low, high = block.start_m.copy(), block.start_m.copy()
    pivots_low, pivots_high = [low], [high]
    step_low = step_high = None
    for k in range(block.units):
        cone_low, cone_high = _cone_hull(steps.along[k], steps.step_m[k], float(steps.cone[k]))
        if step_low is not None and step_high is not None:
            change_low, change_high = _second_hull(steps.heading[k], steps.second_m[k])
            cone_low = np.maximum(cone_low, step_low + change_low)
            cone_high = np.minimum(cone_high, step_high + change_high)
        step_low, step_high = cone_low, cone_high
        low, high = low + step_low, high + step_high
        pivots_low.append(low)
        pivots_high.append(high)
    pivot_low, pivot_high = np.array(pivots_low), np.array(pivots_high)
    if bounds_m is not None:
        x_min, x_max, y_min, y_max = bounds_m
        half = block.half_gamma_m[1:]
        pivot_low[1:] = np.maximum(pivot_low[1:], (x_min, y_min) + half)
        pivot_high[1:] = np.minimum(pivot_high[1:], (x_max, y_max) - half)

    lower = np.empty(6 * block.units)
    upper = np.empty(6 * block.units)
    lower[block.pivot[1:] - offset], upper[block.pivot[1:] - offset] = pivot_low[1:], pivot_high[1:]
    half = block.half_gamma_m
    for side in range(4):
        axis, walls = side // 2, block.cube[:, side] - offset
        if side % 2 == 0:
            lower[walls] = pivot_low[:-1, axis] + tube[:, side]
            reach = pivot_high[:, axis] - half[:, axis]
            upper[walls] = np.minimum(reach[:-1], reach[1:])
        else:
            upper[walls] = pivot_high[:-1, axis] + tube[:, side]
            reach = pivot_low[:, axis] + half[:, axis]
            lower[walls] = np.maximum(reach[:-1], reach[1:])
        if bounds_m is not None:
            (np.maximum if side % 2 == 0 else np.minimum).at(
                lower if side % 2 == 0 else upper, walls, bounds_m[side]
            )
    return lower, upper


def _cone_hull(along: FloatArray, step_m: FloatArray, cone: float) -> tuple[FloatArray, FloatArray]:
    across = np.array([-along[1], along[0]])
    corners = np.array([s * (along + mu * across) for s in step_m for mu in (-cone, cone)])
    return corners.min(axis=0), corners.max(axis=0)


def _second_hull(heading: FloatArray, second_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    across = np.array([-heading[1], heading[0]])
    corners = np.array([s * heading + w * across for s in second_m[:2] for w in second_m[2:]])
    return corners.min(axis=0), corners.max(axis=0)


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

    With `decide`, separations and options that the bounds decide are left out.
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
        separations, _ = separations.undecided(lower, upper, DECISIVE_M)
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
