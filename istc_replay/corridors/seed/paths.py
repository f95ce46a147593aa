"""Candidate paths of one vehicle: its guidance's, pulled clear of obstacles, with bumps to either side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.seed.band import drawn_clear
from istc_replay.geometry import shift_along

if TYPE_CHECKING:
    from collections.abc import Sequence

    from istc_replay.datatypes import Dimensions, FloatArray, Guidance

#: Places along a path are about this far apart.
LEVEL_M = 0.5
_FINE_M = 0.25
#: How far bumps go to the left, and over which share of the path.
_BUMPS_M = (1.5, -1.5, 3.0, -3.0, 4.5, -4.5)
_DETOURS_M = (6.0, -6.0, 9.0, -9.0)
_SPANS = ((0.0, 0.5), (0.25, 0.75), (0.5, 1.0), (0.0, 1.0))
#: Room that paths pulled clear keep between the car-box and an obstacle's box, beyond the gap.
_ROOMS_M = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0)
_BUMPED_ROOMS_M = (0.5, 2.0)
_DETOUR_ROOMS_M = (0.0, 0.5)
_CURVATURE_MAX_1PM = 0.27
_LATERAL_MPS2 = 3.0
_STEERING_RATE_RADPS = 0.7
_SAMPLE_M = 0.5
#: Who drives less has no other way.
_STAYS_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class SeedPath:
    """A path of box centres by even arc lengths, `step_m` apart.

    `poses` (S, 3), `curvatures_1pm` (S,), `speeds_mps` (S,): the largest speed at each place, by
    sideways acceleration and steering rate.
    """

    poses: FloatArray
    curvatures_1pm: FloatArray
    speeds_mps: FloatArray
    step_m: float

    @property
    def length_m(self) -> float:
        """Length of the path."""
        return self.step_m * (len(self.poses) - 1)


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """A car, and what its paths keep clear of, corridor frame.

    `boxes_m` (O, 4): x_min, x_max, y_min, y_max of what stands, kept clear of by `gap_m`; `bounds_m` is the
    map, in the same order.
    """

    car: Dimensions
    boxes_m: FloatArray
    bounds_m: tuple[float, float, float, float] | None
    gap_m: float

    def clear(self, poses: FloatArray, room_m: float) -> FloatArray:
        """A path (S, 3) of the rear axle, drawn clear with so much room beyond the gap."""
        return drawn_clear(poses, self.car, self.boxes_m, self.bounds_m, self.gap_m + room_m)


def candidate_paths(guide: Guidance, around: Surroundings) -> list[SeedPath]:
    """Paths from a guidance's start to its end, its own first.

    Parameters
    ----------
    guide : Guidance
        Its poses are the path.
    around : Surroundings
        The car, and what it keeps clear of.
    """
    own = _axle_path(guide, around.car)
    straight = _seed_path(own, around.car, guide.speed_mps, sharp=True)
    if straight is not None and straight.length_m < _STAYS_M:
        return [straight]
    drawn: list[FloatArray] = []
    bumped = _bumped(own)
    for room in _ROOMS_M if len(around.boxes_m) else ():
        drawn.append(around.clear(own, room))
        bumped += _bumped(drawn[-1]) if room in _BUMPED_ROOMS_M else []
    others = _seed_paths(drawn + bumped, guide, around)
    return others if straight is None else [straight, *others]


def detours(guide: Guidance, around: Surroundings) -> list[SeedPath]:
    """More paths of the same kind: bumps of the guidance's, drawn clear on the side where they are.

    They lead through other openings too. Parameters are those of `candidate_paths`.
    """
    bumped = _bumped(_axle_path(guide, around.car), (*_BUMPS_M, *_DETOURS_M))
    return _seed_paths(
        [around.clear(poses, room) for poses in bumped for room in _DETOUR_ROOMS_M], guide, around
    )


def along_others(guide: Guidance, around: Surroundings) -> list[SeedPath]:
    """More paths of the same kind: along the other routes of a guidance, as they are and drawn clear.

    Parameters are those of `candidate_paths`.
    """
    found = []
    for route in guide.others:
        found += [route, *(around.clear(route, room) for room in _DETOUR_ROOMS_M)]
    return _seed_paths(found, guide, around)


def _seed_paths(found: Sequence[FloatArray], guide: Guidance, around: Surroundings) -> list[SeedPath]:
    """Those of the paths (S, 3) of the rear axle that bend no more than a car can."""
    cut = [_seed_path(poses, around.car, guide.speed_mps) for poses in found]
    return [path for path in cut if path is not None]


def _axle_path(guide: Guidance, car: Dimensions) -> FloatArray:
    """The path (S, 3) of the rear axle by even arc lengths."""
    x, y, turned = guide.poses.T
    axle = shift_along(x, y, turned, -car.rear_axle_to_centre_m)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(axle, axis=0).T))])
    s = np.linspace(0.0, arc[-1], max(4, int(np.ceil(arc[-1] / _FINE_M))) + 1)
    return np.column_stack([np.interp(s, arc, row) for row in (*axle.T, np.unwrap(turned))])


def _bumped(poses: FloatArray, bumps_m: Sequence[float] = _BUMPS_M) -> list[FloatArray]:
    """The path (S, 3) moved aside by a smooth bump over a part of it."""
    share = np.linspace(0.0, 1.0, len(poses))
    normal = np.stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])], axis=-1)
    low, high = np.array(_SPANS).T[..., None, None]  # (spans, 1, 1)
    x = np.clip((share - low) / (high - low), 0.0, 1.0)
    shape = 64.0 * (x * (1.0 - x)) ** 3  # curvature is continuous at its ends
    aside = np.array(bumps_m)[:, None] * shape  # (spans, bumps, S)
    points = poses[:, :2] + aside.reshape(-1, len(poses), 1) * normal
    return list(with_headings(points, poses))


def with_headings(points_m: FloatArray, like: FloatArray) -> FloatArray:
    """Poses (..., S, 3) along points (..., S, 2), the headings at both ends those of `like` (S, 3)."""
    chords = np.gradient(points_m, axis=-2)
    headings = np.unwrap(np.arctan2(chords[..., 1], chords[..., 0]))
    for end in (0, -1):
        headings[..., end] += np.angle(np.exp(1j * (like[end, 2] - headings[..., end])))
    return np.concatenate([points_m, headings[..., None]], axis=-1)


def _seed_path(
    poses: FloatArray, car: Dimensions, cruise_mps: float, *, sharp: bool = False
) -> SeedPath | None:
    """Cut a path into even places; None where it bends too much, unless it may be `sharp`."""
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    fine = np.arange(0.0, max(arc[-1], 2.0 * _SAMPLE_M), _SAMPLE_M)
    bend = np.gradient(np.interp(fine, arc, poses[:, 2]), _SAMPLE_M)
    if np.abs(bend).max() > _CURVATURE_MAX_1PM and not sharp:
        return None
    turning = car.wheelbase_m * np.abs(np.gradient(bend, _SAMPLE_M))
    by_side = np.sqrt(_LATERAL_MPS2 / np.maximum(np.abs(bend), 1e-3))
    by_rate = _STEERING_RATE_RADPS * (1.0 + (car.wheelbase_m * bend) ** 2) / np.maximum(turning, 1e-3)
    # The guidance's own speed is taken as drivable where only the sideways acceleration objects.
    speeds = np.minimum(np.maximum(by_side, cruise_mps), np.maximum(by_rate, cruise_mps if sharp else 0.0))
    s = np.linspace(0.0, arc[-1], max(2, round(arc[-1] / LEVEL_M)) + 1)
    x, y, heading = (np.interp(s, arc, poses[:, axis]) for axis in range(3))
    centres = shift_along(x, y, heading, car.rear_axle_to_centre_m)
    return SeedPath(
        np.column_stack([centres, heading]), np.interp(s, fine, bend), np.interp(s, fine, speeds), float(s[1])
    )
