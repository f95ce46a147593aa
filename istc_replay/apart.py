"""How far apart cars are: as recorded, by guidance, from what obstacles sweep, and across a path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from istc_replay.geometry import box_corners, box_poses
from istc_replay.tracks import swept_boxes
from istc_replay.trajectories.repair import recorded_poses

if TYPE_CHECKING:
    from collections.abc import Sequence

    from istc_replay.datatypes import FloatArray, Guidance, Participant, Scenario, Trajectory

#: A path goes straight on for this long before its start and after its end [m].
_BEYOND_M = 1e3


def apart_m(
    first: Participant,
    guide: Guidance,
    second: Participant,
    other: Guidance,
    begin: int,
    end: int,
) -> FloatArray:
    """Distance of two cars' boxes along their axes (M,) [m] from unit `begin` to `end`; negative: overlap.

    Parameters
    ----------
    first, second : Participant
        The cars.
    guide, other : Guidance
        Their motions, in the same order; both sampled at the same instants.
    begin, end : int
        Units of the window, both cars present in all of them.
    """

    def part(participant: Participant, guidance: Guidance) -> FloatArray:
        per_unit = (len(guidance.poses) - 1) // participant.units
        offset = participant.first_unit
        return guidance.poses[(begin - offset) * per_unit : (end - offset) * per_unit + 1]

    poses = part(first, guide), part(second, other)
    sizes = first.dimensions, second.dimensions
    centres = np.hypot(*(poses[0][:, :2] - poses[1][:, :2]).T)
    reach = sum(np.hypot(size.length_m, size.width_m) / 2.0 for size in sizes)
    apart = np.asarray(centres - reach)
    close = np.flatnonzero(apart < 1.0)
    if close.size:
        corners = [
            box_corners(pose[close, 0], pose[close, 1], pose[close, 2], size.length_m, size.width_m)
            for pose, size in zip(poses, sizes, strict=True)
        ]
        apart[close] = separation_m(corners[0], corners[1], [pose[close, 2] for pose in poses])
    return apart


def separation_m(first: FloatArray, second: FloatArray, headings_rad: Sequence[FloatArray]) -> FloatArray:
    """Largest distance (M,) of corners (M, 4, 2) along the axes of either box."""
    best = np.full(len(first), -np.inf)
    for heading in headings_rad:
        for angle in (heading, heading + np.pi / 2):
            axis = np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, None, :]
            a, b = (first * axis).sum(axis=-1), (second * axis).sum(axis=-1)
            gap = np.maximum(a.min(axis=1) - b.max(axis=1), b.min(axis=1) - a.max(axis=1))
            best = np.maximum(best, gap)
    return best


def overlap_text(own: Participant, other: Participant, at_start_m: float) -> str:
    """How a vehicle is recorded within another that it overlaps where both are first there."""
    times = own.recording.times_s
    last = min(times[-1], other.recording.times_s[-1])
    at = times[(times >= max(times[0], other.recording.times_s[0])) & (times <= last)]
    poses = [recorded_poses(participant, at) for participant in (own, other)]
    corners = [
        box_corners(
            pose[:, 0],
            pose[:, 1],
            pose[:, 2],
            participant.dimensions.length_m,
            participant.dimensions.width_m,
        )
        for pose, participant in zip(poses, (own, other), strict=True)
    ]
    apart = separation_m(corners[0], corners[1], [pose[:, 2] for pose in poses])
    worst = int(np.argmin(apart))
    if apart[worst] < 0.0:
        return f"recorded {-apart[worst]:.2f} m within {other.vehicle_id} at {at[worst]:.2f} s"
    return f"{at_start_m:.2f} m within {other.vehicle_id} where drivable motions near both recordings start"


def driven_through(participant: Participant, scenario: Scenario) -> str:
    """What cannot be of a recording: a goal, or else a path, within a standing obstacle; else empty."""
    poses, size = participant.recording.poses, participant.dimensions
    own = box_corners(poses[:, 0], poses[:, 1], poses[:, 2], size.length_m, size.width_m)
    path = ""
    for obstacle in scenario.obstacles:
        if obstacle.outline_m is None:
            continue
        side = obstacle.outline_m[1] - obstacle.outline_m[0]
        heading = np.full(len(poses), np.arctan2(side[1], side[0]))
        outline = np.broadcast_to(obstacle.outline_m, own.shape)
        apart = separation_m(own, outline, [poses[:, 2], heading])
        if apart[-1] < 0.0:
            return f"its goal is within {obstacle.obstacle_id}"
        if apart.min() < 0.0 and not path:
            path = f"its recorded path leads through {obstacle.obstacle_id}"
    return path


def least_clearance_m(scenario: Scenario, guidance: Sequence[Guidance]) -> float:
    """Least distance that guidance keeps from the boxes of obstacles, those that it touches left out."""
    least = np.inf
    for participant, guide in zip(scenario.participants, guidance, strict=True):
        own = recorded_boxes(participant, guide.times_s, guide.poses, scenario)
        for obstacle in scenario.obstacles:
            box = obstacle.boxes_m
            apart = np.maximum(own[:, 0::2] - box[:, 1::2], box[:, 0::2] - own[:, 1::2]).max(axis=1)
            least = min(least, float(np.min(apart, where=apart >= 0.0, initial=np.inf)))
    return least


def recorded_boxes(
    participant: Participant, times_s: FloatArray, poses: FloatArray, scenario: Scenario
) -> FloatArray:
    """Boxes (N, 4) that a participant sweeps on a motion, as of `tracks.swept_boxes`."""
    size = participant.dimensions
    return swept_boxes(times_s, poses, (size.length_m, size.width_m), scenario.window)


def lateral_excursion_m(trajectory: Trajectory, guidance: Guidance) -> float:
    """How far sideways a plan leaves the path of its guidance [m]; before and after it, the path goes on."""
    centres = box_poses(trajectory.states, trajectory.dimensions.rear_axle_to_centre_m)[:, :2]
    poses = guidance.poses
    moved = np.concatenate([[True], np.hypot(*np.diff(poses[:, :2], axis=0).T) > 1e-3])
    poses = poses[moved]
    ends = np.array([[np.cos(h), np.sin(h)] for h in (poses[0, 2], poses[-1, 2])]) * _BEYOND_M
    path = np.vstack([poses[0, :2] - ends[0], poses[:, :2], poses[-1, :2] + ends[1]])
    step = np.diff(path, axis=0)  # (P, 2)
    offset = centres[:, None, :] - path[:-1]
    share = np.clip((offset * step).sum(-1) / (step**2).sum(-1), 0.0, 1.0)
    return float(np.hypot(*np.moveaxis(offset - share[..., None] * step, -1, 0)).min(axis=1).max())
