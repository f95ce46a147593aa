"""OSI logs: read by the schema in the file, with or without proto2 presence."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from google.protobuf import descriptor_pb2

from istc_replay.config import parse_config
from istc_replay.ingest.log import read_log
from istc_replay.ingest.osi import message_type
from istc_replay.ingest.payload import PayloadError
from istc_replay.ingest.records import Schema

from ..support.logs import T0_NS, Topic, write_log


@pytest.fixture
def truth(osi: Any) -> Any:
    """A GroundTruth at 3.5 s with one car that drives backwards, turned by 0.5 rad."""
    truth = osi("GroundTruth")()
    truth.timestamp.seconds, truth.timestamp.nanos = 3, 500_000_000
    car = truth.moving_object.add()
    car.id.value = 2**63
    car.base.position.x, car.base.position.y = 8.0, 9.0
    car.base.orientation.yaw = 0.5 + 4 * math.pi
    car.base.velocity.x, car.base.velocity.y = -2 * math.cos(0.5), -2 * math.sin(0.5)
    car.base.acceleration.x, car.base.acceleration.y = -math.sin(0.5), math.cos(0.5)
    car.base.dimension.length, car.base.dimension.width = 5.0, 1.8
    car.type = car.Type.TYPE_VEHICLE
    car.vehicle_attributes.bbcenter_to_rear.x = -1.4
    car.vehicle_attributes.bbcenter_to_front.x = 1.6
    return truth


@pytest.fixture
def read(save: Any, osi_descriptor: bytes) -> Callable[..., Any]:
    """A function that logs one payload as OSI and reads it."""

    def as_log(payload: bytes, name: str = "osi3.GroundTruth", config: str = "") -> Any:
        made = Topic("osi", [(T0_NS, payload)], name, schema_data=osi_descriptor)
        return read_log(save(write_log(made)), parse_config(config))

    return as_log


def test_a_moving_object_is_a_state(truth: Any, read: Any) -> None:
    log = read(truth.SerializeToString())
    row = log.states.to_dicts()[0]
    assert log.problems == ()
    assert (row["vehicle_id"], row["time_ns"], row["role"]) == (str(2**63), 3_500_000_000, "vehicle")
    assert (row["x_m"], row["y_m"], row["length_m"], row["width_m"]) == (8.0, 9.0, 5.0, 1.8)
    # Along the heading: negative when reversing, and nothing of the acceleration across.
    assert (row["heading_rad"], row["speed_mps"]) == pytest.approx((0.5, -2.0))
    assert row["acceleration_mps2"] == pytest.approx(0.0, abs=1e-12)
    assert (row["wheelbase_m"], row["rear_axle_to_centre_m"]) == pytest.approx((3.0, 1.4))
    assert row["steering_rad"] is None


def test_what_an_object_does_not_tell_is_null(truth: Any, read: Any) -> None:
    car = truth.moving_object[0]
    for name in ("orientation", "dimension", "acceleration"):
        car.base.ClearField(name)
    car.vehicle_attributes.ClearField("bbcenter_to_rear")
    row = read(truth.SerializeToString()).states.to_dicts()[0]
    assert row["x_m"] == 8.0
    names = (
        "heading_rad",
        "speed_mps",
        "acceleration_mps2",
        "length_m",
        "wheelbase_m",
        "rear_axle_to_centre_m",
    )
    assert [row[name] for name in names] == [None] * len(names)


def test_zeros_that_a_proto3_writer_leaves_out_are_zeros(truth: Any, read: Any) -> None:
    car = truth.moving_object[0]
    car.id.ClearField("value")
    car.base.orientation.ClearField("yaw")
    car.base.acceleration.Clear()
    car.base.acceleration.SetInParent()
    car.base.position.ClearField("x")
    row = read(truth.SerializeToString()).states.to_dicts()[0]
    assert (row["vehicle_id"], row["heading_rad"], row["acceleration_mps2"], row["x_m"]) == (
        "0",
        0.0,
        0.0,
        0.0,
    )


def test_a_missing_stamp_gives_way_to_the_log_time_and_is_told(truth: Any, read: Any) -> None:
    truth.ClearField("timestamp")
    log = read(truth.SerializeToString())
    assert log.states["time_ns"].to_list() == [T0_NS]
    assert [problem.code for problem in log.problems] == ["no_header_time"]
    truth.timestamp.seconds = 2**62
    log = read(truth.SerializeToString())
    assert log.states.height == 0
    assert [problem.code for problem in log.problems] == ["time_overflow"]


def test_objects_have_roles(truth: Any, read: Any) -> None:
    kinds = [
        ("VEHICLE", "BICYCLE"),
        ("VEHICLE", "BUS"),
        ("VEHICLE", "TRAM"),
        ("PEDESTRIAN", None),
        ("ANIMAL", None),
    ]
    for index, (kind, vehicle) in enumerate(kinds):
        other = truth.moving_object.add()
        other.id.value = index
        other.type = other.Type.Value(f"TYPE_{kind}")
        if vehicle:
            classification = other.vehicle_classification
            classification.type = classification.Type.Value(f"TYPE_{vehicle}")
    roles = dict(read(truth.SerializeToString()).states.select("vehicle_id", "role").rows())
    assert [roles[str(index)] for index in range(5)] == ["bicycle", "vehicle", "other", "pedestrian", "other"]


def test_a_sensor_view_is_read_for_its_ground_truth(truth: Any, osi: Any, read: Any) -> None:
    view = osi("SensorView")()
    view.timestamp.seconds = 77
    view.global_ground_truth.CopyFrom(truth)
    log = read(view.SerializeToString(), "osi3.SensorView")
    assert log.states["time_ns"].to_list() == [3_500_000_000]
    assert log.channels[0].understood_as == "osi3.SensorView"
    view.global_ground_truth.ClearField("timestamp")
    assert read(view.SerializeToString(), "osi3.SensorView").states["time_ns"].to_list() == [77_000_000_000]


def test_standing_objects_are_obstacles_of_the_scene(truth: Any, read: Any) -> None:
    for index, (kind, length) in enumerate([("BUILDING", 6.0), ("OVERHEAD_STRUCTURE", 6.0), ("POLE", 0.0)]):
        standing = truth.stationary_object.add()
        standing.id.value = index
        standing.base.position.x, standing.base.orientation.yaw = 30.0, 0.25
        standing.base.dimension.length, standing.base.dimension.width = length, 4.0
        classification = standing.classification
        classification.type = classification.Type.Value(f"TYPE_{kind}")
    log = read(truth.SerializeToString())
    (box,) = log.scene.obstacles
    assert (box.obstacle_id, box.x_m, box.heading_rad, box.length_m, box.width_m) == (
        "0",
        30.0,
        0.25,
        6.0,
        4.0,
    )
    assert [problem.code for problem in log.problems] == ["scene"]


def test_rear_axle_positions_are_moved_where_the_configuration_says_so(truth: Any, read: Any) -> None:
    log = read(truth.SerializeToString(), config='[ingest.topics.osi]\nreference_point = "rear_axle"')
    moved = (8.0 + 1.4 * math.cos(0.5), 9.0 + 1.4 * math.sin(0.5))
    assert log.states.select("x_m", "y_m").row(0) == pytest.approx(moved)


def test_a_payload_that_is_too_long_is_not_decoded(read: Any) -> None:
    log = read(b"\x2a\x00" * (2**21 + 1))
    assert [problem.code for problem in log.problems] == ["payload"]


def test_schemas_that_cannot_serve_are_refused(osi_descriptor: bytes) -> None:
    circle = descriptor_pb2.FileDescriptorSet()
    circle.file.add(name="a.proto", dependency=["b.proto"])
    circle.file.add(name="b.proto", dependency=["a.proto"])
    twice = descriptor_pb2.FileDescriptorSet()
    twice.file.add(name="a.proto", package="osi3").message_type.add(name="GroundTruth").field.add(
        name="x", number=-1
    )
    for data in (
        b"",
        b"\xff",
        circle.SerializeToString(),
        twice.SerializeToString(),
        osi_descriptor[:-100],
        bytes(2**23),
    ):
        with pytest.raises(PayloadError):
            message_type(Schema("osi3.GroundTruth", "protobuf", data))


def test_files_of_a_schema_may_stand_in_any_order(osi_descriptor: bytes) -> None:
    files = descriptor_pb2.FileDescriptorSet.FromString(osi_descriptor)
    turned = descriptor_pb2.FileDescriptorSet(file=reversed(files.file))
    built = message_type(Schema("osi3.GroundTruth", "protobuf", turned.SerializeToString()))
    assert built.DESCRIPTOR.full_name == "osi3.GroundTruth"


def test_a_foreign_message_of_the_same_name_is_a_problem(save: Any) -> None:
    foreign = descriptor_pb2.FileDescriptorSet()
    kind = foreign.file.add(name="a.proto", package="osi3").message_type.add(name="GroundTruth")
    kind.field.add(name="moving_object", number=5, type=5, label=1)
    made = Topic("osi", [(T0_NS, b"\x28\x01")], "osi3.GroundTruth", schema_data=foreign.SerializeToString())
    log = read_log(save(write_log(made)))
    assert (log.states.height, log.channels[0].understood_as) == (0, None)
    assert [problem.code for problem in log.problems] == ["schema"]
