"""Tracks of the Rerun view: one vehicle's states from one source, cut at their gaps."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields, replace

import numpy as np
import polars as pl

from istc_replay.config import Config
from istc_replay.datatypes import FloatArray
from istc_replay.export.rerun.chunks import FOREVER_NS, IntArray
from istc_replay.units import seconds_to_ns

#: A recording is interrupted where states are this many sampling periods apart, or this long.
_GAP_PERIODS = 4.0
_LONGEST_GAP_NS = 3_000_000_000
_TRACK_COLUMNS = (
    "x_m",
    "y_m",
    "heading_rad",
    "speed_mps",
    "acceleration_mps2",
    "steering_rad",
    "jerk_mps3",
    "length_m",
    "width_m",
)


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One vehicle's states from one source, in the view's local frame.

    `times_ns` (S,); `ends_ns` (S,) until when each state is shown; `poses` (S, 3) x, y, unwrapped
    heading; `sizes_m` (S, 2) length, width; the others (S,), NaN where unknown.
    """

    vehicle_id: str
    times_ns: IntArray
    ends_ns: IntArray
    poses: FloatArray
    sizes_m: FloatArray
    speeds_mps: FloatArray
    accelerations_mps2: FloatArray
    steering_rad: FloatArray
    jerks_mps3: FloatArray

    def within(self, start_ns: int, end_ns: int) -> FloatArray:
        """Times and poses (n, 4) of the states from start to end."""
        rows = (self.times_ns >= start_ns) & (self.times_ns <= end_ns)
        return np.column_stack([(self.times_ns[rows] - start_ns) / 1e9, self.poses[rows]])

    def between(self, start_ns: int, end_ns: int) -> Track:
        """The states from start until before end, each shown as long as it is in the whole."""
        rows = slice(*np.searchsorted(self.times_ns, [start_ns, end_ns]).tolist())
        if rows == slice(0, len(self.times_ns)):
            return self
        columns = (f.name for f in fields(self) if f.name != "vehicle_id")
        return replace(self, **{name: getattr(self, name)[rows] for name in columns})

    def segments(self) -> list[slice]:
        """The stretches between interruptions."""
        breaks = np.flatnonzero(self.ends_ns[:-1] < self.times_ns[1:]) + 1
        bounds = [0, *breaks.tolist(), len(self.times_ns)]
        return [slice(a, b) for a, b in itertools.pairwise(bounds) if b > a]

    def boxes_at(self, times_ns: IntArray) -> FloatArray:
        """Oriented boxes (T, 5) x, y, heading, length, width at the instants; NaN where absent."""
        boxes = np.full((len(times_ns), 5), np.nan)
        for part in self.segments():
            own = self.times_ns[part]
            inside = (times_ns >= own[0]) & (times_ns <= own[-1])
            values = np.column_stack([self.poses[part], self.sizes_m[part]])
            # Differences first: float64 cannot tell nanoseconds of absolute time apart.
            at, known = (times_ns[inside] - own[0]) / 1e9, (own - own[0]) / 1e9
            boxes[inside] = np.column_stack([np.interp(at, known, column) for column in values.T])
        return boxes


def make_track(vehicle_id: str, table: pl.DataFrame, origin_m: tuple[float, float], default: Config) -> Track:
    """Cut one vehicle's states, in any order, at their gaps; sizes that are unknown are the default."""
    table = table.sort("time_ns", maintain_order=True).unique("time_ns", keep="last", maintain_order=True)
    times = table["time_ns"].to_numpy().astype(np.int64)
    steps = np.diff(times)
    period = min(int(np.median(steps)), _LONGEST_GAP_NS) if len(steps) else seconds_to_ns(0.1)
    nexts = np.append(times[1:], FOREVER_NS)
    kept = np.append(steps <= min(_GAP_PERIODS * period, _LONGEST_GAP_NS), False)
    alone = np.minimum(times, FOREVER_NS - period) + period
    column = {name: table[name].cast(pl.Float64).to_numpy().copy() for name in _TRACK_COLUMNS}
    sizes = np.column_stack([column["length_m"], column["width_m"]])
    fallback = np.array([default.vehicles.length_m, default.vehicles.width_m])
    poses = [column["x_m"] - origin_m[0], column["y_m"] - origin_m[1], np.unwrap(column["heading_rad"])]
    return Track(
        vehicle_id=vehicle_id,
        times_ns=times,
        ends_ns=np.where(kept, nexts, alone),
        poses=np.column_stack(poses),
        sizes_m=np.where(np.isfinite(sizes) & (sizes > 0.0), sizes, fallback),
        speeds_mps=column["speed_mps"],
        accelerations_mps2=column["acceleration_mps2"],
        steering_rad=column["steering_rad"],
        jerks_mps3=column["jerk_mps3"],
    )
