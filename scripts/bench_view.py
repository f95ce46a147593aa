"""The Rerun view measured: columns against logging step by step, and a long log of many vehicles.

    scripts/bench-view [--vehicles 100] [--minutes 60] [--planned] [--viewer]

Everything is made here; processor seconds are of all threads, memory is the peak of a process of
its own. --viewer also opens the file in Rerun's viewer without a screen (software drawing).
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

S = 1_000_000_000
RATE_HZ = 10
WINDOW_S = 8


def states(vehicles: int, seconds: int, source: str) -> pl.DataFrame:
    """Vehicles on circles that overlap, at 10 Hz; planned ones by windows."""
    steps = seconds * RATE_HZ
    times = np.arange(steps, dtype=np.int64) * (S // RATE_HZ)
    tables = []
    for n in range(vehicles):
        radius, speed = 40.0 + 3.0 * n, 8.0 + n % 7 + np.sin(times / 3e9)
        angle = np.cumsum(speed) / RATE_HZ / radius + n
        tables.append(
            pl.DataFrame(
                {
                    "source": pl.Series([source], dtype=pl.String).new_from_index(0, steps),
                    "window": np.minimum(times // (WINDOW_S * S), seconds // WINDOW_S - 1).astype(np.int32),
                    "vehicle_id": pl.Series([f"truck_{n + 1}"]).new_from_index(0, steps),
                    "time_ns": times,
                    "x_m": radius * np.cos(angle),
                    "y_m": radius * np.sin(angle),
                    "heading_rad": (angle + np.pi / 2 + np.pi) % (2 * np.pi) - np.pi,
                    "speed_mps": speed,
                    "acceleration_mps2": np.gradient(speed) * RATE_HZ,
                    "steering_rad": np.full(steps, 2.7 / radius),
                    "jerk_mps3": np.zeros(steps),
                    "length_m": np.full(steps, 4.0),
                    "width_m": np.full(steps, 2.0),
                }
            )
        )
    return pl.concat(tables)


def corridors(table: pl.DataFrame) -> pl.DataFrame:
    """A cube of a second around each vehicle's places."""
    second = pl.col("time_ns") // S
    low_high = [
        expression
        for axis in ("x", "y")
        for expression in (
            (pl.col(f"{axis}_m").min() - 3.0).alias(f"{axis}_min_m"),
            (pl.col(f"{axis}_m").max() + 3.0).alias(f"{axis}_max_m"),
            pl.col(f"{axis}_m").first().alias(f"pivot_{axis}_m"),
            pl.col(f"{axis}_m").last().alias(f"pivot_end_{axis}_m"),
        )
    ]
    zero = [pl.lit(0.0).alias(f"frame_{name}") for name in ("x_m", "y_m", "yaw_rad")]
    return (
        table.group_by("window", "vehicle_id", second.alias("second"), maintain_order=True)
        .agg(*low_high)
        .with_columns(
            k=(pl.col("second") % WINDOW_S).cast(pl.Int32),
            start_ns=pl.col("second") * S,
            end_ns=(pl.col("second") + 1) * S,
        )
        .with_columns(*zero)
        .drop("second")
    )


def result(vehicles: int, seconds: int, *, planned: bool) -> Any:
    """A result of that many states, as if read back from its file."""
    from istc_replay import states as tables
    from istc_replay.datatypes import Result, StaticScene
    from istc_replay.states import conform

    recorded = states(vehicles, seconds, "recorded")
    parts = [recorded, recorded.with_columns(source=pl.lit("planned"))] if planned else [recorded]
    ids = [f"truck_{n + 1}" for n in range(vehicles)]
    windows = [
        {
            "index": n,
            "start_ns": n * WINDOW_S * S,
            "end_ns": (n + 1) * WINDOW_S * S,
            "units": WINDOW_S,
            "frame": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0},
            "status": "certified" if planned else "nothing_to_plan",
            "reason": "",
            "vehicles": [{"id": name} for name in ids],
            "exclusions": [],
            "undrivable": [],
            "vehicles_present": vehicles,
            "vehicles_plannable": vehicles if planned else 0,
            "vehicles_certified": vehicles if planned else 0,
        }
        for n in range(seconds // WINDOW_S)
    ]
    totals = {"windows": len(windows), "windows_full": len(windows), "vehicles_certified": 0}
    source = {"path": "long.mcap", "sha256": "0" * 64, "complete": True, "problems": []}
    cubes = (
        conform(corridors(recorded), tables.CORRIDORS_SCHEMA)
        if planned
        else pl.DataFrame(schema=tables.CORRIDORS_SCHEMA)
    )
    return Result(
        path="long",
        states=conform(pl.concat(parts), tables.RESULT_STATES_SCHEMA),
        corridors=cubes,
        obstacles=pl.DataFrame(schema=tables.OBSTACLES_SCHEMA),
        solves=pl.DataFrame(schema=tables.SOLVES_SCHEMA),
        certificates=pl.DataFrame(schema=tables.CERTIFICATES_SCHEMA),
        findings=pl.DataFrame(schema=tables.FINDINGS_SCHEMA),
        scene=StaticScene(),
        summary={"windows": windows, "totals": totals, "input": source},
        config_toml="",
    )


# --- columns against steps -------------------------------------------------------------------


def by_columns(table: pl.DataFrame, path: Path) -> int:
    """Boxes and speeds of a table as columns; the number of rows."""
    import rerun as rr

    from istc_replay.export.rerun.chunks import (
        FOREVER_NS,
        Clock,
        at_height,
        each,
        entity,
        quaternions,
        shown,
    )

    clock, rows = Clock(0, np.arange(10_000) * S), 0
    recording = rr.RecordingStream("bench", recording_id="columns")
    memory = recording.memory_recording()
    for (name,), own in table.partition_by("vehicle_id", as_dict=True).items():
        times, ends = own["time_ns"].to_numpy(), np.full(own.height, FOREVER_NS)
        boxes = each(
            rr.Boxes3D,
            centers=at_height(own.select("x_m", "y_m").to_numpy(), 0.0),
            quaternions=quaternions(own["heading_rad"].to_numpy()),
            half_sizes=np.tile([2.0, 1.0, 0.5], (own.height, 1)),
        )
        speeds = each(rr.Scalars, scalars=own["speed_mps"].to_numpy())
        chunks = shown(clock, entity("box", str(name)), times, ends, boxes)
        chunks += shown(clock, entity("speed", str(name)), times, ends, speeds)
        rr.send_chunks(chunks, recording=recording)
        rows += 2 * own.height
    path.write_bytes(memory.drain_as_bytes())
    return rows


def by_steps(table: pl.DataFrame, path: Path) -> int:
    """The same, one call a row."""
    import rerun as rr

    rows = 0
    recording = rr.RecordingStream("bench", recording_id="steps")
    memory = recording.memory_recording()
    for row in table.iter_rows(named=True):
        nanoseconds = row["time_ns"]
        recording.set_time("time", timestamp=np.datetime64(nanoseconds, "ns"))
        recording.set_time("scenario_time", duration=np.timedelta64(nanoseconds, "ns"))
        recording.set_time("time_unit", sequence=nanoseconds // S)
        half = row["heading_rad"] / 2.0
        turn = rr.Quaternion(xyzw=[0.0, 0.0, np.sin(half), np.cos(half)])
        box = rr.Boxes3D(
            centers=[[row["x_m"], row["y_m"], 0.0]], half_sizes=[[2.0, 1.0, 0.5]], quaternions=[turn]
        )
        recording.log(f"box/{row['vehicle_id']}", box)
        recording.log(f"speed/{row['vehicle_id']}", rr.Scalars(row["speed_mps"]))
        rows += 2
    path.write_bytes(memory.drain_as_bytes())
    return rows


# --- measuring -------------------------------------------------------------------------------


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system


def _apart(task: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
    """Run a task in a process of its own and take down its peak of memory."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_measured, (task, arguments))


def _measured(task: Callable[..., dict[str, Any]], arguments: tuple[Any, ...]) -> dict[str, Any]:
    found = task(*arguments)
    return found | {"peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}


def _stream(way: str) -> dict[str, Any]:
    table = states(20, 100, "recorded")
    send = {"columns": by_columns, "steps": by_steps}[way]
    with tempfile.TemporaryDirectory() as folder:
        send(table.head(2), Path(folder) / "warm.rrd")
        began = _cpu_s()
        rows = send(table, Path(folder) / "view.rrd")
        size = (Path(folder) / "view.rrd").stat().st_size
        return {"rows": rows, "cpu_s": _cpu_s() - began, "file_mb": size / 1e6}


def _long(vehicles: int, minutes: float, planned: bool, path: str) -> dict[str, Any]:
    from istc_replay.config import ViewConfig
    from istc_replay.export.rerun.view import view_chunks, write_view

    made = result(vehicles, int(minutes * 60) // WINDOW_S * WINDOW_S, planned=planned)
    began = _cpu_s()
    write_view(made, ViewConfig(), Path(path))
    cpu_s = _cpu_s() - began
    sizes = [(c.num_rows, c.to_record_batch().nbytes) for c in view_chunks(made, ViewConfig())]
    return {
        "states": made.states.height,
        "cpu_s": cpu_s,
        "file_mb": Path(path).stat().st_size / 1e6,
        "chunks": len(sizes),
        "rows": sum(rows for rows, _ in sizes),
        "arrow_mb": sum(size for _, size in sizes) / 1e6,
        "most_rows": max(rows for rows, _ in sizes),
        "largest_kb": max(size for _, size in sizes) / 1024,
    }


def viewed(path: str, instants_s: list[float]) -> dict[str, Any]:
    """Open a file in the viewer: seconds to the first picture and to others, and its memory."""
    import psutil
    from rerun.experimental import ViewerClient

    from istc_replay.export.rerun.viewer import free_port, rerun_command

    port = free_port()
    command = rerun_command("--headless", "--port", str(port), "--window-size", "1600x1000")
    process = subprocess.Popen(  # noqa: S603
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        began = time.perf_counter()
        client = None
        while client is None:
            try:
                client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                client.get_state()
            except Exception:
                client = None
                time.sleep(0.1)
        started = time.perf_counter()
        client.open(path)
        while client.get_state().loading:
            time.sleep(0.1)
        loaded = time.perf_counter()
        client.take_screenshot()
        first = time.perf_counter()
        others = []
        for instant in instants_s:
            since = time.perf_counter()
            client.set_time("scenario_time", duration=instant, play_state="paused")
            client.take_screenshot()
            others.append(time.perf_counter() - since)
        children = psutil.Process(process.pid).children(recursive=True)
        return {
            "start_s": started - began,
            "load_s": loaded - started,
            "first_picture_s": first - started,
            "seek_s": float(np.median(others)),
            "viewer_mb": max(child.memory_info().rss for child in children) / 1e6,
        }
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(timeout=20)


def main() -> None:
    """Print what is measured as JSON, a line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--planned", action="store_true", help="a plan for every vehicle as well")
    parser.add_argument("--viewer", action="store_true", help="open it in Rerun's viewer")
    chosen = parser.parse_args()
    for way in ("steps", "columns"):
        print(json.dumps({"way": way, **_rounded(_apart(_stream, way))}))
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/view.rrd"
        long = _apart(_long, chosen.vehicles, chosen.minutes, chosen.planned, path)
        print(json.dumps({"long": f"{chosen.vehicles} x {chosen.minutes:g} min", **_rounded(long)}))
        if chosen.viewer:
            span = chosen.minutes * 60.0
            print(json.dumps(_rounded(viewed(path, [0.25 * span, 0.5 * span, 0.75 * span]))))


def _rounded(found: dict[str, Any]) -> dict[str, Any]:
    return {key: float(f"{value:.3g}") if isinstance(value, float) else value for key, value in found.items()}


if __name__ == "__main__":
    main()
