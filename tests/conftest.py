"""Shared fixtures: one small plan made by exact motion, and the result read back from its file."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import psutil
import pytest

from istc_replay.datatypes import (
    Certificate,
    Corridor,
    Corridors,
    Dimensions,
    Frame,
    Guidance,
    LaneLine,
    Log,
    Obstacle,
    Participant,
    Recording,
    Result,
    Scenario,
    SceneObstacle,
    SolveRecord,
    SolveStatus,
    StartState,
    StaticScene,
    Trajectory,
    VehicleInfo,
    Verdict,
    Window,
    WindowPlan,
    WindowStatus,
    read_only,
)
from istc_replay.geometry import box_corners, shift_along, to_map
from istc_replay.states import STATES_SCHEMA, conform
from istc_replay.units import wrap_angle

START_NS = 1_700_000_000_000_000_000
FRAME = Frame(x_m=120.0, y_m=-40.0, yaw_rad=0.3)
CAR = Dimensions(length_m=4.0, width_m=2.0, wheelbase_m=2.7, rear_axle_to_centre_m=1.35)
UNITS = 6

#: Start of the rear axle in the corridor frame, speed, jerk, steering angle, first unit, priority.
MOTIONS = {
    "car 1": ((-15.0, 0.0, 0.0), 4.0, 0.2, 0.0, 0, 0.5),
    "car 2": ((25.0, -15.0, np.pi / 2), 5.0, 0.0, 0.0, 0, 0.2),
    "car 3": ((15.0, 14.0, np.pi), 4.0, 0.0, 0.03, 1, 0.01),
}


def _motion(vehicle: str, times_s: np.ndarray) -> np.ndarray:
    """Rear-axle states (S, 6) of exact motion: a straight line with jerk, or an arc at constant speed."""
    (x, y, heading), v0, jerk, steering, first_unit, _ = MOTIONS[vehicle]
    t = times_s - first_unit
    s = v0 * t + jerk * t**3 / 6.0
    curvature = np.tan(steering) / CAR.wheelbase_m
    if curvature == 0.0:
        headings = np.full_like(t, heading)
        points = np.stack([x + s * np.cos(heading), y + s * np.sin(heading)], axis=-1)
    else:
        headings = heading + curvature * s
        points = np.stack(
            [
                x + (np.sin(headings) - np.sin(heading)) / curvature,
                y - (np.cos(headings) - np.cos(heading)) / curvature,
            ],
            axis=-1,
        )
    rest = [headings, np.full_like(t, steering), v0 + jerk * t**2 / 2.0, jerk * t]
    return np.column_stack([points, *rest])


def _centres(states: np.ndarray) -> np.ndarray:
    centres = shift_along(states[:, 0], states[:, 1], states[:, 2], CAR.rear_axle_to_centre_m)
    return np.column_stack([centres, states[:, 2]])  # (S, 3)


def _trajectory(vehicle: str) -> Trajectory:
    _, _, jerk, _, first_unit, _ = MOTIONS[vehicle]
    times = np.round(np.arange(first_unit, UNITS + 1e-9, 0.2), 9)
    controls = np.tile([0.0, jerk], (len(times) - 1, 1))
    states = read_only(_motion(vehicle, times), 6)
    return Trajectory(vehicle, CAR, read_only(times), states, read_only(controls, 2), 1.25)


def _corridor(vehicle: str) -> Corridor:
    first_unit = MOTIONS[vehicle][4]
    cubes = []
    for k in range(first_unit, UNITS):
        poses = _centres(_motion(vehicle, np.linspace(k, k + 1, 11)))
        corners = box_corners(poses[:, 0], poses[:, 1], poses[:, 2], CAR.length_m, CAR.width_m).reshape(-1, 2)
        (x_min, y_min), (x_max, y_max) = corners.min(axis=0) - 0.3, corners.max(axis=0) + 0.3
        cubes.append((x_min, x_max, y_min, y_max))
    pivots = _centres(_motion(vehicle, np.arange(first_unit, UNITS + 1.0)))[:, :2]
    return Corridor(
        vehicle, first_unit, read_only(cubes, 4), read_only(pivots, 2), read_only(pivots + 0.1, 2)
    )


def _recorded(vehicle: str) -> Recording:
    """What was driven instead: the same motion half a metre aside, 10 Hz."""
    times = np.round(np.arange(MOTIONS[vehicle][4], UNITS + 1e-9, 0.1), 9)
    states = _motion(vehicle, times)
    poses = _centres(states)
    poses[:, :2] = shift_along(poses[:, 0], poses[:, 1], poses[:, 2] + np.pi / 2, 0.5)
    return Recording(read_only(times), read_only(poses, 3), read_only(states[:, 4]))


def _participant(vehicle: str) -> Participant:
    recording, first_unit, priority = _recorded(vehicle), MOTIONS[vehicle][4], MOTIONS[vehicle][5]
    x, y, heading = (float(value) for value in recording.poses[0])
    start = StartState(x, y, heading, float(recording.speeds_mps[0]))
    return Participant(vehicle, CAR, priority, first_unit, UNITS - first_unit, start, recording)


def _guidance(vehicle: str) -> Guidance:
    participant = _participant(vehicle)
    recording = participant.recording
    ends = recording.poses[::10]
    return Guidance(
        vehicle,
        "recorded",
        read_only(ends[:, :2], 2),
        read_only(ends[:, 2]),
        MOTIONS[vehicle][1],
        recording.times_s,
        recording.poses,
    )


def _states_table() -> pl.DataFrame:
    tables = []
    for vehicle in MOTIONS:
        recording = _recorded(vehicle)
        points = to_map(recording.poses[:, :2], FRAME)
        times_ns = START_NS + np.round(recording.times_s * 1e9).astype(np.int64)
        columns = {
            "vehicle_id": [vehicle] * len(times_ns),
            "time_ns": times_ns,
            "log_time_ns": times_ns,
            "publish_time_ns": times_ns,
            "x_m": points[:, 0],
            "y_m": points[:, 1],
            "heading_rad": wrap_angle(recording.poses[:, 2] + FRAME.yaw_rad),
            "speed_mps": recording.speeds_mps,
            "length_m": np.full(len(times_ns), CAR.length_m),
            "width_m": np.full(len(times_ns), CAR.width_m),
            "role": ["vehicle"] * len(times_ns),
            "topic": [f"/vehicles/{vehicle}/state"] * len(times_ns),
            "message_index": np.arange(len(times_ns)),
            "derived": np.zeros(len(times_ns), dtype=np.uint8),
        }
        tables.append(conform(pl.DataFrame(columns), STATES_SCHEMA))
    return pl.concat(tables)


def _log() -> Log:
    block = to_map([0.0, -8.0], FRAME)
    lanes = [
        LaneLine(f"lane {i}", read_only(to_map(points, FRAME), 2), vehicle)
        for i, (vehicle, points) in enumerate(
            {
                "car 1": [[-30.0, 0.0], [30.0, 0.0]],
                "car 2": [[25.0, -30.0], [25.0, 0.0], [25.0, 30.0]],
            }.items()
        )
    ]
    states = _states_table()
    return Log(
        path="synthetic.mcap",
        sha256="0" * 64,
        complete=True,
        messages=states.height,
        attachments=0,
        metadata=0,
        chunks=1,
        start_ns=START_NS,
        end_ns=START_NS + UNITS * 1_000_000_000,
        channels=(),
        states=states,
        scene=StaticScene(
            lane_lines=tuple(lanes),
            obstacles=(SceneObstacle("block", float(block[0]), float(block[1]), FRAME.yaw_rad, 6.0, 3.0),),
            vehicles=tuple(VehicleInfo(vehicle, MOTIONS[vehicle][5], CAR) for vehicle in MOTIONS),
        ),
        problems=(),
    )


def _obstacles() -> tuple[Obstacle, ...]:
    block = np.tile([-3.0, 3.0, -9.5, -6.5], (UNITS, 1))
    walker = np.full((UNITS, 4), np.nan)
    walker[2:] = [[-20.0 + k, -18.5 + k, -14.0, -13.0] for k in range(2, UNITS)]
    outline = [[3.0, -6.5], [3.0, -9.5], [-3.0, -9.5], [-3.0, -6.5]]
    return (
        Obstacle("block", read_only(block, 4), read_only(outline, 2)),
        Obstacle("walker", read_only(walker, 4)),
    )


@pytest.fixture(scope="session")
def shared_logs() -> Path:
    """The reference logs beside the repository."""
    folder = Path(__file__).resolve().parents[1] / "../shared/logs"
    if not folder.is_dir():
        pytest.skip("the shared reference logs are not beside this repository")
    return folder


@pytest.fixture(scope="session")
def synthetic_plan() -> tuple[Log, list[WindowPlan]]:
    """A log of three cars over 6 s and its one window, planned by exact motion in a turned frame.

    `car 1` drives straight with a constant jerk, `car 2` crosses at a constant speed, `car 3` comes
    in at the second unit and drives an arc. `block` stands; `walker` moves from the third unit on.
    """
    window = Window(0, START_NS, START_NS + UNITS * 1_000_000_000, 1.0, UNITS, FRAME)
    records = (
        SolveRecord("corridors", "tree", "daqp", SolveStatus.FEASIBLE, objective=27.2, nodes=11, wall_s=0.05),
        SolveRecord(
            "corridors",
            "certificate",
            "cbc",
            SolveStatus.OPTIMAL,
            objective=27.2,
            bound=27.18,
            gap=0.001,
            wall_s=0.9,
            binaries=48,
        ),
    )
    corridors = Corridors(
        SolveStatus.OPTIMAL, tuple(_corridor(v) for v in MOTIONS), 27.2, 27.18, 0.001, "tree", "", records
    )
    solves = tuple(
        SolveRecord(
            "trajectory", "nlp", "ipopt", SolveStatus.OPTIMAL, v, objective=1.25, iterations=12, wall_s=0.02
        )
        for v in MOTIONS
    )
    scenario = Scenario(
        window, tuple(_participant(v) for v in MOTIONS), _obstacles(), None, vehicles_present=len(MOTIONS)
    )
    plan = WindowPlan(
        scenario,
        WindowStatus.CERTIFIED,
        guidance=tuple(_guidance(v) for v in MOTIONS),
        corridors=corridors,
        trajectories=tuple(_trajectory(v) for v in MOTIONS),
        records=records + solves,
    )
    return _log(), [plan]


@pytest.fixture(scope="session")
def synthetic_certificates() -> list[Certificate]:
    """The checks of `synthetic_plan`; one of them fails."""
    pairs = list(itertools.combinations(MOTIONS, 2))
    return [
        Certificate(0, "disjoint", Verdict.PASS, 0.8, "m", 2.0, pairs[0], "cubes of unit 2"),
        Certificate(
            0, "dynamics", Verdict.FAIL, -0.07, "m", 5.4, ("car 3",), "drift from the written states"
        ),
        Certificate(0, "overlap", Verdict.NOT_APPLICABLE, None, "m"),
    ]


@pytest.fixture(scope="session")
def synthetic_summary(synthetic_plan: tuple[Log, list[WindowPlan]]) -> dict[str, object]:
    """The summary of `synthetic_plan`, with its timings."""
    log, plans = synthetic_plan
    window = plans[0].scenario.window
    vehicles = [
        {
            "id": p.vehicle_id,
            "priority": p.priority,
            "dimensions_source": "log",
            "first_unit": p.first_unit,
            "units": p.units,
            "corridor_area_m2": 100.0 + 50.0 * p.priority,
            "pivot_deviation_m": 0.14,
            "guidance": "recorded",
            "speed_std_mps": 0.1,
        }
        for p in plans[0].scenario.participants
    ]
    checks = [
        {
            "check": "disjoint",
            "verdict": "pass",
            "margin": 0.8,
            "unit": "m",
            "time_s": 2.0,
            "vehicles": ["car 1", "car 2"],
            "detail": "",
        },
        {
            "check": "dynamics",
            "verdict": "fail",
            "margin": -0.07,
            "unit": "m",
            "time_s": 5.4,
            "vehicles": ["car 3"],
            "detail": "",
        },
    ]
    return {
        "schema": "istc-replay.summary.v1",
        "input": {"path": log.path, "sha256": log.sha256, "complete": True, "problems": []},
        "versions": {"istc-replay": "0.1.0"},
        "config_sha256": "1" * 64,
        "windows": [
            {
                "index": 0,
                "start_ns": window.start_ns,
                "end_ns": window.end_ns,
                "unit_s": window.unit_s,
                "units": window.units,
                "frame": {"x_m": FRAME.x_m, "y_m": FRAME.y_m, "yaw_rad": FRAME.yaw_rad},
                "status": "certified",
                "reason": "",
                "vehicles_present": 3,
                "vehicles_plannable": 3,
                "vehicles_certified": 3,
                "excluded": {},
                "exclusions": [],
                "rounds": 1,
                "undrivable": [],
                "corridors": {
                    "status": "optimal",
                    "objective": 27.2,
                    "bound": 27.18,
                    "gap": 0.001,
                    "found_by": "tree",
                    "reason": "",
                    "seconds": 0.95,
                },
                "trajectories": {"seconds": 0.06},
                "certificate": {"verdict": "fail", "checks": checks},
                "recorded": {"min_separation_m": 4.2, "pair": ["car 1", "car 2"], "time_s": 5.0},
                "vehicles": vehicles,
            }
        ],
        "totals": {
            "windows": 1,
            "windows_full": 1,
            "vehicles_present": 3,
            "vehicles_plannable": 3,
            "vehicles_certified": 3,
            "log_s": 6.0,
            "cpu_s": 1.5,
        },
        "stages": {"ingest": 0.01, "corridors": 0.95, "trajectories": 0.06},
    }


@pytest.fixture(scope="session")
def synthetic_bytes(
    synthetic_plan: tuple[Log, list[WindowPlan]],
    synthetic_certificates: list[Certificate],
    synthetic_summary: dict[str, object],
) -> bytes:
    """The result.mcap of `synthetic_plan`."""
    from istc_replay.export.result_mcap import result_bytes

    log, plans = synthetic_plan
    provenance = {"istc-replay": "0.1.0", "input_sha256": log.sha256}
    return result_bytes(
        log, plans, synthetic_certificates, synthetic_summary, "[window]\nunit_s = 1.0\n", provenance
    )


@pytest.fixture(scope="session")
def synthetic_result(synthetic_bytes: bytes) -> Result:
    """`synthetic_plan` as every view reads it: the result read back from its file."""
    from istc_replay.ingest.result import read_result

    return read_result(synthetic_bytes)


@pytest.fixture(scope="session")
def long_bytes(
    synthetic_plan: tuple[Log, list[WindowPlan]],
    synthetic_certificates: list[Certificate],
    synthetic_summary: dict[str, Any],
) -> bytes:
    """The result.mcap of `synthetic_plan` five times in a row."""
    from istc_replay.export.result_mcap import result_bytes

    log, (plan,) = synthetic_plan
    window, (entry,) = plan.scenario.window, synthetic_summary["windows"]
    span_ns = window.end_ns - window.start_ns
    plans, certificates, windows, tables = [], [], [], []
    for k in range(5):
        span = {"start_ns": window.start_ns + k * span_ns, "end_ns": window.end_ns + k * span_ns}
        moved = replace(plan.scenario, window=replace(window, index=k, **span))
        plans.append(replace(plan, scenario=moved))
        certificates += [replace(check, window=k) for check in synthetic_certificates]
        windows.append(entry | span | {"index": k})
        # The next window begins with the state at its start.
        own = log.states.filter(pl.col("time_ns") < window.end_ns) if k < 4 else log.states
        tables.append(own.with_columns(pl.col("time_ns") + k * span_ns))
    states = pl.concat(tables).sort("vehicle_id", "time_ns")
    summary = synthetic_summary | {"windows": windows}
    long = replace(log, states=states)
    return result_bytes(long, plans, certificates, summary, "[window]\nunit_s = 1.0\n", {})


def _renamed(result: Result, new_names: dict[str, str]) -> Result:

    def rename(value: Any) -> Any:
        if isinstance(value, str):
            return new_names.get(value, value)
        if isinstance(value, list):
            return [rename(part) for part in value]
        if isinstance(value, dict):
            return {key: rename(part) for key, part in value.items()}
        return value

    ids = pl.col("vehicle_id").replace(new_names)
    vehicles = pl.col("vehicles").list.eval(pl.element().replace(new_names))
    return replace(
        result,
        states=result.states.with_columns(ids),
        corridors=result.corridors.with_columns(ids),
        solves=result.solves.with_columns(ids),
        certificates=result.certificates.with_columns(vehicles),
        summary=rename(result.summary),
    )


@pytest.fixture(scope="session")
def renamed() -> Callable[[Result, dict[str, str]], Result]:
    """Give the same result of vehicles by other names, in its tables and in its summary."""
    return _renamed


# --- viewers ---------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def listening() -> Callable[[int], set[str]]:
    """Give the addresses on which a process and its children listen; there must be one at least."""

    def addresses(pid: int) -> set[str]:
        process = psutil.Process(pid)
        found = {
            connection.laddr.ip
            for one in (process, *process.children(recursive=True))
            for connection in one.net_connections(kind="inet")
            if connection.status == psutil.CONN_LISTEN
        }
        assert found
        return found

    return addresses


@pytest.fixture(scope="session")
def viewer_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[bytes]]:
    """A headless viewer, started with the product's own command line; skips where there is no drawing."""
    from rerun.experimental import ViewerClient

    from istc_replay.export.rerun_viewer import free_port, rerun_command

    port = free_port()
    log = tmp_path_factory.mktemp("viewer") / "log.txt"
    command = rerun_command("--headless", "--port", str(port), "--window-size", "1600x1000")
    with log.open("w") as out:
        process = subprocess.Popen(
            [*command, "--hide-welcome-screen", "--memory-limit", "1GB"],
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    process.url = f"rerun+http://127.0.0.1:{port}/proxy"  # type: ignore[attr-defined]
    try:
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline and process.poll() is None:
            try:
                ViewerClient.connect(process.url).get_state()  # type: ignore[attr-defined]
            except Exception:  # whatever it is, the viewer is not up yet
                time.sleep(0.3)
            else:
                break
        else:
            words = log.read_text(errors="replace").strip().splitlines() or ["no word"]
            pytest.skip(f"Rerun's viewer does not start here (no Vulkan in software?): {words[-1]}")
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait(timeout=20)


@pytest.fixture
def viewer(viewer_process: Any) -> Iterator[Any]:
    """A client of the headless viewer; what a test opens is closed after it."""
    from rerun.experimental import ViewerClient

    client = ViewerClient.connect(viewer_process.url)
    yield client
    if client.get_state().recordings:
        client.close("all")
