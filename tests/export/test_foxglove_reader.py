"""A result read by the reference TypeScript library, as Foxglove and Lichtblick read it.

Needs node and, once, `npm install` in tests/export/foxglove_reader.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.datatypes import Frame, Result
from istc_replay.geometry import box_corners, to_map

HERE = Path(__file__).parent / "foxglove_reader"


@pytest.fixture(scope="module")
def read(synthetic_bytes: bytes, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the library reads of the synthetic result."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    if not (HERE / "node_modules" / "@mcap" / "core").exists():
        pytest.skip(
            "the TypeScript library is not installed: run `npm install` in tests/export/foxglove_reader"
        )
    path = tmp_path_factory.mktemp("result") / "result.mcap"
    path.write_bytes(synthetic_bytes)
    done = subprocess.run(
        [node, HERE / "read.mjs", path], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def yaw(rotation: dict[str, float]) -> float:
    """Heading of a quaternion about z."""
    return 2.0 * float(np.arctan2(rotation["z"], rotation["w"]))


def stamp_ns(stamp: dict[str, int] | None) -> int:
    """A protobuf timestamp or duration in nanoseconds."""
    return 0 if stamp is None else stamp["seconds"] * 10**9 + stamp["nanos"]


def test_both_readers_find_every_message_and_no_field_is_missing(read: dict[str, Any]) -> None:
    assert read["missing"] == []
    assert read["done"]
    assert read["streamed"] == sum(len(topic["messages"]) for topic in read["topics"].values())
    schemas = {topic["schema"] for topic in read["topics"].values()}
    assert {
        "foxglove.FrameTransforms",
        "foxglove.SceneUpdate",
        "foxglove.PosesInFrame",
        "foxglove.Log",
        "istc.v1.VehicleState",
    } <= schemas


def test_corridor_cubes_stand_turned_for_just_their_units(
    read: dict[str, Any], synthetic_result: Result
) -> None:
    expected = {}
    for row in synthetic_result.corridors.iter_rows(named=True):
        frame = row["frame_x_m"], row["frame_y_m"], row["frame_yaw_rad"]
        expected[row["vehicle_id"], row["start_ns"]] = (row, frame)
    seen = set()
    for log_time, scene in read["topics"]["/istc/scene"]["messages"]:
        for entity in scene["entities"]:
            if not entity["id"].startswith("corridor/"):
                continue
            key = entity["id"].removeprefix("corridor/").replace("%20", " "), stamp_ns(entity["timestamp"])
            row, (x, y, turn) = expected[key]
            (cube,) = entity["cubes"]
            centre = to_map(
                [(row["x_min_m"] + row["x_max_m"]) / 2, (row["y_min_m"] + row["y_max_m"]) / 2],
                Frame(x, y, turn),
            )
            position = cube["pose"]["position"]
            assert (position["x"], position["y"]) == pytest.approx(tuple(centre), abs=1e-9)
            assert yaw(cube["pose"]["orientation"]) == pytest.approx(turn)
            assert cube["size"]["x"] == pytest.approx(row["x_max_m"] - row["x_min_m"])
            end_ns = key[1] + stamp_ns(entity["lifetime"])
            assert end_ns == row["end_ns"]
            assert key[1] <= int(log_time) < end_ns
            seen.add(key)
    assert seen == set(expected)


def test_vehicles_are_boxes_with_an_arrow_to_their_noses(
    read: dict[str, Any], synthetic_result: Result
) -> None:
    planned = synthetic_result.states.filter(pl.col("source") == "planned")
    states = {(row["vehicle_id"], row["time_ns"]): row for row in planned.iter_rows(named=True)}
    seen = 0
    for log_time, scene in read["topics"]["/istc/scene"]["messages"]:
        for entity in scene["entities"]:
            name = entity["id"].removeprefix("planned/").replace("%20", " ")
            row = states.get((name, int(log_time)))
            if not entity["id"].startswith("planned/") or row is None:
                continue
            (cube,), (arrow,) = entity["cubes"], entity["arrows"]
            box = box_corners(row["x_m"], row["y_m"], row["heading_rad"], row["length_m"], row["width_m"])
            nose = box.reshape(4, 2)[:2].mean(axis=0)
            start, turn = arrow["pose"]["position"], yaw(arrow["pose"]["orientation"])
            reach = arrow["shaft_length"] + arrow["head_length"]
            tip = (start["x"] + reach * np.cos(turn), start["y"] + reach * np.sin(turn))
            assert tip == pytest.approx(tuple(nose), abs=1e-9)
            assert (cube["size"]["x"], cube["size"]["y"]) == (row["length_m"], row["width_m"])
            seen += 1
    assert seen > 50


def test_states_can_be_plotted_by_their_names(read: dict[str, Any], synthetic_result: Result) -> None:
    for source in ("recorded", "planned"):
        for (vehicle,), states in (
            synthetic_result.states.filter(pl.col("source") == source)
            .partition_by("vehicle_id", as_dict=True)
            .items()
        ):
            topic = read["topics"][f"/istc/{source}/{str(vehicle).replace(' ', '%20')}"]
            speeds = [message["speed_mps"] for _, message in topic["messages"]]
            assert speeds == pytest.approx(states.sort("time_ns")["speed_mps"].to_list())
            assert [int(time) for time, _ in topic["messages"]] == states["time_ns"].sort().to_list()


def test_log_lines_have_level_place_and_words(read: dict[str, Any]) -> None:
    lines = [message for _, message in read["topics"]["/istc/log"]["messages"]]
    assert {line["name"] for line in lines} >= {"window 0"}
    assert all(line["message"].isprintable() for line in lines)
    assert {line["level"] for line in lines} <= {2, 3, 4}


def test_transforms_name_their_frames(read: dict[str, Any]) -> None:
    frames = {
        transform["child_frame_id"]
        for _, message in read["topics"]["/tf"]["messages"]
        for transform in message["transforms"]
    }
    assert {"corridor/0", "vehicle/car%201", "recorded/car%201"} <= frames
