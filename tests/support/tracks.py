"""Recorded road users as tables of states, and logs of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import ArrayLike

from istc_replay.datatypes import Log, StaticScene
from istc_replay.states import STATES_SCHEMA, conform

NS = 1_000_000_000


def track(vehicle_id: str, time_s: ArrayLike, start_ns: int = 0, **columns: Any) -> pl.DataFrame:
    """States of one road user at times; columns are broadcast to the times, others than these are null."""
    times = np.round(np.asarray(time_s, dtype=np.float64) * NS).astype(np.int64) + start_ns
    values = {
        "vehicle_id": vehicle_id,
        "time_ns": times,
        "log_time_ns": times,
        "publish_time_ns": times,
        "y_m": 0.0,
        "heading_rad": 0.0,
        "role": "vehicle",
        "topic": f"/{vehicle_id}",
        "message_index": np.arange(times.size),
        "derived": 0,
    } | columns
    wide = {name: np.broadcast_to(np.asarray(value), times.shape) for name, value in values.items()}
    return conform(pl.DataFrame(wide), STATES_SCHEMA)


def driver(
    vehicle_id: str,
    lane_m: float = 0.0,
    ahead_m: float = 0.0,
    speed_mps: float = 12.0,
    seconds: float = 4.0,
    hz: float = 10.0,
    **columns: Any,
) -> pl.DataFrame:
    """A car, 4.5 m by 1.8 m, that drives along its lane of a straight road to the east."""
    times = np.arange(round(seconds * hz) + 1) / hz
    values = {
        "x_m": ahead_m + speed_mps * times,
        "y_m": lane_m,
        "speed_mps": speed_mps,
        "length_m": 4.5,
        "width_m": 1.8,
    }
    return track(vehicle_id, times, **(values | columns))


def log_of(*tracks: pl.DataFrame, **changes: Any) -> Log:
    """A log of these states, sorted as a log's are; nothing of a scene is told."""
    states = pl.concat(tracks) if tracks else pl.DataFrame(schema=STATES_SCHEMA)
    states = states.sort("vehicle_id", "time_ns", maintain_order=True)
    times = states["time_ns"].to_numpy()
    start_ns, end_ns = (int(times.min()), int(times.max())) if times.size else (None, None)
    log = Log(
        path="made.mcap",
        sha256="0" * 64,
        complete=True,
        messages=states.height,
        attachments=0,
        metadata=0,
        chunks=0,
        start_ns=start_ns,
        end_ns=end_ns,
        channels=(),
        states=states,
        scene=StaticScene(),
        problems=(),
    )
    return replace(log, **changes)


#: A slower car ahead of a faster one that swerves beside it, and one in the next lane.
BUSY = log_of(
    driver("1"), driver("2", 3.7, 2.0, 11.0), driver("3", 0.6, 14.0, 9.5), driver("4", 7.0, -3.0, 13.0)
)


def turned(log: Log, angle_rad: float, shift_m: tuple[float, float]) -> Log:
    """The log turned about the origin and shifted."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y = pl.col("x_m"), pl.col("y_m")
    states = log.states.with_columns(
        x_m=c * x - s * y + shift_m[0],
        y_m=s * x + c * y + shift_m[1],
        heading_rad=pl.col("heading_rad") + angle_rad,
    )
    return replace(log, states=states)
