"""Readers of channels: a decoder and the meaning of what it gives, for every format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from istc_replay.ingest.batches import Bytes, Ints
from istc_replay.ingest.channels import Format
from istc_replay.ingest.definition import parse_definition
from istc_replay.ingest.json_text import JsonDecoder
from istc_replay.ingest.layout import Column, Decoded, take
from istc_replay.ingest.meaning import ROLES, Meaning, Names, number, whole
from istc_replay.ingest.odometry import DEFINITION
from istc_replay.ingest.osi import StandingObjects, message_type, roles_by_number
from istc_replay.ingest.osi_lanes import Lanes
from istc_replay.ingest.payload import Budget, PayloadError
from istc_replay.ingest.places import LocalFrame
from istc_replay.ingest.problems import Problems
from istc_replay.ingest.protobuf import ProtobufDecoder
from istc_replay.ingest.records import Schema
from istc_replay.ingest.ros import ros_decoder
from istc_replay.ingest.scene import SceneParts
from istc_replay.messages import message

#: Autoware's ObjectClassification labels, in the order of their numbers.
_AUTOWARE_ROLES = ("other", "vehicle", "vehicle", "vehicle", "other", "vehicle", "bicycle", "pedestrian")
_SIZES = ("length_m", "width_m")


class PayloadDecoder(Protocol):
    """Decodes many payloads at once."""

    def decode(self, data: Bytes, starts: Ints, ends: Ints) -> Decoded:
        """Decode the payloads in these spans of data, which goes on for 32 bytes after the last."""


@dataclass(slots=True)
class Reader:
    """Reads the payloads of all channels of one schema."""

    decoder: PayloadDecoder
    meaning: Meaning
    prepare: Callable[[Decoded], Decoded] | None = None

    def decode(self, data: Bytes, starts: Ints, ends: Ints) -> Decoded:
        """Decode payloads, and make of their columns what the meaning needs."""
        decoded = self.decoder.decode(data, starts, ends)
        return decoded if self.prepare is None else self.prepare(decoded)


class Readers:
    """Makes readers for one log."""

    def __init__(self, problems: Problems, names: Names, parts: SceneParts, budget: Budget) -> None:
        self._budget = budget
        self._problems, self._names, self._parts = problems, names, parts
        self._places = LocalFrame(problems)

    def make(self, format_: Format, schema: Schema | None) -> Reader:
        """Make the reader of a format and a schema.

        Raises
        ------
        PayloadError
            If the schema cannot be used, or lacks what the format needs.
        """
        meaning = Meaning(self._problems, self._names, places=self._places.metres)
        if format_.message_encoding == "json":
            return Reader(JsonDecoder(format_.mapping), meaning)
        if schema is None:
            raise PayloadError("it needs a schema", "schema")
        if format_.family == "istc":
            meaning.zero_is_unset, meaning.roles = _SIZES, _told_roles
            return Reader(
                ProtobufDecoder(message("VehicleState"), format_.mapping, self._budget),
                meaning,
                self._recorded,
            )
        if format_.message_encoding == "protobuf":
            type_ = message_type(schema)
            decoder = ProtobufDecoder(type_, format_.mapping, self._budget)
            if format_.family == "osi":
                meaning.zero_is_unset, meaning.roles = _SIZES, roles_by_number(type_, format_.mapping.items)
                decoder.watch("stationary_object", StandingObjects(type_, self._parts, self._problems).read)
                for name, take_in in Lanes(type_, self._parts, self._problems).watched().items():
                    decoder.watch(name, take_in)
                return Reader(decoder, meaning, _osi)
            if format_.family == "scene_update":
                meaning.zero_is_unset = _SIZES
                return Reader(decoder, meaning, _placed)
            return Reader(decoder, meaning)
        return self._ros(format_, schema, meaning)

    def _ros(self, format_: Format, schema: Schema, meaning: Meaning) -> Reader:
        ros1 = format_.message_encoding == "ros1"
        text = schema.data.strip()
        if not text and format_.name == "nav_msgs/msg/Odometry":
            text = DEFINITION  # some recorders leave it out
        decoder = ros_decoder(parse_definition(text, ros1), format_.mapping, ros1, self._budget)
        if format_.family != "autoware":
            return Reader(decoder, meaning)
        meaning.zero_is_unset, meaning.roles = _SIZES, _autoware_roles
        return Reader(decoder, meaning, self._autoware)

    def _recorded(self, decoded: Decoded) -> Decoded:
        """Leave planned states out: a result is a log as well."""
        window = decoded.columns.get("window")
        if window is None or (window.valid is not None and not window.valid.any()):
            return decoded
        self._problems.add("planned_states", "planned states of a result are not recorded ones: left out")
        none = np.zeros(0, np.int64)
        return _only(decoded, none if window.valid is None else np.flatnonzero(~window.valid))

    def _autoware(self, decoded: Decoded) -> Decoded:
        known = whole(decoded.columns, "orientation_availability", len(decoded.rows))
        doubtful = int((known == 1).sum())
        if doubtful:
            detail = "an object's heading has an unknown sign (orientation_availability 1); taken as it is"
            self._problems.add("heading_sign", detail, times=doubtful)
        if not (known == 0).any():
            return decoded
        # Unavailable: the quaternion says nothing.
        columns = dict(decoded.columns)
        for axis in "xyzw":
            column = columns[f"orientation.{axis}"]
            columns[f"orientation.{axis}"] = column._replace(valid=known != 0)
        return replace(decoded, columns=columns)


def _only(decoded: Decoded, index: Ints) -> Decoded:
    columns = {name: take(column, index) for name, column in decoded.columns.items()}
    return replace(decoded, rows=decoded.rows[index], columns=columns)


def _placed(decoded: Decoded) -> Decoded:
    """Leave out the entities of a scene that have no cube: they are no vehicles."""
    column = decoded.columns.get("position.x")
    if column is None or column.valid is None:
        return decoded
    return _only(decoded, np.flatnonzero(column.valid))


def _osi(decoded: Decoded) -> Decoded:
    """Axles from the vectors to them, where 0 is how writers leave them unset; a view's own time."""
    columns, count = dict(decoded.columns), len(decoded.rows)
    rear, told = number(columns, "rear.x", count)
    front, _ = number(columns, "front.x", count)
    has_rear = told & (rear != 0.0)
    columns["rear_axle_to_centre_m"] = Column(-rear, has_rear)
    columns["wheelbase_m"] = Column(front - rear, has_rear & (front != 0.0))
    for unit in ("seconds", "nanos"):
        view, own = columns.get(f"view_time.{unit}"), columns.get(f"time.{unit}")
        if view is None:
            continue
        if own is None:
            columns[f"time.{unit}"] = view
        elif own.valid is not None:
            values = np.where(own.valid, own.values, view.values)
            valid = None if view.valid is None else own.valid | view.valid
            columns[f"time.{unit}"] = Column(values, valid)
    return replace(decoded, columns=columns)


def _told_roles(columns: dict[str, Column], count: int) -> Ints:
    """Role that the message names; a vehicle where it names none, other where it is not known."""
    column = columns.get("role")
    if column is None or column.texts is None:
        return np.zeros(count, np.int64)
    codes = [ROLES.index(text) if text in ROLES else len(ROLES) - 1 for text in column.texts]
    codes = [0 if not text else code for text, code in zip(column.texts, codes, strict=True)]
    roles: Ints = np.array(codes or [0], np.int64)[column.values]
    return roles


def _autoware_roles(columns: dict[str, Column], count: int) -> Ints:
    """Role of the most probable class."""
    best = np.full(count, -1.0)
    label = np.full(count, len(_AUTOWARE_ROLES), np.int64)
    for index in range(4):
        probability, told = number(columns, f"class_{index}.probability", count)
        better = told & (probability > best)
        best = np.where(better, probability, best)
        label = np.where(better, whole(columns, f"class_{index}.label", count), label)
    roles = [ROLES.index(role) for role in (*_AUTOWARE_ROLES, "other")]
    return np.array(roles, np.int64)[np.clip(label, 0, len(_AUTOWARE_ROLES))]
