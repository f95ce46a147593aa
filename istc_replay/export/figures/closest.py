"""The least gap between any two vehicles over time, as recorded and as planned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from istc_replay.datatypes import FloatArray
from istc_replay.export.figures.tracks import Track
from istc_replay.safety.boxes import box_gap

#: A curve has at most this many points.
_POINTS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class ClosestPair:
    """Per instant the least gap of all pairs of boxes, NaN where no two vehicles are present.

    `times_s`, `gaps_m` (T,); `least_m` is their least, at `time_s`, of the two vehicles `pair`,
    whose midpoint is `place_m`.
    """

    times_s: FloatArray
    gaps_m: FloatArray
    least_m: float
    time_s: float
    pair: tuple[str, str]
    place_m: tuple[float, float]


def closest_pair(tracks: dict[str, Track], step_s: float | None = None) -> ClosestPair | None:
    """Follow the closest pair of boxes; None where no two vehicles are ever there at once.

    At the instants of all samples, as the audit does with recordings, or every `step_s`.
    """
    if len(tracks) < 2:
        return None
    names = list(tracks)
    times_s = np.unique(np.concatenate([track.times_s for track in tracks.values()]))
    if step_s is not None:
        times_s = np.arange(times_s[0], times_s[-1] + 0.5 * step_s, step_s)
    times_s = times_s[:: len(times_s) // _POINTS + 1]
    poses = np.stack([tracks[name].at(times_s) for name in names])  # (V, T, 3)
    sizes = np.array([(tracks[name].length_m, tracks[name].width_m) for name in names])
    rows = [_closest(poses[:, step], sizes) for step in range(len(times_s))]
    gaps = np.array([gap for gap, _, _ in rows])
    if np.isnan(gaps).all():
        return None
    at = int(np.nanargmin(gaps))
    _, first, second = rows[at]
    place = (poses[first, at, :2] + poses[second, at, :2]) / 2.0
    return ClosestPair(
        times_s,
        gaps,
        float(gaps[at]),
        float(times_s[at]),
        (names[first], names[second]),
        (float(place[0]), float(place[1])),
    )


def _closest(poses: FloatArray, sizes: FloatArray) -> tuple[float, int, int]:
    """Least gap and its pair among poses (V, 3); only pairs that can be the closest are measured."""
    present = np.flatnonzero(np.isfinite(poses).all(axis=1))
    if len(present) < 2:
        return float("nan"), -1, -1
    i, j = np.triu_indices(len(present), k=1)
    first, second = present[i], present[j]
    distance = np.hypot(*(poses[first, :2] - poses[second, :2]).T)
    reach = np.hypot(*sizes.T) / 2.0
    # A gap is at most the distance of the centres and at least that less both half diagonals.
    near = distance - reach[first] - reach[second] <= distance.min()
    first, second = first[near], second[near]
    boxes = np.hstack([poses, sizes])
    gaps = box_gap(boxes[first], boxes[second])
    best = int(np.argmin(gaps))
    return float(gaps[best]), int(first[best]), int(second[best])
