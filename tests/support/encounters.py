"""Recorded traffic for the audit: with nothing wrong, and with what is planted."""

from __future__ import annotations

from typing import Any

import numpy as np
import polars as pl
from numpy.typing import ArrayLike, NDArray

from istc_replay.safety.log_audit import Audit

from .tracks import NS, track

Array = NDArray[np.float64]
#: Start of the logs, and the times of their samples from it.
START_NS = 1_700_000_000 * NS
T = np.arange(0, 12.01, 0.1)
AHEAD = 4.5 * 0.675 / 2  # from the rear axle to the centre


def recorded(name: str, time_s: ArrayLike, **columns: Any) -> pl.DataFrame:
    """States of one vehicle at times from the log's start; columns broadcast to the times."""
    return track(name, time_s, START_NS, **({"length_m": 4.5, "width_m": 1.9} | columns))


def drive(speed: Array | float, start: float = 0.0, t: Array = T) -> tuple[Array, Array]:
    """Positions and speeds of a drive along a line at a speed over time."""
    speeds = np.broadcast_to(np.asarray(speed, dtype=float), t.shape)
    way = np.concatenate([[0.0], np.cumsum((speeds[1:] + speeds[:-1]) / 2 * np.diff(t))])
    return start + way, speeds.copy()


def east(name: str, speed: Array | float, start: float, **other: Any) -> pl.DataFrame:
    x, v = drive(speed, start)
    return recorded(name, T, x_m=x, speed_mps=v, **other)


def north(name: str, speed: Array | float, start: float, **other: Any) -> pl.DataFrame:
    y, v = drive(speed, start)
    return recorded(name, T, **({"x_m": 0.0, "y_m": y, "speed_mps": v, "heading_rad": np.pi / 2} | other))


def bend(name: str, radius: float, speed: float) -> pl.DataFrame:
    """A circle as a bicycle drives it: the box centre's course is ahead of the heading."""
    angle, slip = speed * T / radius, np.arcsin(AHEAD / radius)
    return recorded(
        name,
        T,
        x_m=300 + radius * np.sin(angle),
        y_m=radius * (1 - np.cos(angle)),
        heading_rad=np.mod(angle - slip + np.pi, 2 * np.pi) - np.pi,
        speed_mps=speed * np.cos(slip),
    )


def calm() -> list[pl.DataFrame]:
    """Traffic with nothing wrong: lanes, a queue, parked cars that nearly touch, a bend, a pedestrian."""
    braking = np.clip(12.0 - 2.0 * (T - 3.0), 0.0, 12.0)
    parts = [
        east("leader", 15.0, 0.0),
        east("follower", 15.0, -60.0),
        east("oncoming", -15.0, 150.0, y_m=3.5),
        east("stopping", braking, -100.0, y_m=-20.0),
        recorded("standing", T, x_m=0.0, y_m=-20.0, speed_mps=0.0),
        bend("bending", 40.0, 8.0),
        recorded("walker", T, x_m=T, y_m=30.0, speed_mps=1.0, length_m=0.5, width_m=0.5, role="pedestrian"),
    ]
    parts += [recorded(f"parked{k}", T, x_m=60 + 4.55 * k, y_m=40.0, speed_mps=0.0) for k in range(4)]
    # A queue that creeps, with jitter in its speeds.
    rng = np.random.default_rng(7)
    for k in range(4):
        x, v = drive(1.5 + 0.03 * rng.normal(size=T.size), -6.0 * k)
        parts.append(recorded(f"queue{k}", T, x_m=x, y_m=60.0, speed_mps=v))
    return parts


def near_miss() -> list[pl.DataFrame]:
    """Two that cross: one passes 0.6 s before the other, both unbraked at 10 m/s."""
    # Each blocks the crossing for (4.5 + 1.9) / 10 s around its middle.
    return [
        recorded("ann", T, x_m=10 * T - 660, y_m=100.0, speed_mps=10.0),
        north("bob", 10.0, 100 - 60 - 12.4, x_m=-600.0),
    ]


def findings(audit: Audit) -> list[tuple[str, str | None, list[str]]]:
    """Rule, severity and vehicles of what an audit found."""
    return audit.findings.select("rule", "severity", "vehicles").rows()
