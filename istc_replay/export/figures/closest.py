"""The least gap between any two vehicles over time, as recorded and as planned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray
from istc_replay.export.figures.tracks import Track
from istc_replay.safety.boxes import box_gap

#: A curve has at most this many points.
_POINTS = 1000
#: Distances computed at once.
_PAIRS_AT_ONCE = 1_000_000


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
    gaps, pairs = _closest(poses, sizes)
    if np.isnan(gaps).all():
        return None
    at = int(np.nanargmin(gaps))
    first, second = pairs[at].tolist()
    place = (poses[first, at, :2] + poses[second, at, :2]) / 2.0
    return ClosestPair(
        times_s,
        gaps,
        float(gaps[at]),
        float(times_s[at]),
        (names[first], names[second]),
        (float(place[0]), float(place[1])),
    )


def _closest(poses: FloatArray, sizes: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    """Least gaps (T,) and their pairs (T, 2) among poses (V, T, 3); NaN where no two are present.

    Only pairs that can be the closest are measured.
    """
    i, j = np.triu_indices(len(poses), k=1)
    times = poses.shape[1]
    gaps, pairs = np.full(times, np.nan), np.full((times, 2), -1, dtype=np.intp)
    reach = np.hypot(*sizes.T) / 2.0
    step = max(_PAIRS_AT_ONCE // len(i), 1)
    for start in range(0, times, step):
        block = slice(start, start + step)
        apart = poses[i, block, :2] - poses[j, block, :2]  # (P, B, 2)
        distances = np.hypot(apart[..., 0], apart[..., 1])
        # A gap is at most the distance of the centres and at least that less both half diagonals.
        nearest = np.fmin.reduce(distances, axis=0)
        pair, at = np.nonzero(distances - (reach[i] + reach[j])[:, None] <= nearest)
        boxes = [
            np.hstack([poses[side[pair], start + at], sizes[side[pair]]])  # (n, 5)
            for side in (i, j)
        ]
        measured = np.full(distances.shape, np.inf)
        measured[pair, at] = box_gap(*boxes)
        best = np.argmin(np.where(np.isnan(measured), np.inf, measured), axis=0)
        least = measured[best, np.arange(len(best))]
        gaps[block] = np.where(np.isfinite(least), least, np.nan)
        pairs[block] = np.column_stack([i[best], j[best]])
    return gaps, pairs
