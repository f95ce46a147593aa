"""Decoding ASAM OSI `GroundTruth` and `SensorView` by the schema that the file embeds.

A nested message that is absent is unknown; a number that is absent within a nested message that
is present is 0, because proto3 writers leave zeros out while the schema they embed is proto2.
"""

from __future__ import annotations

import hashlib
import math
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from istc_replay.datatypes import SceneObstacle
from istc_replay.ingest.batches import Bytes, Ints, distinct
from istc_replay.ingest.layout import Column
from istc_replay.ingest.meaning import ROLES, Roles, whole
from istc_replay.ingest.payload import PayloadError
from istc_replay.ingest.problems import Problems
from istc_replay.ingest.records import Schema
from istc_replay.ingest.scan import Spans
from istc_replay.ingest.scene import SceneParts

#: Longest descriptor that is built [bytes]; OSI's own has 0.8 MB.
_DESCRIPTOR_LIMIT = 4 * 2**20
#: Numbers of enumerations are below this.
_ENUM_LIMIT = 1024
#: Different stationary objects that are read.
_STANDING_LIMIT = 200_000
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
FOREIGN = (AttributeError, KeyError, TypeError, ValueError, OverflowError)


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
    except (DecodeError, *FOREIGN) as error:
        if isinstance(error, PayloadError):
            raise
        reason = " ".join(str(error).split())[:200]
        raise PayloadError(f"the schema does not declare {schema.name!r}: {reason}", "schema") from None


class StandingObjects:
    """Takes the stationary objects of OSI messages into the scene, each as it is first told."""

    def __init__(self, type_: Any, parts: SceneParts, problems: Problems) -> None:
        descriptor = type_.DESCRIPTOR
        if "global_ground_truth" in descriptor.fields_by_name:
            descriptor = descriptor.fields_by_name["global_ground_truth"].message_type
        field = descriptor.fields_by_name.get("stationary_object")
        self._type = None
        if field is not None and field.message_type is not None:
            self._type = message_factory.GetMessageClass(field.message_type)
        self._parts, self._problems = parts, problems
        self._met: set[bytes] = set()

    def read(self, data: Bytes, spans: Spans) -> None:
        """Read the stationary objects in these spans."""
        if self._type is None:
            return
        for start, end in zip(spans.starts.tolist(), spans.ends.tolist(), strict=True):
            raw = data[start:end].tobytes()
            # They are told again in every message.
            digest = hashlib.blake2b(raw, digest_size=16).digest()
            if digest in self._met or len(self._met) >= _STANDING_LIMIT:
                continue
            self._met.add(digest)
            try:
                self._stationary(self._type.FromString(raw))
            except (DecodeError, *FOREIGN) as error:
                reason = " ".join(str(error).split())[:200]
                self._problems.add("scene", f"a stationary object is left out: {reason}")

    def _stationary(self, standing: Any) -> None:
        obstacle_id = str(standing.id.value)
        if obstacle_id in self._parts.obstacles or not standing.HasField("base"):
            return
        base = standing.base
        numbers = (base.position.x, base.position.y, base.orientation.yaw)
        size = (base.dimension.length, base.dimension.width)
        if enum_name(standing.classification, "type") in _NOT_IN_THE_WAY:
            return
        if not all(map(math.isfinite, (*numbers, *size))) or min(size) <= 0.0:
            detail = (
                f"stationary object {obstacle_id} is left out: it needs finite numbers and a size above 0"
            )
            self._problems.add("scene", detail)
            return
        self._parts.obstacles[obstacle_id] = SceneObstacle(obstacle_id, *numbers, *size)


def roles_by_number(type_: Any, items: str) -> Roles:
    """Make the function from the type columns of moving objects to codes of ROLES."""
    descriptor = type_.DESCRIPTOR
    for name in items.split("."):
        descriptor = descriptor.fields_by_name[name].message_type
    kinds = _enum_names(descriptor, "type")
    classification = descriptor.fields_by_name.get("vehicle_classification")
    vehicles = _enum_names(classification.message_type, "type") if classification else {}

    def roles(columns: dict[str, Column], count: int) -> Ints:
        kind, vehicle = whole(columns, "type", count), whole(columns, "vehicle_type", count)
        # Enumerations are small: both fit one number.
        small = np.clip(kind, -1, _ENUM_LIMIT - 1) * _ENUM_LIMIT + np.clip(vehicle, 0, _ENUM_LIMIT - 1)
        pairs, own = distinct(small)
        parts = [divmod(pair, _ENUM_LIMIT) for pair in pairs.tolist()]
        named = [_role(kinds.get(k, ""), vehicles.get(v, "")) for k, v in parts]
        table = np.array([ROLES.index(name) for name in named] or [0], np.int64)
        return table[own]

    return roles


def _enum_names(descriptor: Any, name: str) -> dict[int, str]:
    field = descriptor.fields_by_name.get(name)
    if field is None or field.enum_type is None:
        return {}
    return {number: value.name for number, value in field.enum_type.values_by_number.items()}


def _role(kind: str, vehicle: str) -> str:
    if kind == "TYPE_PEDESTRIAN":
        return "pedestrian"
    if kind != "TYPE_VEHICLE" or vehicle in _OTHER_VEHICLES:
        return "other"
    return "bicycle" if vehicle == "TYPE_BICYCLE" else "vehicle"


def enum_name(source: Any, name: str) -> str:
    """Name of the value of an enumeration's field; empty where its number is unknown."""
    values = source.DESCRIPTOR.fields_by_name[name].enum_type.values_by_number
    number = getattr(source, name)
    return values[number].name if number in values else ""
