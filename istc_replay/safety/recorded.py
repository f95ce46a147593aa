"""What was recorded, at any time asked for: interpolated between samples, never across a gap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray, RecordedGap
from istc_replay.safety.boxes import box_gap
from istc_replay.units import NS_PER_S, median_step, wrap_angle

IntArray = NDArray[np.int64]

#: A pause of more than this many median sample periods is a gap.
GAP_PERIODS = 3
#: Common times are no closer than this, and no more than this many.
_LEAST_SPACING_NS = 1_000_000
_MOST_TIMES = 50_000


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A vehicle's recorded samples, box centre, map frame.

    `times_ns` (S,) increasing; `states` (S, 4): x, y, heading, speed, NaN where unknown;
    `length_m`, `width_m` NaN where unknown; `period_ns` the median sample period.
    """

    times_ns: IntArray
    states: FloatArray
    length_m: float
    width_m: float
    period_ns: float

    @classmethod
    def of(cls, times_ns: IntArray, states: FloatArray, length_m: float, width_m: float) -> Track:
        """A track of the samples, with their median period."""
        return cls(times_ns, states, length_m, width_m, median_step(times_ns))

    def at(self, times_ns: IntArray) -> FloatArray:
        """(n, 4) states at the times, linear between samples; NaN outside and across gaps."""
        known = self.times_ns
        after = np.clip(np.searchsorted(known, times_ns), 1, max(known.size - 1, 1))
        before = np.minimum(after - 1, known.size - 1)
        after = np.minimum(after, known.size - 1)
        span = known[after] - known[before]
        share = ((times_ns - known[before]) / np.maximum(span, 1))[:, None]
        change = self.states[after] - self.states[before]
        change[:, 2] = wrap_angle(change[:, 2])
        # Weights of exactly 0 and 1 give the samples themselves, even beside an unknown one.
        states = np.where(share == 1.0, self.states[after], self.states[before] + share * change)
        states = np.where(share == 0.0, self.states[before], states)
        inside = (times_ns >= known[0]) & (times_ns <= known[-1])
        at_sample = (share[:, 0] == 0.0) | (share[:, 0] == 1.0)
        return np.where(
            (inside & (at_sample | (span <= GAP_PERIODS * self.period_ns)))[:, None], states, np.nan
        )

    def sampling_bound_m(self, time_ns: int, acceleration_mps2: float) -> float:
        """How far off a position between two samples may be: a t_before t_after / 2 [m]."""
        after = int(np.searchsorted(self.times_ns, time_ns))
        if not 0 < after < self.times_ns.size:
            return 0.0
        since, until = time_ns - int(self.times_ns[after - 1]), int(self.times_ns[after]) - time_ns
        return acceleration_mps2 * (since / NS_PER_S) * (until / NS_PER_S) / 2.0

    def fastest_mps(self, start_ns: int, end_ns: int) -> float:
        """The largest recorded |speed| in a span, 0 where none is known."""
        inside = (self.times_ns >= start_ns) & (self.times_ns <= end_ns)
        speeds = np.abs(self.states[inside, 3])
        return float(np.max(speeds, where=np.isfinite(speeds), initial=0.0))


def recorded_tracks(states: pl.DataFrame, *, vehicles_only: bool = True) -> dict[str, Track]:
    """Tracks by name, of a states table of a log or of a result; others than vehicles only if wanted."""
    if "source" in states.columns:
        states = states.filter(pl.col("source") == "recorded")
    if vehicles_only and "role" in states.columns:
        states = states.filter(pl.col("role").is_null() | (pl.col("role") == "vehicle"))
    finite = pl.col("x_m").is_finite() & pl.col("y_m").is_finite() & pl.col("vehicle_id").is_not_null()
    states = states.filter(finite, pl.col("time_ns").is_not_null())
    tracks = {}
    for (vehicle_id,), rows in states.partition_by("vehicle_id", as_dict=True).items():
        times, first = np.unique(rows["time_ns"].to_numpy().astype(np.int64), return_index=True)
        columns = ("x_m", "y_m", "heading_rad", "speed_mps")
        tracks[str(vehicle_id)] = Track.of(
            times_ns=times,
            states=np.column_stack([rows[name].cast(pl.Float64).to_numpy()[first] for name in columns]),
            length_m=_largest(rows["length_m"].to_numpy()[first]),
            width_m=_largest(rows["width_m"].to_numpy()[first]),
        )
    return dict(sorted(tracks.items()))


def least_recorded_gap(states: pl.DataFrame, start_ns: int, end_ns: int) -> RecordedGap | None:
    """Find the least gap of two recorded boxes in a span of time, both ends included.

    All vehicles are taken to common times: the samples' own, thinned to half of the shortest
    sample period. The least gap at these times is told; between two of them the true gap may be
    smaller by the sampling bound a_max h^2 / 8 of either vehicle.

    Parameters
    ----------
    states : polars.DataFrame
        A states table of a log or of a result (there, its recorded rows).
    start_ns, end_ns : int
        The span [ns].

    Returns
    -------
    RecordedGap or None
        None where no two vehicles of known size are there at once.
    """
    tracks = {
        name: track
        for name, track in recorded_tracks(states).items()
        if track.length_m > 0.0 and track.width_m > 0.0
    }
    times = _common_times(list(tracks.values()), start_ns, end_ns)
    if len(tracks) < 2 or times.size == 0:
        return None
    names = list(tracks)
    boxes = np.full((len(names), times.size, 5), np.nan)
    for row, track in enumerate(tracks.values()):
        boxes[row, :, :3] = track.at(times)[:, :3]
        boxes[row, :, 3:] = track.length_m, track.width_m
    best, pair, when = np.inf, (0, 0), 0
    radii = np.hypot(boxes[..., 3], boxes[..., 4]) / 2.0
    for i in range(len(names) - 1):
        distance = np.hypot(*np.moveaxis(boxes[i + 1 :, :, :2] - boxes[i, :, :2], -1, 0))
        others, instants = np.nonzero(distance - radii[i + 1 :] - radii[i] < best)
        gaps = box_gap(boxes[i, instants], boxes[i + 1 + others, instants])
        if gaps.size and np.nanmin(gaps, initial=np.inf) < best:
            least = int(np.nanargmin(gaps))
            best, pair, when = float(gaps[least]), (i, i + 1 + int(others[least])), int(instants[least])
    if not np.isfinite(best):
        return None
    return RecordedGap(best, (names[pair[0]], names[pair[1]]), int(times[when]))


def _common_times(tracks: list[Track], start_ns: int, end_ns: int) -> IntArray:
    """Samples' times in the span, the first of each bin of half the shortest period."""
    periods = [track.period_ns for track in tracks if track.period_ns > 0.0]
    spacing = max(min(periods, default=0.0) / 2.0, _LEAST_SPACING_NS, (end_ns - start_ns) / _MOST_TIMES)
    inside = [track.times_ns[(track.times_ns >= start_ns) & (track.times_ns <= end_ns)] for track in tracks]
    times = np.unique(np.concatenate(inside)) if inside else np.empty(0, dtype=np.int64)
    _, first = np.unique((times - start_ns) // int(spacing), return_index=True)
    return np.asarray(times[first])


def _largest(column: NDArray[Any]) -> float:
    values = column.astype(np.float64)
    values = values[np.isfinite(values)]
    return float(values.max()) if values.size else float("nan")
