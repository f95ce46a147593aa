"""How far a pivotal point may step, eq. (12), and the driving range of a cube about it, eq. (9) and (10)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.datatypes import FloatArray

if TYPE_CHECKING:
    from istc_replay.corridors.problem import Block, Limits
    from istc_replay.datatypes import Guidance

_STANDING_M = 1e-6


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
    fastest = reach_m if guide.fastest_mps is None else np.minimum(reach_m, guide.fastest_mps * unit_s)
    step = np.stack([np.zeros(len(chords)), np.maximum(fastest, lengths)], axis=-1)
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


def standing_in_the_end(steps: Steps, most_m: float) -> Steps:
    """The steps of who has to stand in the end: the last is short enough to be braked on."""
    step_m = np.array(steps.step_m)
    step_m[-1, 1] = max(step_m[-1, 0], min(step_m[-1, 1], most_m))
    return replace(steps, step_m=step_m)


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
