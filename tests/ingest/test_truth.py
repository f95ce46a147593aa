"""Every format of the shared logs tells the one truth that they were all made from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.config import parse_config
from istc_replay.ingest.log import read_log
from istc_replay.ingest.walk import open_log

MAPPING = "\n".join(
    f"""
    [ingest.topics."/vehicles/{vehicle}/state"]
    reference_point = "rear_axle"
    [ingest.topics."/vehicles/{vehicle}/state".fields]
    vehicle_id = "id"
    frame = "frame_id"
    time = "timestamp"
    x_m = "x"
    y_m = "y"
    heading_rad = "yaw"
    speed_mps = "v"
    acceleration_mps2 = "a"
    length_m = "length"
    width_m = "width"
    """
    for vehicle in range(6)
)


#: File, what is read of it, the vehicles' names, and what it tells beside pose and time.
CASES = [
    ("ros2_odom", "", "vehicle_{}", {"speed"}),
    ("ros1_odom", "", "vehicle_{}", {"speed"}),
    ("osi_gt", "", "10{}", {"speed", "acceleration", "size"}),
    ("autoware_tracked", "", "00000000-0000-0000-0000-00000000000{}", {"speed", "size"}),
    ("foxglove_scene", "", "vehicle_{}", {"size"}),
    ("foxglove_scene", '[ingest.topics."/scene"]\nformat = "ignore"', "vehicle_{}", set()),
    (
        "autoware_tracked",
        '[ingest.topics."/perception/object_recognition/tracking/objects"]\nformat = "ignore"',
        "vehicle_{}",
        set(),
    ),
    ("json_state", MAPPING, "{}", {"speed", "acceleration", "size"}),
]


@pytest.mark.parametrize(("name", "config", "vehicle", "told"), CASES)
def test_a_format_tells_the_truth(
    name: str, config: str, vehicle: str, told: set[str], shared_logs: Path, json_truth: pl.DataFrame
) -> None:
    log = read_log(shared_logs / f"formats/{name}.mcap", parse_config(config))
    states = log.states
    first = 1 if name == "autoware_tracked" and "{}" in vehicle and vehicle.startswith("0") else 0
    assert log.problems == ()
    assert states["vehicle_id"].to_list() == [vehicle.format(int(v) + first) for v in json_truth["id"]]
    assert states["time_ns"].to_list() == json_truth["time_ns"].to_list()
    assert (states["x_m"] - json_truth["x"] - 1.35 * json_truth["yaw"].cos()).abs().max() < 0.21
    turn = (states["heading_rad"] - json_truth["yaw"]).to_numpy()
    assert np.abs(np.sin(turn)).max() < 1e-9
    assert np.cos(turn).min() > 1 - 1e-9
    derived = states["derived"].to_numpy()
    assert ((derived & 1) == 0).all()
    # A derived speed of vehicles that circle is the displacement along the heading.
    assert (states["speed_mps"] - json_truth["v"]).abs().max() < (1e-9 if "speed" in told else 0.2)
    assert ((derived & 2) == (0 if "speed" in told else 2)).all()
    if "acceleration" in told:
        assert (states["acceleration_mps2"] - json_truth["a"]).abs().max() < 1e-9
        assert ((derived & 4) == 0).all()
    if "size" in told:
        assert states["length_m"].to_list() == json_truth["length"].to_list()
        assert states["width_m"].to_list() == json_truth["width"].to_list()
    else:
        assert states["length_m"].null_count() == states.height


def test_positions_are_exact_where_the_size_is_known(shared_logs: Path, json_truth: pl.DataFrame) -> None:
    for name in ("ros2_odom", "ros1_odom", "osi_gt", "foxglove_scene"):
        states = read_log(shared_logs / f"formats/{name}.mcap").states
        assert (states["x_m"] - json_truth["x"] - 1.35 * json_truth["yaw"].cos()).abs().max() < 1e-9, name
        assert (states["y_m"] - json_truth["y"] - 1.35 * json_truth["yaw"].sin()).abs().max() < 1e-9, name


def test_what_is_told_better_elsewhere_is_not_told_twice(shared_logs: Path) -> None:
    log = read_log(shared_logs / "formats/foxglove_scene.mcap")
    assert {channel.topic: channel.understood_as for channel in log.channels} == {
        "/tf": "foxglove.FrameTransforms",
        "/scene": "foxglove.SceneUpdate",
    }
    assert [bool(channel.reason) for channel in log.channels] == [False, True]
    both = read_log(
        shared_logs / "formats/foxglove_scene.mcap", parse_config('[ingest.topics."/tf"]\nformat = "tf"')
    )
    assert both.states.height == 2 * log.states.height
    assert {problem.code for problem in both.problems} == {"duplicate_time"}


def only(topic: str, shared_logs: Path, config: str = "") -> Any:
    """Read one topic of the file that has a message of every Foxglove kind."""
    path = shared_logs / "formats/fox_all.mcap"
    topics = {m.channel.topic for m in open_log(path).messages()} - {topic}
    ignore = "".join(f'[ingest.topics."{name}"]\nformat = "ignore"\n' for name in sorted(topics))
    centre = '[ingest]\nodometry_reference_point = "box_centre"\n'
    return read_log(path, parse_config(ignore + config + centre))


@pytest.mark.parametrize(
    ("topic", "vehicle", "x_m"),
    [
        ("/poses", "poses/0", 1.0),
        ("/pose", "pose", 1.0),
        ("/scene", "a", 1.0),
        ("/tf", "v", 1.0),
        ("/odom", "odom", 1.0),
        ("/fix", "fix", 0.0),
    ],
)
def test_every_foxglove_kind_is_read(topic: str, vehicle: str, x_m: float, shared_logs: Path) -> None:
    row = only(topic, shared_logs).states.row(0, named=True)
    assert (row["vehicle_id"], row["x_m"], row["time_ns"]) == (vehicle, x_m, 1_700_000_000 * 10**9)
    assert row["heading_rad"] == (None if topic == "/fix" else 0.0)


def test_any_protobuf_message_is_read_by_a_mapping(shared_logs: Path) -> None:
    fields = 'fields]\nvehicle_id = "id"\nx_m = "x"\nspeed_mps = "v"\ntime_ns = "t"\n'
    for topic, items in (("/custom/VehicleState", ""), ("/custom/Snapshot", 'items = "vehicles"\n')):
        own = f'[ingest.topics."{topic}"]\n{items}[ingest.topics."{topic}".{fields}'
        states = only(topic, shared_logs, own).states
        assert states.select("vehicle_id", "x_m", "speed_mps", "time_ns").rows() == [("a", 3.5, 2.0, 1)]
