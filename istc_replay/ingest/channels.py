"""Recognising what a channel holds, from its schema and encodings or from the configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from istc_replay.config import IngestConfig
from istc_replay.ingest.records import Channel

ReferencePoint = Literal["box_centre", "rear_axle", "base_link"]


@dataclass(frozen=True, slots=True)
class Format:
    """A kind of message that is read; `family` is its name in the configuration."""

    name: str
    family: Literal["istc", "osi", "odometry"]
    message_encoding: str
    schema_encoding: str

    def fits(self, channel: Channel) -> bool:
        """Tell whether the channel is encoded as this format is."""
        schema_encoding = channel.schema.encoding if channel.schema else ""
        return channel.message_encoding == self.message_encoding and schema_encoding == self.schema_encoding


FORMATS = (
    Format("istc.v1.VehicleState", "istc", "protobuf", "protobuf"),
    Format("istc.v1.Scene", "istc", "protobuf", "protobuf"),
    Format("osi3.GroundTruth", "osi", "protobuf", "protobuf"),
    Format("osi3.SensorView", "osi", "protobuf", "protobuf"),
    Format("nav_msgs/msg/Odometry", "odometry", "cdr", "ros2msg"),
)


def recognise(channel: Channel, config: IngestConfig) -> Format | None:
    """Tell the format of a channel; None where it is not read.

    A format that the configuration gives to the topic goes before the schema's name, but what is
    encoded otherwise can still not be read as it.
    """
    topic = config.topics.get(channel.topic)
    family = topic.format if topic else None
    name = channel.schema.name if channel.schema else ""
    known = [format_ for format_ in FORMATS if format_.fits(channel)]
    for format_ in known:
        if format_.name == name and family in (None, format_.family):
            return format_
    # A foreign name for a known format: the first of the family that the configuration names.
    return next((format_ for format_ in known if format_.family == family), None)


def reference_point(topic: str, format_: Format, config: IngestConfig) -> ReferencePoint:
    """Tell which point of the vehicle the positions of a topic name."""
    own = config.topics.get(topic)
    if own and own.reference_point:
        return own.reference_point
    return config.odometry_reference_point if format_.family == "odometry" else "box_centre"


def base_link_to_centre_m(topic: str, config: IngestConfig) -> float:
    """Tell the distance from a topic's base_link forward to the box centre [m]."""
    own = config.topics.get(topic)
    if own and own.base_link_to_centre_m is not None:
        return own.base_link_to_centre_m
    return config.base_link_to_centre_m
