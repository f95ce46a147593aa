"""Odd field logs, replayed as files: every vehicle has a plan or a named reason, and the run ends."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import istc_replay
from istc_replay.config import parse_config
from istc_replay.datatypes import StaticScene
from istc_replay.export.sample_log import sample_bytes
from istc_replay.samples.drive import RecordedScene

from .support.tracks import driver

FAST = 'corridors.mode = "fast"\nwindow.rules = "traffic"\n'


#: Names and lanes of two cars.
TWO = (("1", 0.0), ("2", 4.0))


def car(
    vehicle_id: str, lane_m: float = 0.0, speed_mps: float = 12.0, hz: float = 10.0, **columns: Any
) -> pl.DataFrame:
    """A car on a straight lane for three seconds."""
    return driver(vehicle_id, lane_m, 0.0, speed_mps, 3.0, hz, **columns)


def far(track: pl.DataFrame, metres: float) -> pl.DataFrame:
    """The track, far from the origin."""
    return track.with_columns(x_m=pl.col("x_m") + metres, y_m=pl.col("y_m") - metres)


def jumping() -> pl.DataFrame:
    """A car that is somewhere else from one sample to the next, for a moment."""
    x = 12.0 * np.arange(31) / 10.0
    x[15] += 80.0
    return car("2", 4.0, x_m=x)


def backing_out() -> pl.DataFrame:
    """A car that backs up, stands, and drives on forward."""
    speed = np.clip((np.arange(31) - 15) / 5.0, -2.0, 2.0)
    way = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 20.0)])
    return car("2", 4.0, x_m=way, speed_mps=speed)


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
    "a hole in every track": (
        [car(name, lane).filter(~pl.col("time_ns").is_between(10**9, 2 * 10**9)) for name, lane in TWO],
        "",
        {"1": "hole", "2": "hole"},
    ),
    "sizes of zero": (
        [car("1", length_m=np.zeros(31), width_m=np.zeros(31)), car("2", 4.0)],
        "",
        {"1": "planned", "2": "planned"},
    ),
    "a truck as long as the road": (
        [car("1", length_m=np.full(31, 90.0)), car("2", 4.0)],
        "",
        {"1": "planned", "2": "planned"},
    ),
    "coordinates of 1e6 m": (
        [far(car("1"), 1e6), far(car("2", 4.0), 1e6)],
        "",
        {"1": "planned", "2": "planned"},
    ),
    "vehicles 1e6 m apart": ([car("1"), far(car("2"), 1e6)], "", {"1": "planned", "2": "planned"}),
    "1 Hz": ([car("1", hz=1.0), car("2", 4.0, hz=1.0)], "", {"1": "low_rate", "2": "low_rate"}),
    "1 Hz beside 10 Hz": ([car("1"), car("2", 4.0, hz=1.0)], "", {"1": "planned", "2": "low_rate"}),
    "100 Hz": ([car("1", hz=100.0), car("2", 4.0, hz=100.0)], "", {"1": "planned", "2": "planned"}),
    "a teleport": ([car("1"), jumping()], "", {"1": "planned", "2": "speed_mismatch"}),
    "a teleport sideways": (
        [car("1"), car("2", y_m=np.where(np.arange(31) < 15, 6.0, 12.0))],
        "",
        {"1": "planned", "2": "undrivable_track"},
    ),
    "in reverse": ([car("1"), car("2", 4.0, -3.0)], "", {"1": "planned", "2": "reversing"}),
    "backing out": ([car("1"), backing_out()], "", {"1": "planned", "2": "reversing"}),
    "a heading that turns about": (
        [car("1"), car("2", 4.0, heading_rad=np.where(np.arange(31) < 15, 0.0, np.pi))],
        "",
        {"1": "planned", "2": "planned"},
    ),
    "sliding sideways": (
        [car("1"), car("2", 8.0, heading_rad=np.full(31, np.pi / 2))],
        "",
        {"1": "planned", "2": "undrivable_track"},
    ),
    "positions that are no numbers": (
        [car("1"), car("2", 4.0, x_m=np.full(31, np.nan))],
        "",
        {"1": "planned", "2": "missing_position"},
    ),
    "there for a tenth of a second": (
        [car("1"), car("2", 4.0).head(2)],
        "",
        {"1": "planned", "2": "short_presence"},
    ),
    "one where the other is": (
        [car("1"), car("2")],
        "",
        {"1": "overlap_at_start", "2": "overlap_at_start"},
    ),
}


def written(tracks: list[pl.DataFrame], folder: Path) -> Path:
    """The tracks as a log."""
    path = folder / "odd.mcap"
    path.write_bytes(sample_bytes(RecordedScene("odd", StaticScene(), pl.concat(tracks))))
    return path


def told(window: dict[str, Any]) -> dict[str, str]:
    """What a window says of each road user: planned, or why not."""
    left = (*window["exclusions"], *window["frozen"])
    assert all(entry["detail"] for entry in left)
    return {v["id"]: "planned" for v in window["vehicles"]} | {e["vehicle_id"]: e["reason"] for e in left}


@pytest.mark.parametrize("name", LOGS)
def test_every_vehicle_has_a_plan_or_a_named_reason(name: str, tmp_path: Path) -> None:
    tracks, settings, expected = LOGS[name]
    result = istc_replay.replay(written(tracks, tmp_path), parse_config(FAST + settings))
    (window,) = result.summary["windows"]
    assert told(window) == expected
    planned = {name for name, what in expected.items() if what == "planned"}
    assert window["vehicles_certified"] == len(planned)
    assert window["vehicles_present"] == len(expected)
    assert set(result.states.filter(pl.col("source") == "planned")["vehicle_id"]) == planned
    assert window["certificate"]["verdict"] == ("pass" if planned else "not_applicable")
    # Who is not planned is in the way of who is, wherever anything is known of its motion.
    if planned and name != "positions that are no numbers":
        assert expected.keys() - planned <= set(result.obstacles["obstacle_id"])
    if not planned:
        assert window["reason"]


def test_a_car_whose_heading_turns_about_is_planned_as_it_moves(tmp_path: Path) -> None:
    tracks = LOGS["a heading that turns about"][0]
    states = istc_replay.replay(written(tracks, tmp_path), parse_config(FAST)).states
    heading = states.filter((pl.col("source") == "planned") & (pl.col("vehicle_id") == "2"))["heading_rad"]
    assert heading.abs().max() < 0.1  # type: ignore[operator]


RUN = "from istc_replay.cli import main; main()"


def run(log: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """The command, with fast settings of traffic."""
    config = folder / "config.toml"
    config.write_text(FAST)
    command = [sys.executable, "-c", RUN, "run", str(log), "-o", str(folder / "out"), "-c", str(config)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


def test_the_command_tells_who_is_not_planned_and_why(tmp_path: Path) -> None:
    done = run(written([car("1"), car("2", 4.0, -3.0)], tmp_path), tmp_path)
    assert (done.returncode, "Traceback" in done.stderr) == (0, False), done.stderr
    summary = json.loads((tmp_path / "out" / "odd" / "summary.json").read_text())
    assert told(summary["windows"][0]) == {"1": "planned", "2": "reversing"}
    assert "drives at -3.00 m/s" in (tmp_path / "out" / "odd" / "report.html").read_text()


def test_the_command_tells_why_there_is_nobody_to_plan(tmp_path: Path) -> None:
    done = run(written([car("1", speed_mps=0.0), car("2", 4.0, 0.0)], tmp_path), tmp_path)
    assert (done.returncode, "Traceback" in done.stderr) == (3, False), done.stderr
    assert "nothing_to_plan: no vehicle of the window can be planned: 1: never moves" in done.stdout
