"""Odometry against the ROS 2 reference decoder, and its odd inputs."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap_ros2._dynamic import serialize_dynamic

from istc_replay.config import parse_config
from istc_replay.ingest.log import read_log
from istc_replay.ingest.meaning import vehicle_of

from ..support.logs import T0_NS, Topic, write_log

DEFINITION = """
std_msgs/Header header
# the frame of the twist
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================
MSG: geometry_msgs/PoseWithCovariance
Pose pose
float64[36] covariance
================
MSG: geometry_msgs/Pose
Point position
Quaternion orientation
================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================
MSG: geometry_msgs/TwistWithCovariance
Twist twist
float64[36] covariance
================
MSG: geometry_msgs/Twist
Vector3 linear
Vector3 angular
================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
BOX = parse_config('[ingest]\nodometry_reference_point = "box_centre"')


@pytest.fixture
def odometry() -> Callable[..., Any]:
    """A function that makes an odometry topic by the reference encoder."""
    encode = serialize_dynamic("nav_msgs/msg/Odometry", DEFINITION)["nav_msgs/msg/Odometry"]

    def make(
        name: str = "/car_1/odom",
        child_frame: str = "car_1/base_link",
        frame: str = "map",
        quaternion: tuple[float, ...] = (0.0, 0.0, math.sin(0.4), math.cos(0.4)),
        **replaced: Any,
    ) -> Any:
        value = {
            "header": {"stamp": {"sec": 12, "nanosec": 345}, "frame_id": frame},
            "child_frame_id": child_frame,
            "pose": {
                "pose": {
                    "position": {"x": 10.0, "y": -4.0, "z": 1.0},
                    "orientation": dict(zip("xyzw", quaternion, strict=True)),
                },
                "covariance": [0.5] * 36,
            },
            "twist": {
                "twist": {
                    "linear": {"x": -3.0, "y": 0.2, "z": 0.0},
                    "angular": {"x": 0.0, "y": 0.0, "z": 0.1},
                },
                "covariance": [0.25] * 36,
            },
        }
        settings = {"schema_data": DEFINITION.encode(), **replaced}
        return Topic(
            name, [(T0_NS, encode(value))], "nav_msgs/msg/Odometry", "ros2msg", encoding="cdr", **settings
        )

    return make


@pytest.mark.parametrize("child_frame", ["a/base_link", "ab/base_link", "abc/base_link", "abcd/base_link"])
def test_odometry_is_read_as_the_reference_encoder_wrote_it(
    child_frame: str, odometry: Any, save: Any
) -> None:
    log = read_log(save(write_log(odometry(child_frame=child_frame))), BOX)
    row = log.states.to_dicts()[0]
    assert log.problems == ()
    assert row["vehicle_id"] == child_frame.split("/")[0]
    assert (row["time_ns"], row["x_m"], row["y_m"], row["speed_mps"]) == (12_000_000_345, 10.0, -4.0, -3.0)
    assert row["heading_rad"] == pytest.approx(0.8)
    assert (row["length_m"], row["acceleration_mps2"], row["role"]) == (None, None, "vehicle")


def test_big_endian_payloads_are_read(odometry: Any, save: Any) -> None:
    little = odometry(child_frame="abc", frame="map")
    data = little.messages[0][1]
    numbers = struct.unpack_from("<85d", data, len(data) - 680)
    head = bytes([0, 0, 0, 0]) + struct.pack(">iII4sI4s", 12, 345, 4, b"map\0", 4, b"abc\0")
    little.messages[0] = (T0_NS, head + bytes(-(len(head) - 4) % 8) + struct.pack(">85d", *numbers))
    row = read_log(save(write_log(little)), BOX).states.to_dicts()[0]
    assert (row["vehicle_id"], row["x_m"], row["speed_mps"]) == ("abc", 10.0, -3.0)


def test_by_default_poses_are_rear_axles(odometry: Any, save: Any) -> None:
    row = read_log(save(write_log(odometry()))).states.to_dicts()[0]
    assert (row["x_m"], row["y_m"]) == pytest.approx(
        (10.0 + 1.35 * math.cos(0.8), -4.0 + 1.35 * math.sin(0.8))
    )
    assert row["rear_axle_to_centre_m"] is None


@pytest.mark.parametrize(
    "quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.5, 0.5), (math.nan, 0.0, 0.0, 1.0)]
)
def test_a_quaternion_that_is_no_rotation_gives_no_heading(
    quaternion: tuple[float, ...], odometry: Any, save: Any
) -> None:
    log = read_log(save(write_log(odometry(quaternion=quaternion))), BOX)
    assert log.states["heading_rad"].to_list() == [None]
    assert [problem.code for problem in log.problems] == ["quaternion"]


@pytest.mark.parametrize(
    ("topic_name", "child_frame", "vehicle"),
    [
        ("/car_1/odom", "car_7/base_link", "car_7"),
        ("/car_1/odom", "/fleet/car_7/base_link", "fleet/car_7"),
        ("/car_1/odom", "car_7", "car_7"),
        ("/car_1/odom", "base_link", "car_1"),
        ("/car_1/localization/odom", "", "car_1"),
        ("/odom", "base_link", "odom"),
    ],
)
def test_the_vehicle_is_named_by_its_frame_else_by_its_topic(
    topic_name: str, child_frame: str, vehicle: str
) -> None:
    assert vehicle_of(topic_name, child_frame) == vehicle


def test_a_configured_vehicle_goes_before_the_frame(odometry: Any, save: Any) -> None:
    config = parse_config('[ingest.topics."/car_1/odom"]\nvehicle_id = "ego"')
    assert read_log(save(write_log(odometry())), config).states["vehicle_id"].to_list() == ["ego"]


def test_several_frames_are_told(odometry: Any, save: Any) -> None:
    other = odometry("/car_2/odom", "car_2/base_link", "car_2/odom")
    log = read_log(save(write_log(odometry(), other)), BOX)
    assert [problem.code for problem in log.problems] == ["frames_differ"]


def test_a_message_is_read_by_the_definition_in_the_file(odometry: Any, save: Any) -> None:
    other = DEFINITION.replace("int32 sec", "uint32 seq\nint32 sec").encode()
    with_seq = odometry(schema_data=other)
    data = with_seq.messages[0][1]
    with_seq.messages[0] = (T0_NS, data[:4] + struct.pack("<I", 7) + data[4:40] + data[44:])
    row = read_log(save(write_log(with_seq)), BOX).states.to_dicts()[0]
    assert (row["time_ns"], row["x_m"], row["speed_mps"]) == (12_000_000_345, 10.0, -3.0)


@pytest.mark.parametrize(
    "text", [b"float64 x\n", b"what is this\n", DEFINITION[:-400].encode(), bytes(2**19)]
)
def test_a_definition_that_lacks_what_is_needed_is_a_problem(text: bytes, odometry: Any, save: Any) -> None:
    log = read_log(save(write_log(odometry(schema_data=text))), BOX)
    assert (log.states.height, log.channels[0].understood_as) == (0, None)
    assert [problem.code for problem in log.problems] == ["schema"]
    assert log.channels[0].reason


def test_a_missing_definition_is_the_known_one(odometry: Any, save: Any) -> None:
    assert read_log(save(write_log(odometry(schema_data=b""))), BOX).states.height == 1


@pytest.mark.parametrize(
    "damage", [b"", b"\0", b"\0\3\0\0" + bytes(800), b"\0\1\0\0" + bytes(100), b"\0\1\0\0" + b"\xff" * 800]
)
def test_a_payload_that_is_no_odometry_is_a_problem(damage: bytes, odometry: Any, save: Any) -> None:
    made = odometry()
    made.messages.append((T0_NS + 1, damage))
    log = read_log(save(write_log(made)), BOX)
    assert log.states.height == 1
    assert [problem.code for problem in log.problems] == ["payload"]
    assert log.problems[0].offset is not None


def test_the_shared_log_is_read_as_by_the_reference_decoder(shared_logs: Path) -> None:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    path = shared_logs / "formats/ros2_odom.mcap"
    states = read_log(path, BOX).states
    with path.open("rb") as stream:
        decoded = [
            m
            for _, _, _, m in make_reader(
                stream, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages()
        ]
    expected = sorted(
        (
            m.child_frame_id.split("/")[0],
            m.header.stamp.sec * 10**9 + m.header.stamp.nanosec,
            m.pose.pose.position.x,
            m.pose.pose.position.y,
            m.twist.twist.linear.x,
        )
        for m in decoded
    )
    assert states.select("vehicle_id", "time_ns", "x_m", "y_m", "speed_mps").rows() == expected
