"""Sample logs as ASAM OSI: one osi3.GroundTruth an instant, by the rules of OSI trace files in MCAP.

The schema embedded here is the part of OSI that is written: its names, numbers and types are
OSI's, so that any OSI reader takes the messages.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cache
from typing import IO, Any

import google.protobuf
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer

from istc_replay.datatypes import SceneObstacle
from istc_replay.units import NS_PER_S

_OSI_VERSION = (3, 8, 0)
_HEIGHT_M = 1.5  # of a car; no state tells it
_DECIMALS = 8  # one less than the states have, which these values are computed from

#: Messages by their path within osi3: fields as name, number, type. A type that starts with a
#: capital is a message or enumeration of osi3; [] marks a repeated field.
_MESSAGES = {
    "InterfaceVersion": ("version_major 1 uint32", "version_minor 2 uint32", "version_patch 3 uint32"),
    "Timestamp": ("seconds 1 int64", "nanos 2 uint32"),
    "Identifier": ("value 1 uint64",),
    "Vector3d": ("x 1 double", "y 2 double", "z 3 double"),
    "Dimension3d": ("length 1 double", "width 2 double", "height 3 double"),
    "Orientation3d": ("roll 1 double", "pitch 2 double", "yaw 3 double"),
    "BaseMoving": (
        "dimension 1 Dimension3d",
        "position 2 Vector3d",
        "orientation 3 Orientation3d",
        "velocity 4 Vector3d",
        "acceleration 5 Vector3d",
        "orientation_rate 6 Orientation3d",
    ),
    "BaseStationary": ("dimension 1 Dimension3d", "position 2 Vector3d", "orientation 3 Orientation3d"),
    "StationaryObject": (
        "id 1 Identifier",
        "base 2 BaseStationary",
        "classification 3 StationaryObject.Classification",
    ),
    "StationaryObject.Classification": ("type 1 StationaryObject.Classification.Type",),
    "MovingObject": (
        "id 1 Identifier",
        "base 2 BaseMoving",
        "type 3 MovingObject.Type",
        "vehicle_attributes 5 MovingObject.VehicleAttributes",
        "vehicle_classification 6 MovingObject.VehicleClassification",
    ),
    "MovingObject.VehicleAttributes": ("bbcenter_to_rear 4 Vector3d", "bbcenter_to_front 5 Vector3d"),
    "MovingObject.VehicleClassification": ("type 1 MovingObject.VehicleClassification.Type",),
    "GroundTruth": (
        "version 1 InterfaceVersion",
        "timestamp 2 Timestamp",
        "stationary_object 4 StationaryObject[]",
        "moving_object 5 MovingObject[]",
    ),
}
_ENUMS = {
    "StationaryObject.Classification.Type": {"TYPE_UNKNOWN": 0, "TYPE_OTHER": 1},
    "MovingObject.Type": {"TYPE_UNKNOWN": 0, "TYPE_OTHER": 1, "TYPE_VEHICLE": 2},
    "MovingObject.VehicleClassification.Type": {"TYPE_UNKNOWN": 0, "TYPE_OTHER": 1, "TYPE_MEDIUM_CAR": 4},
}


def write_osi(
    instants: Iterable[tuple[int, list[dict[str, Any]]]],
    obstacles: Sequence[SceneObstacle],
    stream: IO[bytes],
) -> None:
    """Write the states of each instant, with all obstacles, as one GroundTruth on `/ground_truth`.

    Positions, velocities and accelerations are those of the box centre, in the map frame. OSI
    numbers its objects: a vehicle whose id is no number is numbered in the order of appearance.

    Parameters
    ----------
    instants : iterable of (int, list of dict)
        Time [ns] and that instant's rows of the states table.
    obstacles : sequence of SceneObstacle
        What stands in the way.
    stream : IO
        Takes the file's bytes.
    """
    writer = Writer(stream)
    writer.start(profile="", library="istc-replay")
    channel = _open_trace(writer)
    numbers: dict[str, int] = {}
    for index, (time_ns, rows) in enumerate(instants):
        if index == 0:
            numbers = _object_numbers([row["vehicle_id"] for row in rows])
        truth = _ground_truth(time_ns, rows, numbers)
        for number, obstacle in enumerate(obstacles, start=max(numbers.values()) + 1):
            _add_obstacle(truth, number, obstacle)
        writer.add_message(channel, time_ns, truth.SerializeToString(deterministic=True), time_ns, index)
    writer.finish()


def _open_trace(writer: Writer) -> int:
    """Write the trace's metadata and schema; return its channel."""
    osi, protobuf = ".".join(map(str, _OSI_VERSION)), google.protobuf.__version__
    versions = {f"{end}_osi_version": osi for end in ("min", "max")}
    versions |= {f"{end}_protobuf_version": protobuf for end in ("min", "max")}
    writer.add_metadata("net.asam.osi.trace", {"version": osi, **versions})
    schemas = descriptor_pb2.FileDescriptorSet(file=[_file()]).SerializeToString(deterministic=True)
    schema = writer.register_schema("osi3.GroundTruth", "protobuf", schemas)
    prefix = "net.asam.osi.trace.channel"
    metadata = {f"{prefix}.osi_version": osi, f"{prefix}.protobuf_version": protobuf}
    return int(writer.register_channel("/ground_truth", "protobuf", schema, metadata))


def _object_numbers(vehicle_ids: list[str]) -> dict[str, int]:
    numbers = {vehicle: int(vehicle) for vehicle in vehicle_ids if vehicle.isascii() and vehicle.isdigit()}
    # Room is left for the numbers of obstacles, which follow.
    if len(set(numbers.values())) == len(vehicle_ids) and max(numbers.values()) < 2**63:
        return numbers
    return {vehicle: number for number, vehicle in enumerate(vehicle_ids, start=1)}


def _ground_truth(time_ns: int, rows: list[dict[str, Any]], numbers: dict[str, int]) -> Any:
    seconds, nanos = divmod(time_ns, NS_PER_S)
    major, minor, patch = _OSI_VERSION
    message = _ground_truth_class()(
        version={"version_major": major, "version_minor": minor, "version_patch": patch},
        timestamp={"seconds": seconds, "nanos": nanos},
    )
    for row in rows:
        message.moving_object.add(
            id={"value": numbers[row["vehicle_id"]]},
            base=_base(row),
            type="TYPE_VEHICLE",
            vehicle_attributes={
                "bbcenter_to_rear": _vector(-row["rear_axle_to_centre_m"], 0.0, 0.0),
                "bbcenter_to_front": _vector(row["wheelbase_m"] - row["rear_axle_to_centre_m"], 0.0, 0.0),
            },
            vehicle_classification={"type": "TYPE_MEDIUM_CAR"},
        )
    return message


def _add_obstacle(truth: Any, number: int, obstacle: SceneObstacle) -> None:
    truth.stationary_object.add(
        id={"value": number},
        base={
            "dimension": {"length": obstacle.length_m, "width": obstacle.width_m, "height": _HEIGHT_M},
            "position": {"x": obstacle.x_m, "y": obstacle.y_m, "z": _HEIGHT_M / 2},
            "orientation": {"roll": 0.0, "pitch": 0.0, "yaw": obstacle.heading_rad},
        },
        classification={"type": "TYPE_OTHER"},
    )


def _base(row: dict[str, Any]) -> dict[str, Any]:
    """The motion of the box centre, which the turning carries sideways about the rear axle."""
    heading, speed, ahead = row["heading_rad"], row["speed_mps"], row["rear_axle_to_centre_m"]
    tangent = math.tan(row["steering_rad"])
    turning = speed * tangent / row["wheelbase_m"]
    steering = row["steering_rate_radps"] * (1.0 + tangent**2)
    spin = (row["acceleration_mps2"] * tangent + speed * steering) / row["wheelbase_m"]
    c, s = math.cos(heading), math.sin(heading)

    def in_map(along: float, across: float) -> dict[str, float]:
        return _vector(c * along - s * across, s * along + c * across, 0.0)

    return {
        "dimension": {"length": row["length_m"], "width": row["width_m"], "height": _HEIGHT_M},
        "position": {"x": row["x_m"], "y": row["y_m"], "z": _HEIGHT_M / 2},
        "orientation": {"roll": 0.0, "pitch": 0.0, "yaw": heading},
        "velocity": in_map(speed, ahead * turning),
        "acceleration": in_map(row["acceleration_mps2"] - ahead * turning**2, speed * turning + ahead * spin),
        "orientation_rate": {"roll": 0.0, "pitch": 0.0, "yaw": round(turning, _DECIMALS) + 0.0},
    }


def _vector(x: float, y: float, z: float) -> dict[str, float]:
    # Adding zero turns -0.0 into 0.0.
    return {axis: round(value, _DECIMALS) + 0.0 for axis, value in zip("xyz", (x, y, z), strict=True)}


# --- the schema ------------------------------------------------------------------------------


@cache
def _ground_truth_class() -> Any:
    pool = descriptor_pool.DescriptorPool()
    pool.Add(_file())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("osi3.GroundTruth"))


def _file() -> Any:
    """The FileDescriptorProto of all `_MESSAGES` and `_ENUMS`."""
    file = descriptor_pb2.FileDescriptorProto(
        name="osi3/osi_groundtruth.proto", package="osi3", syntax="proto2"
    )
    made: dict[str, Any] = {"": file}
    for path, fields in _MESSAGES.items():
        parent, _, name = path.rpartition(".")
        nested = made[parent].nested_type if parent else file.message_type
        made[path] = nested.add(name=name)
        for field in fields:
            _add_field(made[path], *field.split())
    for path, values in _ENUMS.items():
        parent, _, name = path.rpartition(".")
        enum = made[parent].enum_type.add(name=name)
        for value, number in values.items():
            enum.value.add(name=value, number=number)
    return file


def _add_field(message: Any, name: str, number: str, type_name: str) -> None:
    kinds = descriptor_pb2.FieldDescriptorProto
    field = message.field.add(name=name, number=int(number))
    field.label = kinds.LABEL_REPEATED if type_name.endswith("[]") else kinds.LABEL_OPTIONAL
    type_name = type_name.removesuffix("[]")
    if type_name[0].islower():
        field.type = kinds.Type.Value(f"TYPE_{type_name.upper()}")
        return
    field.type = kinds.TYPE_ENUM if type_name in _ENUMS else kinds.TYPE_MESSAGE
    field.type_name = f".osi3.{type_name}"
