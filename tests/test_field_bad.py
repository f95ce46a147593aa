"""Odd field logs: every vehicle has a plan or a named reason, and the run ends."""

from __future__ import annotations

from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.config import parse_config
from istc_replay.datatypes import Log, StaticScene
from istc_replay.pipeline.replay import replay_read
from istc_replay.states import STATES_SCHEMA, conform

FAST = 'corridors.mode = "fast"\nwindow.rules = "traffic"\n'


def car(
    vehicle_id: str, lane_m: float = 0.0, speed_mps: float = 12.0, hz: float = 10.0, **columns: Any
) -> pl.DataFrame:
    """A car on a straight lane for three seconds."""
    count = round(3.0 * hz) + 1
    times = np.arange(count) / hz
    values = {
        "vehicle_id": [vehicle_id] * count,
        "time_ns": np.round(times * 1e9).astype(np.int64),
        "x_m": speed_mps * times,
        "y_m": np.full(count, lane_m),
        "heading_rad": np.zeros(count),
        "speed_mps": np.full(count, speed_mps),
        "length_m": np.full(count, 4.5),
        "width_m": np.full(count, 1.8),
        "role": ["vehicle"] * count,
    } | columns
    return conform(pl.DataFrame(values), STATES_SCHEMA)


def far(track: pl.DataFrame, metres: float) -> pl.DataFrame:
    """The track, far from the origin."""
    return track.with_columns(x_m=pl.col("x_m") + metres, y_m=pl.col("y_m") - metres)


def jumping() -> pl.DataFrame:
    """A car that is somewhere else from one sample to the next, for a moment."""
    x = 12.0 * np.arange(31) / 10.0
    x[15] += 80.0
    return car("2", 4.0, x_m=x)


LOGS: dict[str, tuple[list[pl.DataFrame], str, dict[str, str]]] = {
    "one vehicle": ([car("1")], "", {"1": "planned"}),
    "none cooperative": (
        [car("1"), car("2", 4.0)],
        '[vehicles.by_id."1"]\ncooperative = false\n[vehicles.by_id."2"]\ncooperative = false\n',
        {"1": "uncooperative", "2": "uncooperative"},
    ),
    "all parked": ([car("1", speed_mps=0.0), car("2", 4.0, 0.0)], "", {"1": "parked", "2": "parked"}),
    "a hole": (
        [car("1"), car("2", 4.0).filter(~pl.col("time_ns").is_between(10**9, 2 * 10**9))],
        "",
        {"1": "planned", "2": "hole"},
    ),
    "sizes of zero": (
        [car("1", length_m=np.zeros(31), width_m=np.zeros(31)), car("2", 4.0)],
        "",
        {"1": "planned", "2": "planned"},
    ),
    "coordinates of 1e6 m": (
        [far(car("1"), 1e6), far(car("2", 4.0), 1e6)],
        "",
        {"1": "planned", "2": "planned"},
    ),
    "1 Hz": ([car("1", hz=1.0), car("2", 4.0, hz=1.0)], "", {"1": "low_rate", "2": "low_rate"}),
    "100 Hz": ([car("1", hz=100.0), car("2", 4.0, hz=100.0)], "", {"1": "planned", "2": "planned"}),
    "a teleport": ([car("1"), jumping()], "", {"1": "planned", "2": "speed_mismatch"}),
    "in reverse": ([car("1"), car("2", 4.0, -3.0)], "", {"1": "planned", "2": "reversing"}),
    "one where the other is": (
        [car("1"), car("2")],
        "",
        {"1": "overlap_at_start", "2": "overlap_at_start"},
    ),
}


@pytest.mark.parametrize("name", LOGS)
def test_every_vehicle_has_a_plan_or_a_named_reason(name: str) -> None:
    tracks, settings, expected = LOGS[name]
    log = Log("odd.mcap", "0" * 64, True, 0, 0, 0, 0, 0, 0, (), pl.concat(tracks), StaticScene(), ())
    window = replay_read(log, parse_config(FAST + settings)).summary["windows"][0]
    told = {v["id"]: "planned" for v in window["vehicles"]}
    told |= {e["vehicle_id"]: e["reason"] for e in (*window["exclusions"], *window["frozen"])}
    assert told == expected
    assert window["vehicles_certified"] == list(expected.values()).count("planned")
    assert window["vehicles_present"] == len(expected)
    if not window["vehicles_certified"]:
        assert window["reason"]
