"""Reading logs of our own messages: states, scenes, times and configured topics."""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from istc_replay.config import parse_config
from istc_replay.ingest.log import read_log
from istc_replay.messages import message
from istc_replay.states import STATES_SCHEMA

from ..support.logs import T0_NS, Topic, vehicle_state, write_log

STEP_NS = 100_000_000
LATER_NS = T0_NS + 2 * 10**9
FLOATS = [name for name, dtype in STATES_SCHEMA.items() if dtype == pl.Float64()]


def codes(log: Any) -> set[str]:
    return {problem.code for problem in log.problems}


# --- our own messages -----------------------------------------------------------------------------


def test_states_are_read_as_written(
    save: Callable[[bytes], Path],
) -> None:
    values = {
        "x_m": 3.5,
        "y_m": -2.25,
        "heading_rad": 0.5,
        "speed_mps": -1.5,
        "acceleration_mps2": 0.25,
        "steering_rad": 0.125,
        "steering_rate_radps": -0.5,
        "jerk_mps3": 2.0,
        "length_m": 4.5,
        "width_m": 1.75,
        "wheelbase_m": 2.75,
        "rear_axle_to_centre_m": 1.25,
    }
    data = write_log(
        Topic("/b", [(T0_NS + 5, vehicle_state(T0_NS, "b", **values))]),
        Topic(
            "/a",
            [(LATER_NS + 9, vehicle_state(LATER_NS, "a", x_m=1.0)), (T0_NS + 7, vehicle_state(T0_NS, "a"))],
        ),
    )
    path = save(data)
    log = read_log(path)
    assert (log.path, log.sha256) == (str(path), hashlib.sha256(data).hexdigest())
    assert (log.messages, log.chunks, log.start_ns, log.end_ns) == (3, 1, T0_NS + 5, LATER_NS + 9)
    assert log.complete
    assert log.problems == ()
    assert log.states.schema == STATES_SCHEMA
    rows = log.states.to_dicts()
    assert [(row["vehicle_id"], row["time_ns"], row["message_index"]) for row in rows] == [
        ("a", T0_NS, 0),
        ("a", LATER_NS, 1),
        ("b", T0_NS, 0),
    ]
    assert {key: rows[2][key] for key in values} == values
    assert {rows[2][key] for key in ("role", "topic", "derived")} == {"vehicle", "/b", 0}
    assert (rows[2]["log_time_ns"], rows[2]["publish_time_ns"]) == (T0_NS + 5, T0_NS + 6)
    assert rows[0]["heading_rad"] is None
    assert rows[0]["speed_mps"] is None


@pytest.mark.parametrize(
    ("source", "expected"), [("header", T0_NS), ("log", T0_NS + 50), ("publish", T0_NS + 51)]
)
def test_the_time_source_is_the_configured_one(source: str, expected: int, save: Any) -> None:
    path = save(write_log(Topic("/a", [(T0_NS + 50, vehicle_state(T0_NS))])))
    log = read_log(path, parse_config(f'[ingest]\ntime_source = "{source}"'))
    assert log.states["time_ns"].to_list() == [expected]
    assert log.time_source == source


def test_numbers_that_are_not_finite_become_null_and_are_told(save: Any) -> None:
    state = vehicle_state(
        T0_NS, x_m=math.nan, y_m=1.0, heading_rad=math.inf, speed_mps=-math.inf, length_m=math.nan
    )
    log = read_log(save(write_log(Topic("/a", [(T0_NS, state)]))))
    row = log.states.to_dicts()[0]
    assert [row[key] for key in ("x_m", "y_m", "heading_rad", "speed_mps", "length_m")] == [
        None,
        1.0,
        None,
        None,
        None,
    ]
    assert [problem.code for problem in log.problems] == ["not_finite"] * 4
    assert log.states.select(pl.col(FLOATS).is_nan().any()).sum_horizontal()[0] == 0


def test_times_beyond_int64_leave_their_state_out(save: Any) -> None:
    data = write_log(Topic("/a", [(T0_NS, vehicle_state(T0_NS)), (T0_NS + 1, vehicle_state(T0_NS + 1))]))
    data = data.replace(struct.pack("<QQ", T0_NS + 1, T0_NS + 2), struct.pack("<QQ", 2**64 - 1, T0_NS + 2))
    data = _without_checksums(data)
    log = read_log(save(data))
    assert log.states["time_ns"].to_list() == [T0_NS]
    assert "time_overflow" in codes(log)
    assert log.end_ns == T0_NS


def _without_checksums(data: bytes) -> bytes:
    # The first record after the header is the chunk; its CRC stands after three 8-byte fields.
    header_end = 8 + 9 + struct.unpack_from("<Q", data, 9)[0]
    crc = header_end + 9 + 24
    return data[:crc] + bytes(4) + data[crc + 4 :]


def test_backward_and_repeated_times_are_kept_and_told(save: Any) -> None:
    stamps = [0, 2, 1, 1, 3]
    states = [(T0_NS + k, vehicle_state(T0_NS + stamp, x_m=float(k))) for k, stamp in enumerate(stamps)]
    log = read_log(save(write_log(Topic("/a", states))))
    assert log.states["x_m"].to_list() == [0.0, 2.0, 3.0, 1.0, 4.0]
    assert {problem.code: problem.detail for problem in log.problems} == {
        "backward_time": "1 states on '/a' go back in time, first in its message 2",
        "duplicate_time": "1 states on '/a' repeat a time of their vehicle, first in its message 3",
    }


def test_a_missing_speed_is_derived_and_marked(save: Any) -> None:
    def state(k: int, **values: float) -> tuple[int, bytes]:
        time = T0_NS + k * STEP_NS
        return time, vehicle_state(time, x_m=-0.1 * k * k, y_m=7.0, **values)

    states = [state(k, heading_rad=math.pi) for k in range(4)] + [
        state(4, heading_rad=math.pi, speed_mps=9.0)
    ]
    states += [state(5), state(40, heading_rad=math.pi)]
    table = read_log(save(write_log(Topic("/a", states)))).states
    # Central differences of 0.1 k^2 along -x, one-sided at the start; a step above 1 s gives none.
    assert table["speed_mps"][:5].to_list() == pytest.approx([1.0, 2.0, 4.0, 6.0, 9.0])
    assert table["speed_mps"][5:].to_list() == [None, None]
    # The acceleration is the same difference of the speeds, where the speeds on both sides are known.
    assert table["acceleration_mps2"][:4].to_list() == pytest.approx([10.0, 15.0, 20.0, 25.0])
    assert table["acceleration_mps2"][4:].null_count() == 3
    assert table["derived"].to_list() == [6, 6, 6, 6, 0, 0, 0]


def test_planned_states_of_a_result_are_not_recorded_ones(save: Any) -> None:
    data = write_log(
        Topic("/istc/planned/1", [(T0_NS, vehicle_state(window=0))]), Topic("/r", [(T0_NS, vehicle_state())])
    )
    log = read_log(save(data))
    assert log.states["topic"].to_list() == ["/r"]
    assert codes(log) == {"planned_states"}


def test_a_state_without_vehicle_is_left_out(save: Any) -> None:
    states = [(T0_NS, vehicle_state(vehicle_id="")), (T0_NS + 1, vehicle_state(vehicle_id="v" * 257))]
    log = read_log(save(write_log(Topic("/a", states))))
    assert log.states.height == 0
    assert codes(log) == {"no_vehicle_id"}


def test_scenes_are_merged_and_their_faults_told(save: Any) -> None:
    scene = message("Scene")()
    line = scene.lane_lines.add(lane_id="w", vehicle_id="1")
    for x in (0.0, 5.0, 9.0):
        line.points.add(x_m=x, y_m=-1.0)
    scene.lane_lines.add(lane_id="short").points.add(x_m=1.0)
    scene.obstacles.add(obstacle_id="block", x_m=1.0, y_m=2.0, heading_rad=0.5, length_m=3.0, width_m=2.0)
    scene.obstacles.add(obstacle_id="flat", length_m=1.0)
    scene.vehicles.add(vehicle_id="1", priority=0.2).dimensions.length_m = 4.0
    scene.vehicles[0].dimensions.width_m = 2.0
    scene.vehicles.add(vehicle_id="2", priority=-1.0)
    later = message("Scene")()
    later.bounds.x_max_m = later.bounds.y_max_m = 50.0
    later.obstacles.add(obstacle_id="block", x_m=7.0, length_m=3.0, width_m=2.0)
    messages = [(T0_NS, scene.SerializeToString()), (T0_NS + 1, later.SerializeToString())]
    log = read_log(save(write_log(Topic("/any", messages, schema="istc.v1.Scene"))))
    read = log.scene
    assert [(line.lane_id, line.vehicle_id, line.points_m.tolist()) for line in read.lane_lines] == [
        ("w", "1", [[0.0, -1.0], [5.0, -1.0], [9.0, -1.0]])
    ]
    assert [(box.obstacle_id, box.x_m, box.length_m) for box in read.obstacles] == [("block", 7.0, 3.0)]
    assert read.bounds is not None
    assert (read.bounds.x_min_m, read.bounds.x_max_m) == (0.0, 50.0)
    one, two = read.vehicles
    assert one.dimensions is not None
    assert (one.priority, one.dimensions.wheelbase_m, one.dimensions.rear_axle_to_centre_m) == pytest.approx(
        (0.2, 2.7, 1.35)
    )
    assert (two.priority, two.dimensions) == (None, None)
    assert [problem.code for problem in log.problems] == ["scene"] * 3
    assert log.channels[0].understood_as == "istc.v1.Scene"


# --- channels and configuration -----------------------------------------------------------------


def test_channels_that_are_not_understood_are_listed(one_vehicle: Any, save: Any) -> None:
    camera = Topic("/camera", [(T0_NS, b"\0")], "foxglove.CompressedImage")
    text = Topic("/text", [(T0_NS, b"{}")], "", "", b"", "json")
    log = read_log(save(write_log(one_vehicle, camera, text)))
    assert [(c.topic, c.schema, c.message_encoding, c.messages, c.understood_as) for c in log.channels] == [
        ("/camera", "foxglove.CompressedImage", "protobuf", 1, None),
        ("/text", "", "json", 1, None),
        ("/vehicles/1", "istc.v1.VehicleState", "protobuf", 10, "istc.v1.VehicleState"),
    ]
    assert log.states.height == 10
    assert log.problems == ()
    assert codes(read_log(save(write_log(camera)))) == {"nothing_understood"}
    assert codes(read_log(save(write_log()))) == {"no_channels"}


def test_topics_are_read_as_configured(one_vehicle: Any, save: Any) -> None:
    foreign = Topic("/foreign", one_vehicle.messages, "acme.State")
    text = Topic("/text", [(T0_NS, b"{}")], "", "", b"", "json")
    path = save(write_log(one_vehicle, foreign, text))
    config = parse_config(
        """
        [ingest.topics."/vehicles/1"]
        format = "ignore"
        [ingest.topics."/foreign"]
        format = "istc"
        vehicle_id = "x"
        reference_point = "rear_axle"
        [ingest.topics."/text"]
        format = "osi"
        [ingest.topics."/missing"]
        format = "osi"
        """
    )
    log = read_log(path, config)
    assert log.states["vehicle_id"].unique().to_list() == ["x"]
    assert [channel.understood_as for channel in log.channels] == ["istc.v1.VehicleState", None, None]
    # The rear axle of a vehicle of 4 m, by the defaults: half of 0.675 * 4 m behind the centre.
    assert log.states["x_m"][0] == pytest.approx(1.35)
    assert codes(log) == {"unknown_topic", "not_as_configured"}


def test_a_rear_axle_is_moved_by_the_best_known_distance(save: Any) -> None:
    sizes: dict[str, dict[str, float]] = {
        "own": {"length_m": 5.0, "wheelbase_m": 3.0, "rear_axle_to_centre_m": 1.1},
        "wheelbase": {"length_m": 5.0, "wheelbase_m": 3.0},
        "length": {"length_m": 8.0},
        "configured": {"rear_axle_to_centre_m": 1.1},
        "nothing": {},
        "turned": {"rear_axle_to_centre_m": 2.0},
        "blind": {},
    }
    heading = {"turned": {"heading_rad": math.pi / 2}, "blind": {}}
    states = [
        (T0_NS, vehicle_state(T0_NS, name, **size, **heading.get(name, {"heading_rad": 0.0})))
        for name, size in sizes.items()
    ]
    config = parse_config(
        """
        [ingest.topics."/a"]
        reference_point = "rear_axle"
        [vehicles.by_id.configured]
        wheelbase_m = 3.4
        """
    )
    log = read_log(save(write_log(Topic("/a", states))), config)
    moved = {row["vehicle_id"]: (row["x_m"], row["y_m"]) for row in log.states.to_dicts()}
    expected = {"own": 1.1, "wheelbase": 1.5, "length": 2.7, "configured": 1.7, "nothing": 1.35}
    assert {name: moved[name][0] for name in expected} == pytest.approx(expected)
    assert moved["turned"] == pytest.approx((0.0, 2.0))
    assert moved["blind"] == (None, None)
    assert codes(log) == {"no_heading"}


def test_base_link_is_moved_by_the_configured_distance(one_vehicle: Any, save: Any) -> None:
    path = save(write_log(one_vehicle))
    config = parse_config(
        '[ingest.topics."/vehicles/1"]\nreference_point = "base_link"\nbase_link_to_centre_m = 0.75'
    )
    assert read_log(path, config).states["x_m"][0] == pytest.approx(0.75)
    config = parse_config(
        '[ingest]\nbase_link_to_centre_m = 0.5\n[ingest.topics."/vehicles/1"]\nreference_point = "base_link"'
    )
    assert read_log(path, config).states["x_m"][0] == pytest.approx(0.5)
