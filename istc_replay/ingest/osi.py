"""Decoding ASAM OSI `GroundTruth` and `SensorView` by the schema that the file embeds.

A nested message that is absent is unknown; a number that is absent within a nested message that
is present is 0, because proto3 writers leave zeros out while the schema they embed is proto2.
"""

from __future__ import annotations

import math
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from istc_replay.datatypes import SceneObstacle
from istc_replay.ingest.columns import PayloadError, State
from istc_replay.ingest.problems import Problems
from istc_replay.ingest.records import Schema
from istc_replay.ingest.scene import SceneParts
from istc_replay.units import NS_PER_S

#: Longest descriptor that is built [bytes]; OSI's own has 0.8 MB.
_DESCRIPTOR_LIMIT = 4 * 2**20
#: Standing objects that one drives under or over.
_NOT_IN_THE_WAY = {"TYPE_BRIDGE", "TYPE_OVERHEAD_STRUCTURE"}
#: Vehicles that do not move like a car: they are obstacles, not planned.
_OTHER_VEHICLES = {
    "TYPE_SEMITRAILER",
    "TYPE_TRAILER",
    "TYPE_TRAIN",
    "TYPE_TRAM",
    "TYPE_WHEELCHAIR",
    "TYPE_STANDUP_SCOOTER",
}
#: What reading fields that a foreign descriptor declares otherwise can raise.
_FOREIGN = (AttributeError, KeyError, TypeError, ValueError, OverflowError)


def message_type(schema: Schema) -> Any:
    """Build the message class that a protobuf schema declares.

    Raises
    ------
    PayloadError
        If the schema is not a FileDescriptorSet that declares the message it is named after.
    """
    if len(schema.data) > _DESCRIPTOR_LIMIT:
        raise PayloadError(f"a schema of {len(schema.data)} bytes is not built", "schema")
    try:
        files = {file.name: file for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file}
        pool = descriptor_pool.DescriptorPool()
        while files:
            # Files may stand in any order, but a pool takes them after what they import.
            ready = [file for file in files.values() if not any(name in files for name in file.dependency)]
            if not ready:
                raise PayloadError("the files of the schema import each other in a circle", "schema")
            for file in ready:
                pool.Add(files.pop(file.name))
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    except (DecodeError, *_FOREIGN) as error:
        if isinstance(error, PayloadError):
            raise
        reason = " ".join(str(error).split())[:200]
        raise PayloadError(f"the schema does not declare {schema.name!r}: {reason}", "schema") from None


class OsiReader:
    """Reads `osi3.GroundTruth`, or the one inside `osi3.SensorView`."""

    def __init__(self, schema: Schema, parts: SceneParts, problems: Problems) -> None:
        self._type = message_type(schema)
        self._in_view = "global_ground_truth" in self._type.DESCRIPTOR.fields_by_name
        self._parts = parts
        self._problems = problems

    def states(self, data: bytes) -> list[State]:
        """Decode one payload: the states of its moving objects."""
        try:
            truth = self._type.FromString(data)
            header_ns = _time_ns(truth)
            if self._in_view:
                truth = truth.global_ground_truth
                header_ns = _time_ns(truth) if truth.HasField("timestamp") else header_ns
            for obstacle in truth.stationary_object:
                self._stationary(obstacle)
            found = [_state(moving, header_ns) for moving in truth.moving_object]
        except (DecodeError, *_FOREIGN) as error:
            reason = " ".join(str(error).split())[:200]
            raise PayloadError(f"not an {self._type.DESCRIPTOR.full_name}: {reason}") from None
        return found

    def _stationary(self, standing: Any) -> None:
        obstacle_id = str(standing.id.value)
        if obstacle_id in self._parts.obstacles or not standing.HasField("base"):
            return
        base = standing.base
        numbers = (base.position.x, base.position.y, base.orientation.yaw)
        size = (base.dimension.length, base.dimension.width)
        if _enum_name(standing.classification, "type") in _NOT_IN_THE_WAY:
            return
        if not all(map(math.isfinite, (*numbers, *size))) or min(size) <= 0.0:
            detail = (
                f"stationary object {obstacle_id} is left out: it needs finite numbers and a size above 0"
            )
            self._problems.add("scene", detail)
            return
        self._parts.obstacles[obstacle_id] = SceneObstacle(obstacle_id, *numbers, *size)


def _state(moving: Any, header_ns: int | None) -> State:
    base = moving.base
    heading_rad = base.orientation.yaw if base.HasField("orientation") else None
    length_m = width_m = x_m = y_m = None
    if base.HasField("position"):
        x_m, y_m = base.position.x, base.position.y
    if base.HasField("dimension"):
        length_m, width_m = base.dimension.length or None, base.dimension.width or None
    wheelbase_m, rear_axle_to_centre_m = _axles(moving)
    return State(
        str(moving.id.value) if moving.HasField("id") else "",
        header_ns,
        _role(moving),
        x_m,
        y_m,
        heading_rad,
        _along(base, "velocity", heading_rad),
        _along(base, "acceleration", heading_rad),
        length_m=length_m,
        width_m=width_m,
        wheelbase_m=wheelbase_m,
        rear_axle_to_centre_m=rear_axle_to_centre_m,
    )


def _along(base: Any, name: str, heading_rad: float | None) -> float | None:
    """Component along the heading of a vector of the world frame."""
    if heading_rad is None or not math.isfinite(heading_rad) or not base.HasField(name):
        return None
    vector = getattr(base, name)
    return float(vector.x * math.cos(heading_rad) + vector.y * math.sin(heading_rad))


def _axles(moving: Any) -> tuple[float | None, float | None]:
    """Wheelbase and distance from the rear axle to the box centre; 0 is how writers leave them unset."""
    if not moving.HasField("vehicle_attributes"):
        return None, None
    attributes = moving.vehicle_attributes
    rear_m, front_m = attributes.bbcenter_to_rear.x, attributes.bbcenter_to_front.x
    return (front_m - rear_m if rear_m and front_m else None), (-rear_m if rear_m else None)


def _role(moving: Any) -> str:
    kind, vehicle = _enum_name(moving, "type"), _enum_name(moving.vehicle_classification, "type")
    if kind == "TYPE_PEDESTRIAN":
        return "pedestrian"
    if kind != "TYPE_VEHICLE" or vehicle in _OTHER_VEHICLES:
        return "other"
    return "bicycle" if vehicle == "TYPE_BICYCLE" else "vehicle"


def _enum_name(source: Any, name: str) -> str:
    values = source.DESCRIPTOR.fields_by_name[name].enum_type.values_by_number
    number = getattr(source, name)
    return values[number].name if number in values else ""


def _time_ns(source: Any) -> int | None:
    if not source.HasField("timestamp"):
        return None
    return int(source.timestamp.seconds) * NS_PER_S + int(source.timestamp.nanos)
