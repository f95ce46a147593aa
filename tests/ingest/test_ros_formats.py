"""ROS messages beyond Odometry, encoded by rosbags: poses, transforms, Autoware's objects, ROS 1."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from istc_replay.config import parse_config
from istc_replay.ingest.log import read_log

from ..support.logs import T0_NS, Topic, write_log

STEP_NS = 100_000_000
BOX = parse_config('[ingest]\nodometry_reference_point = "box_centre"')
AUTOWARE = {
    "autoware_perception_msgs/msg/ObjectClassification": "uint8 CAR=1\nuint8 label\nfloat32 probability",
    "autoware_perception_msgs/msg/Shape": (
        "uint8 type\ngeometry_msgs/Polygon footprint\ngeometry_msgs/Vector3 dimensions"
    ),
    "autoware_perception_msgs/msg/PredictedObjectKinematics": (
        "geometry_msgs/PoseWithCovariance initial_pose_with_covariance\n"
        "geometry_msgs/TwistWithCovariance initial_twist_with_covariance\n"
        "geometry_msgs/AccelWithCovariance initial_acceleration_with_covariance\n"
        "geometry_msgs/Pose[] predicted_paths"
    ),
    "autoware_perception_msgs/msg/PredictedObject": (
        "unique_identifier_msgs/UUID object_id\nfloat32 existence_probability\n"
        "autoware_perception_msgs/ObjectClassification[] classification\n"
        "autoware_perception_msgs/PredictedObjectKinematics kinematics\nautoware_perception_msgs/Shape shape"
    ),
    "autoware_perception_msgs/msg/PredictedObjects": (
        "std_msgs/Header header\nautoware_perception_msgs/PredictedObject[] objects"
    ),
}


@pytest.fixture(scope="module")
def ros2() -> Any:
    """ROS 2's types and Autoware's, as rosbags builds them."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in AUTOWARE.items():
        store.register(get_types_from_msg(text, name))
    return store


def stamp(store: Any, time_ns: int) -> Any:
    return store.types["builtin_interfaces/msg/Time"](time_ns // 10**9, time_ns % 10**9)


def pose(store: Any, x: float, y: float, yaw: float) -> Any:
    turned = store.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    return store.types["geometry_msgs/msg/Pose"](store.types["geometry_msgs/msg/Point"](x, y, 0.0), turned)


def header(store: Any, time_ns: int, frame: str) -> Any:
    return store.types["std_msgs/msg/Header"](stamp(store, time_ns), frame)


@pytest.fixture
def ros_topic(ros2: Any) -> Callable[..., Any]:
    """A function that makes a topic of ROS 2 messages, one every 0.1 s."""

    def make(name: str, kind: str, messages: list[Any], start: int = 0) -> Any:
        data = [bytes(ros2.serialize_cdr(message, kind)) for message in messages]
        text, _ = ros2.generate_msgdef(kind, ros_version=2)
        times = [T0_NS + (start + k) * STEP_NS for k in range(len(data))]
        pairs = list(zip(times, data, strict=True))
        return Topic(name, pairs, kind, "ros2msg", text.encode(), "cdr")

    return make


def transforms(store: Any, time_ns: int, *edges: tuple[str, str, float, float, float]) -> Any:
    made = []
    for parent, child, x, y, yaw in edges:
        placed = pose(store, x, y, yaw)
        moved = store.types["geometry_msgs/msg/Vector3"](x, y, 0.0)
        transform = store.types["geometry_msgs/msg/Transform"](moved, placed.orientation)
        kind = store.types["geometry_msgs/msg/TransformStamped"]
        made.append(kind(header(store, time_ns, parent), child, transform))
    return store.types["tf2_msgs/msg/TFMessage"](made)


def test_poses_are_of_their_topics_vehicle(ros_topic: Any, ros2: Any, save: Any) -> None:
    kind = ros2.types["geometry_msgs/msg/PoseStamped"]
    messages = [
        kind(header(ros2, T0_NS + k * STEP_NS, "map"), pose(ros2, 0.5 * k, 3.0, 0.0)) for k in range(5)
    ]
    log = read_log(save(write_log(ros_topic("/car_4/pose", "geometry_msgs/msg/PoseStamped", messages))), BOX)
    assert log.problems == ()
    assert log.states["vehicle_id"].unique().to_list() == ["car_4"]
    assert log.states["x_m"].to_list() == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0])
    assert log.states["speed_mps"].to_list() == pytest.approx([5.0] * 5)
    assert log.states["derived"].to_list() == [2 | 4] * 5


def test_transforms_alone_tell_the_vehicles_in_the_root_frame(ros_topic: Any, ros2: Any, save: Any) -> None:
    # The odometry frame is turned by 90 degrees and moved; a sensor on the car is no vehicle.
    messages = [
        transforms(
            ros2,
            T0_NS + k * STEP_NS,
            ("map", "a/odom", 10.0, 0.0, math.pi / 2),
            ("a/odom", "a/base_link", 1.0 * k, 2.0, 0.0),
            ("a/base_link", "a/lidar", 0.5, 0.0, 0.0),
        )
        for k in range(4)
    ]
    log = read_log(save(write_log(ros_topic("/tf", "tf2_msgs/msg/TFMessage", messages))), BOX)
    assert log.problems == ()
    assert log.states["vehicle_id"].to_list() == ["a"] * 4
    assert log.states["x_m"].to_list() == pytest.approx([8.0] * 4)
    assert log.states["y_m"].to_list() == pytest.approx([0.0, 1.0, 2.0, 3.0])
    assert log.states["heading_rad"].to_list() == pytest.approx([math.pi / 2] * 4)


def test_states_move_into_the_root_frame_by_transforms_between_their_times(
    ros_topic: Any, ros2: Any, save: Any
) -> None:
    kind = ros2.types["geometry_msgs/msg/PoseStamped"]
    poses = [kind(header(ros2, T0_NS + STEP_NS // 2, "odom"), pose(ros2, 1.0, 0.0, 0.0))]
    tf = [transforms(ros2, T0_NS + k * STEP_NS, ("map", "odom", 10.0 * k, 5.0, 0.2 * k)) for k in range(2)]
    path = save(
        write_log(
            ros_topic("/car/pose", "geometry_msgs/msg/PoseStamped", poses),
            ros_topic("/tf", "tf2_msgs/msg/TFMessage", tf),
        )
    )
    row = read_log(path, BOX).states.row(0, named=True)
    assert (row["vehicle_id"], row["heading_rad"]) == ("car", pytest.approx(0.1))
    assert (row["x_m"], row["y_m"]) == pytest.approx((5.0 + math.cos(0.1), 5.0 + math.sin(0.1)))


def test_a_circle_of_transforms_is_no_trap(ros_topic: Any, ros2: Any, save: Any) -> None:
    messages = [transforms(ros2, T0_NS, ("a", "b", 1.0, 0.0, 0.0), ("b", "a", 1.0, 0.0, 0.0))]
    log = read_log(save(write_log(ros_topic("/tf", "tf2_msgs/msg/TFMessage", messages))))
    assert log.states.height == 0


def predicted(store: Any, k: int, count: int) -> Any:
    types = store.types
    covariance = np.zeros(36)
    objects = []
    for index in range(count):
        vector = types["geometry_msgs/msg/Vector3"]
        zero, along = vector(0.0, 0.0, 0.0), vector(3.0, 0.0, 0.0)
        twist = types["geometry_msgs/msg/Twist"](along, zero)
        accel = types["geometry_msgs/msg/Accel"](vector(0.5, 0.0, 0.0), zero)
        placed = pose(store, 3.0 * k, float(index), 0.0)
        path = [placed] * (1 + (k + index) % 3)
        kinematics = types["autoware_perception_msgs/msg/PredictedObjectKinematics"](
            types["geometry_msgs/msg/PoseWithCovariance"](placed, covariance),
            types["geometry_msgs/msg/TwistWithCovariance"](twist, covariance),
            types["geometry_msgs/msg/AccelWithCovariance"](accel, covariance),
            path,
        )
        label = types["autoware_perception_msgs/msg/ObjectClassification"]
        corners = [types["geometry_msgs/msg/Point32"](0.0, 0.0, 0.0)] * (index % 2 * 4)
        shape = types["autoware_perception_msgs/msg/Shape"](
            0, types["geometry_msgs/msg/Polygon"](corners), vector(4.5, 1.8, 1.5)
        )
        uuid = types["unique_identifier_msgs/msg/UUID"](np.full(16, 16 + index, np.uint8))
        classes = [label(0, 0.1), label((1, 7, 6, 4)[index % 4], 0.8)]
        objects.append(
            types["autoware_perception_msgs/msg/PredictedObject"](uuid, 0.9, classes, kinematics, shape)
        )
    head = header(store, T0_NS + k * STEP_NS, "map")
    return types["autoware_perception_msgs/msg/PredictedObjects"](head, objects)


def test_predicted_objects_that_come_and_go_are_read(ros_topic: Any, ros2: Any, save: Any) -> None:
    counts = [4, 0, 3, 1, 4, 2]
    messages = [predicted(ros2, k, count) for k, count in enumerate(counts)]
    name = "autoware_perception_msgs/msg/PredictedObjects"
    log = read_log(save(write_log(ros_topic("/objects", name, messages))))
    assert log.problems == ()
    states = log.states
    assert states.height == sum(counts)
    first = states.filter(states["vehicle_id"] == "10101010-1010-1010-1010-101010101010")
    assert first["x_m"].to_list() == [3.0 * k for k, count in enumerate(counts) if count > 0]
    assert states["acceleration_mps2"].unique().to_list() == [0.5]
    assert set(states.select("speed_mps", "length_m", "width_m").rows()) == {(3.0, 4.5, 1.8)}
    roles = dict(states.select("y_m", "role").unique().rows())
    assert roles == {0.0: "vehicle", 1.0: "pedestrian", 2.0: "bicycle", 3.0: "other"}


def test_ros_1_transforms_are_read(save: Any) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(
        get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
    )
    types = store.types
    turned = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    messages = []
    for k in range(3):
        time_ns = T0_NS + k * STEP_NS
        head = types["std_msgs/msg/Header"](
            k, types["builtin_interfaces/msg/Time"](time_ns // 10**9, time_ns % 10**9), "world"
        )
        transform = types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](2.0 * k, 1.0, 0.0), turned
        )
        stamped = types["geometry_msgs/msg/TransformStamped"](head, "car_2/base_link", transform)
        message = types["tf2_msgs/msg/TFMessage"]([stamped])
        messages.append((time_ns, bytes(store.serialize_ros1(message, "tf2_msgs/msg/TFMessage"))))
    text, _ = store.generate_msgdef("tf2_msgs/msg/TFMessage")
    made = Topic("/tf", messages, "tf2_msgs/TFMessage", "ros1msg", text.encode(), "ros1")
    log = read_log(save(write_log(made)), BOX)
    assert log.problems == ()
    assert log.states.select("vehicle_id", "x_m", "y_m").rows() == [("car_2", 2.0 * k, 1.0) for k in range(3)]


def test_ros_1_odometry_is_read(save: Any) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    messages = []
    for k in range(5):
        time_ns = T0_NS + k * STEP_NS
        stamp = types["builtin_interfaces/msg/Time"](time_ns // 10**9, time_ns % 10**9)
        turned = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(0.2), math.cos(0.2))
        pose = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](1.0 * k, 2.0, 0.0), turned)
        zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.1)
        twist = types["geometry_msgs/msg/Twist"](types["geometry_msgs/msg/Vector3"](7.5, 0.0, 0.0), zero)
        message = types["nav_msgs/msg/Odometry"](
            types["std_msgs/msg/Header"](k, stamp, "map"),
            "car_9/base_link",
            types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
            types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
        )
        messages.append((time_ns + 3, bytes(store.serialize_ros1(message, "nav_msgs/msg/Odometry"))))
    text, _ = store.generate_msgdef("nav_msgs/msg/Odometry")
    made = Topic("/odom", messages, "nav_msgs/Odometry", "ros1msg", text.encode(), "ros1")
    path = save(write_log(made))
    states = read_log(path, BOX).states
    assert states.select("vehicle_id", "time_ns", "x_m", "y_m", "speed_mps").rows() == [
        ("car_9", T0_NS + k * STEP_NS, 1.0 * k, 2.0, 7.5) for k in range(5)
    ]
    assert states["heading_rad"].to_list() == pytest.approx([0.4] * 5, abs=1e-12)
    mapped = parse_config(
        '[ingest.topics."/odom".fields]\nvehicle_id = "child_frame_id"\ntime = "header.stamp"\n'
        'position = "pose.pose.position"\norientation = "pose.pose.orientation"\n'
        'speed_mps = "twist.twist.linear.x"\n'
    )
    by_fields = read_log(path, mapped).states
    same = ("time_ns", "x_m", "y_m", "heading_rad", "speed_mps")
    assert by_fields.select(same).equals(states.select(same))
    assert by_fields["vehicle_id"].unique().to_list() == ["car_9/base_link"]
