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

from istc_replay.corridors.problem import (
    CONSTANT,
    X_MAX,
    X_MIN,
    Y_MAX,
    Y_MIN,
    Block,
    CorridorProblem,
    Disjunction,
    Limits,
    Option,
    Row,
)
from istc_replay.datatypes import FloatArray, read_only
from istc_replay.geometry import box_corners

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from istc_replay.config import CorridorsConfig
    from istc_replay.datatypes import Guidance, Obstacle, Participant, Scenario

#: Bounds may decide an option only by more than this, so that rounding never does.
_DECISIVE_M = 1e-9
_STANDING_M = 1e-6
#: A pivotal step may go sideways by this share even where the car hardly turns.
_LEAST_CONE = 0.03
#: Layer 1 may use this share of the sideways room: the motion between pivotal points needs some too.
_LATERAL_SHARE = 0.8


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
    rows: list[Row] = []
    lower, upper = [], []
    offset = 0
    for participant, guide in zip(scenario.participants, guidance, strict=True):
        slack = config.heading_slack_rad if guide.slack_rad is None else guide.slack_rad
        block = make_block(participant, guide, slack, offset)
        own = limits[block.vehicle_id]
        steps = make_steps(guide, own, reach_m, unit_s, participant.start.speed_mps)
        if guide.slack_rad is not None:
            rows += lateral_rows(block, guide, config.lateral_m * _LATERAL_SHARE)
            steps = replace(steps, cone=np.minimum(_narrow_cone(guide.slack_rad, own.tightness), own.cone))
        tube = tube_m(block, steps.along, (config.backward_m, reach_m, config.sideways_m))
        rows += [*overlap_rows(block), *range_rows(block, tube), *step_rows(block, steps)]
        low, high = reachable_bounds(block, steps, tube, scenario.bounds_m, offset)
        lower.append(low)
        upper.append(high)
        blocks.append(block)
        offset += len(low)
    bounds = np.concatenate(lower), np.concatenate(upper)
    return assemble(tuple(blocks), tuple(rows), bounds, scenario, config)


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


def overlap_rows(block: Block) -> Iterator[Row]:
    """Eq. (7), (8), (11): the car-box around each pivotal point lies in the cubes on both sides."""
    for k in range(block.units):
        for axis in (0, 1):
            low, high = int(block.cube[k, 2 * axis]), int(block.cube[k, 2 * axis + 1])
            for end in (k, k + 1):
                half = float(block.half_gamma_m[end, axis])
                pivot = int(block.pivot[end, axis])
                if pivot != CONSTANT:  # the start box, eq. (8), bounds cube 0 directly
                    yield Row("eq. (7), (11)", (pivot, low), (1.0, -1.0), half, np.inf)
                    yield Row("eq. (7), (11)", (high, pivot), (1.0, -1.0), half, np.inf)


def range_rows(block: Block, tube: FloatArray) -> Iterator[Row]:
    """Eq. (9), (10): a cube stays within the driving range of its pivotal point."""
    for k in range(1, block.units):
        for side in range(4):
            wall, pivot = int(block.cube[k, side]), int(block.pivot[k, side // 2])
            bounds = (float(tube[k, side]), np.inf) if side % 2 == 0 else (-np.inf, float(tube[k, side]))
            yield Row("eq. (9), (10)", (wall, pivot), (1.0, -1.0), *bounds)
    # Implied with eq. (11): the next car-box lies in the range too. Stated on the pivotal points
    # alone, so that stage A knows it.
    for k in range(block.units):
        for axis in (0, 1):
            half = float(block.half_gamma_m[k + 1, axis])
            low, high = float(tube[k, 2 * axis]) + half, float(tube[k, 2 * axis + 1]) - half
            x, y = (1.0, 0.0) if axis == 0 else (0.0, 1.0)
            weights = {k + 1: (x, y), k: (-x, -y)}
            yield _difference_row(block, "eq. (9), (10)", weights, low, high)


def step_rows(block: Block, steps: Steps) -> Iterator[Row]:
    """Eq. (12): the pivotal steps stay in a cone about the chord, their change within limits."""
    for k in range(block.units):
        (cx, cy), mu = steps.along[k], float(steps.cone[k])
        low, high = (float(value) for value in steps.step_m[k])
        yield _difference_row(block, "eq. (12)", {k + 1: (cx, cy), k: (-cx, -cy)}, low, high)
        for sign in (1.0, -1.0):
            wx, wy = mu * cx - sign * -cy, mu * cy - sign * cx
            yield _difference_row(block, "eq. (12)", {k + 1: (wx, wy), k: (-wx, -wy)}, 0.0, np.inf)
    for k in range(1, block.units):
        hx, hy = steps.heading[k]
        for (wx, wy), (low, high) in zip(((hx, hy), (-hy, hx)), steps.second_m[k].reshape(2, 2), strict=True):
            weights = {k + 1: (wx, wy), k: (-2.0 * wx, -2.0 * wy), k - 1: (wx, wy)}
            yield _difference_row(block, "eq. (12)", weights, float(low), float(high))


def lateral_rows(block: Block, guide: Guidance, lateral_m: float) -> Iterator[Row]:
    """Keep pivotal points beside the path of the guidance, across its heading at each unit.

    Where the path bends, the rows give way by as much as the path itself leaves its tangent: a car
    that is early or late is elsewhere on the path.
    """
    for k in range(1, block.units + 1):
        heading = float(guide.headings_rad[k])
        nx, ny = -float(np.sin(heading)), float(np.cos(heading))
        x, y = (float(value) for value in guide.points_m[k])
        path = (guide.poses[:, 0] - x) * nx + (guide.poses[:, 1] - y) * ny
        low, high = min(float(path.min()), 0.0) - lateral_m, max(float(path.max()), 0.0) + lateral_m
        offset = x * nx + y * ny
        index = (int(block.pivot[k, 0]), int(block.pivot[k, 1]))
        yield Row("lateral bound", index, (nx, ny), low + offset, high + offset)


def _difference_row(
    block: Block, equation: str, weights: dict[int, tuple[float, float]], lower: float, upper: float
) -> Row:
    index, weight, constant = [], [], 0.0
    for k, pair in weights.items():
        for axis, value in enumerate(pair):
            if value == 0.0:
                continue
            if k == 0:
                constant += value * float(block.start_m[axis])
            else:
                index.append(int(block.pivot[k, axis]))
                weight.append(float(value))
    return Row(equation, tuple(index), tuple(weight), lower - constant, upper - constant)


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
    rows: tuple[Row, ...],
    bounds: tuple[FloatArray, FloatArray],
    scenario: Scenario,
    config: CorridorsConfig,
    *,
    decide: bool = True,
) -> CorridorProblem:
    """Add objective, witnesses and disjunctions to the rows of all vehicles.

    With `decide`, disjunctions and options that the bounds decide are left out.
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
    disjunctions: tuple[Disjunction, ...] = (
        *_vehicle_disjunctions(blocks, config.vehicle_gap_m),
        *_obstacle_disjunctions(blocks, scenario.obstacles, config.obstacle_gap_m),
    )
    if decide:
        disjunctions = tuple(_undecided(disjunctions, lower, upper))
    return CorridorProblem(
        blocks, rows, disjunctions, quadratic, reference, linear, lower, upper, witness, witness_offset
    )


def _vehicle_disjunctions(blocks: tuple[Block, ...], gap_m: float) -> Iterator[Disjunction]:
    """Eq. (5): in each common unit one of the four separations of two cubes."""
    for i, first in enumerate(blocks):
        for second in blocks[i + 1 :]:
            for unit in range(max(first.first_unit, second.first_unit), min(first.end_unit, second.end_unit)):
                a, b = first.cube[unit - first.first_unit], second.cube[unit - second.first_unit]
                options = tuple(
                    Option(int(larger[low]), int(smaller[high]), gap_m)
                    for low, high in ((X_MIN, X_MAX), (Y_MIN, Y_MAX))
                    for larger, smaller in ((a, b), (b, a))
                )
                yield Disjunction("eq. (5)", unit, first.vehicle_id, second.vehicle_id, options)


def _obstacle_disjunctions(
    blocks: tuple[Block, ...],
    obstacles: tuple[Obstacle, ...],
    gap_m: float,
) -> Iterator[Disjunction]:
    """Eq. (6): in each unit one of the four separations of a cube and an obstacle's box."""
    for block in blocks:
        for obstacle in obstacles:
            for unit in range(block.first_unit, block.end_unit):
                box = obstacle.boxes_m[unit]
                if np.isnan(box).any():
                    continue
                cube = block.cube[unit - block.first_unit]
                options = []
                for low, high in ((X_MIN, X_MAX), (Y_MIN, Y_MAX)):
                    options.append(Option(int(cube[low]), CONSTANT, float(box[high]) + gap_m))
                    options.append(Option(CONSTANT, int(cube[high]), gap_m - float(box[low])))
                yield Disjunction("eq. (6)", unit, block.vehicle_id, obstacle.obstacle_id, tuple(options))


def _undecided(
    disjunctions: tuple[Disjunction, ...], lower: FloatArray, upper: FloatArray
) -> Iterator[Disjunction]:
    """Leave out what the bounds decide: impossible options, and disjunctions that always hold."""
    least, most = np.append(lower, 0.0), np.append(upper, 0.0)
    for disjunction in disjunctions:
        options = disjunction.options
        if max(least[o.larger] - most[o.smaller] - o.gap for o in options) >= 0.0:
            continue
        possible = tuple(o for o in options if most[o.larger] - least[o.smaller] - o.gap >= -_DECISIVE_M)
        yield replace(disjunction, options=possible)
