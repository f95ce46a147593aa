"""Foxglove's messages, made by its own Python package, and one truth told by each of them."""

from __future__ import annotations

import math
from typing import Any

import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap_protobuf.schema import build_file_descriptor_set

from istc_replay.config import parse_config
from istc_replay.ingest.log import read_log

from ..support.logs import T0_NS, Topic, write_log

STEP_NS = 100_000_000
CENTRE = '[ingest]\nodometry_reference_point = "box_centre"\n'
#: Two vehicles: a drives along 30 degrees at 10 m/s, b stands and comes a second later.
HEADING = math.radians(30.0)


def place(vehicle: str, k: int) -> tuple[float, float, float]:
    if vehicle == "b":
        return 5.0, -3.0, -2.0
    return k * math.cos(HEADING), k * math.sin(HEADING), HEADING


def fill(position: Any, rotation: Any, vehicle: str, k: int) -> None:
    position.x, position.y, heading = place(vehicle, k)
    rotation.z, rotation.w = math.sin(heading / 2), math.cos(heading / 2)


def present(k: int) -> list[str]:
    return ["a", "b"] if k >= 10 else ["a"]


def transforms(k: int) -> FrameTransforms:
    message = FrameTransforms()
    for vehicle in present(k):
        one = message.transforms.add(parent_frame_id="map", child_frame_id=f"{vehicle}/base_link")
        one.timestamp.FromNanoseconds(T0_NS + k * STEP_NS)
        fill(one.translation, one.rotation, vehicle, k)
    return message


def poses(k: int) -> PosesInFrame:
    message = PosesInFrame(frame_id="map")
    message.timestamp.FromNanoseconds(T0_NS + k * STEP_NS)
    for vehicle in present(k):
        pose = message.poses.add()
        fill(pose.position, pose.orientation, vehicle, k)
    return message


def scene(k: int) -> SceneUpdate:
    message = SceneUpdate()
    for vehicle in present(k):
        entity = message.entities.add(id=vehicle, frame_id="map")
        entity.timestamp.FromNanoseconds(T0_NS + k * STEP_NS)
        cube = entity.cubes.add()
        fill(cube.pose.position, cube.pose.orientation, vehicle, k)
        cube.size.x, cube.size.y = 4.5, 1.8
    message.entities.add(id="text without a cube")
    return message


def one(kind: Any, vehicle: str, k: int) -> Any:
    message = kind(frame_id="map")
    message.timestamp.FromNanoseconds(T0_NS + k * STEP_NS)
    fill(message.pose.position, message.pose.orientation, vehicle, k)
    if kind is Odometry:
        message.body_frame_id = f"{vehicle}/base_link"
        message.linear_velocity.x = 10.0 if vehicle == "a" else 0.0
    return message


def transform(vehicle: str, k: int) -> FrameTransform:
    return next(t for t in transforms(k).transforms if t.child_frame_id.startswith(vehicle))


def topics(name: str, messages: list[tuple[int, Any]]) -> Any:
    kind = type(messages[0][1])
    data = build_file_descriptor_set(kind).SerializeToString()
    payloads = [(T0_NS + k * STEP_NS, message.SerializeToString()) for k, message in messages]
    return Topic(name, payloads, kind.DESCRIPTOR.full_name, "protobuf", data)


WHEN = {"a": range(20), "b": range(10, 20)}
KINDS = {
    "FrameTransforms": lambda: [topics("/tf", [(k, transforms(k)) for k in range(20)])],
    "FrameTransform": lambda: [
        topics(f"/tf_{v}", [(k, transform(v, k)) for k in own]) for v, own in WHEN.items()
    ],
    "PosesInFrame": lambda: [topics("/fleet", [(k, poses(k)) for k in range(20)])],
    "PoseInFrame": lambda: [
        topics(f"/{v}/pose", [(k, one(PoseInFrame, v, k)) for k in own]) for v, own in WHEN.items()
    ],
    "SceneUpdate": lambda: [topics("/scene", [(k, scene(k)) for k in range(20)])],
    "Odometry": lambda: [
        topics(f"/{v}/odom", [(k, one(Odometry, v, k)) for k in own]) for v, own in WHEN.items()
    ],
}
NAMES = {"PosesInFrame": {"fleet/0": "a", "fleet/1": "b"}}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_tells_the_same_truth(kind: str, save: Any) -> None:
    log = read_log(save(write_log(*KINDS[kind]())), parse_config(CENTRE))
    assert log.problems == ()
    names = NAMES.get(kind, {"a": "a", "b": "b"})
    assert log.states.height == 30
    for row in log.states.to_dicts():
        vehicle, k = names[row["vehicle_id"]], (row["time_ns"] - T0_NS) // STEP_NS
        told = (row["x_m"], row["y_m"], row["heading_rad"])
        assert told == pytest.approx(place(vehicle, k), abs=1e-12)
        assert row["speed_mps"] == pytest.approx(10.0 if vehicle == "a" else 0.0, abs=1e-6)
        assert bool(row["derived"] & 2) == (kind != "Odometry")
        assert row["length_m"] == (4.5 if kind == "SceneUpdate" else None)
    first = log.states.group_by("vehicle_id").agg(time=log.states["time_ns"].implode().list.min())
    assert first.height == 2


def test_several_formats_of_one_log_are_told_once(save: Any) -> None:
    made = [*KINDS["FrameTransforms"](), *KINDS["Odometry"](), *KINDS["SceneUpdate"]()]
    log = read_log(save(write_log(*made)), parse_config(CENTRE))
    assert log.states.height == 30
    assert log.states["topic"].unique().sort().to_list() == ["/a/odom", "/b/odom"]
    assert {c.topic for c in log.channels if c.reason} == {"/tf", "/scene"}


def test_any_protobuf_message_is_read_by_a_mapping_of_its_fields(save: Any) -> None:
    config = parse_config(
        '[ingest.topics."/scene"]\nitems = "entities"\n[ingest.topics."/scene".fields]\n'
        'vehicle_id = "id"\ntime = "timestamp"\nposition = "cubes.0.pose.position"\n'
        'orientation = "cubes.0.pose.orientation"\nlength_m = "cubes.0.size.x"\n'
    )
    log = read_log(save(write_log(*KINDS["SceneUpdate"]())), config)
    told = log.states.filter(log.states["x_m"].is_not_null())
    assert told.height == 30
    assert told["length_m"].unique().to_list() == [4.5]
    assert log.channels[0].understood_as == "fields of foxglove.SceneUpdate"
