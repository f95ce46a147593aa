"""The rows of one vehicle: eq. (7) to (12), and the lateral bound of traffic."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.problem import CONSTANT, Block, IntArray, Rows
from istc_replay.datatypes import FloatArray

if TYPE_CHECKING:
    from istc_replay.corridors.problem import Limits
    from istc_replay.corridors.steps import Steps
    from istc_replay.datatypes import Guidance, Participant

#: Layer 1 may use this share of the sideways room, or all but the second [m]: layer 2 needs some too.
_LATERAL_SHARE, _LATERAL_ROOM_M = 0.8, 0.3
#: A car that begins a time unit steered may end it this share nearer to straight on, or as much farther.
_STEERED_SHARE = 0.5


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


def first_step_rows(block: Block, participant: Participant, limits: Limits, unit_s: float) -> Rows:
    """Keep the first step of who was handed over near where its heading and steering lead it.

    The guidance's chord need not tell of that, where it turns back to the route.
    """
    start, size = participant.start, participant.dimensions
    way = start.speed_mps * unit_s
    turn = way * np.tan(start.steering_rad or 0.0) / size.wheelbase_m
    aside = way * turn / 2.0 + size.rear_axle_to_centre_m * np.sin(turn)
    most = limits.lateral_acceleration_mps2 * unit_s**2 / 2.0 + _STEERED_SHARE * abs(aside)
    normal = np.array([[-np.sin(start.heading_rad), np.cos(start.heading_rad)]])
    offset = float((normal @ block.start_m)[0]) + aside
    return Rows.of("eq. (12)", block.pivot[1:2], normal, offset - most, offset + most)


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
    """Rows lower <= sum of weights times pivotal points <= upper.

    Parameters
    ----------
    block : Block
        The vehicle; its p(0) is a constant.
    equation : str
        Which one the rows are of.
    at : (R, m) array
        Units of the pivotal points.
    weights : (R, m, 2) array
        Of x and y of each.
    lower, upper : (R,) arrays or float
        Bounds [m].
    """
    index = block.pivot[at]  # (R, m, 2)
    fixed = index == CONSTANT
    constant = np.where(fixed, weights * block.start_m, 0.0).sum(axis=(1, 2))
    shape = (len(at), 2 * at.shape[1])
    free = np.where(fixed, 0.0, weights).reshape(shape)
    return Rows.of(equation, index.reshape(shape), free, lower - constant, upper - constant)
