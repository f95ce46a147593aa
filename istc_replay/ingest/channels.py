"""Recognising what a channel holds, from its schema and encodings or from the configuration."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from istc_replay.config import IngestConfig
from istc_replay.ingest.records import Channel
from istc_replay.ingest.wanted import Mapping

ReferencePoint = Literal["box_centre", "rear_axle", "base_link"]
Family = Literal["istc", "osi", "odometry", "pose", "tf", "autoware", "scene_update", "location", "fields"]


def _xy(target: str, path: str) -> dict[str, str]:
    """The two axes of a vector: nothing is read of the third."""
    return {f"{target}.{axis}": f"{path}.{axis}" for axis in "xy"}


_STAMPED = {"time": "header.stamp", "frame": "header.frame_id"}
_FOXGLOVE = {"time": "timestamp", "frame": "frame_id"}
_OPTIONAL = frozenset({"acceleration_mps2", "length_m", "width_m", "steering_rad", "heading_deg", "velocity"})

VEHICLE_STATE = Mapping(
    {
        name: name
        for name in (
            "time_ns",
            "vehicle_id",
            "x_m",
            "y_m",
            "heading_rad",
            "speed_mps",
            "acceleration_mps2",
            "steering_rad",
            "steering_rate_radps",
            "jerk_mps3",
        )
    }
    | {name: f"dimensions.{name}" for name in ("length_m", "width_m", "wheelbase_m", "rear_axle_to_centre_m")}
    | {"window": "window", "role": "role"},
    optional=frozenset({"role"}),
)
_OSI = {
    "vehicle_id": "id.value",
    **_xy("position", "base.position"),
    "heading_rad": "base.orientation.yaw",
    **_xy("velocity", "base.velocity"),
    **_xy("acceleration", "base.acceleration"),
    "length_m": "base.dimension.length",
    "width_m": "base.dimension.width",
    "rear.x": "vehicle_attributes.bbcenter_to_rear.x",
    "front.x": "vehicle_attributes.bbcenter_to_front.x",
    "type": "type",
    "vehicle_type": "vehicle_classification.type",
}
_OSI_OPTIONAL = frozenset(_OSI) - {"vehicle_id", "position.x", "position.y"} | {"time", "view_time"}
GROUND_TRUTH = Mapping({**_OSI, "time": "/timestamp"}, "moving_object", True, _OSI_OPTIONAL)
SENSOR_VIEW = Mapping(
    {**_OSI, "view_time": "/timestamp", "time": "/global_ground_truth.timestamp"},
    "global_ground_truth.moving_object",
    True,
    _OSI_OPTIONAL,
)
ODOMETRY = Mapping(
    {
        **_STAMPED,
        "vehicle_frame": "child_frame_id",
        **_xy("position", "pose.pose.position"),
        "orientation": "pose.pose.orientation",
        "speed_mps": "twist.twist.linear.x",
    }
)
_POSE = Mapping({**_STAMPED, **_xy("position", "pose.position"), "orientation": "pose.orientation"})
_TF = Mapping(
    {
        **_STAMPED,
        "vehicle_frame": "child_frame_id",
        **_xy("position", "transform.translation"),
        "orientation": "transform.rotation",
    },
    "transforms",
)


def _autoware(pose: str, twist: str, acceleration: str) -> Mapping:
    kinematics = {
        **_xy("position", f"kinematics.{pose}.pose.position"),
        "orientation": f"kinematics.{pose}.pose.orientation",
        "speed_mps": f"kinematics.{twist}.twist.linear.x",
        "acceleration_mps2": f"kinematics.{acceleration}.accel.linear.x",
        "orientation_availability": "kinematics.orientation_availability",
    }
    labels = {f"class_{index}": f"classification.{index}" for index in range(4)}
    fields = {
        "time": "/header.stamp",
        "frame": "/header.frame_id",
        "vehicle_id": "object_id",
        "length_m": "shape.dimensions.x",
        "width_m": "shape.dimensions.y",
        **kinematics,
        **labels,
    }
    return Mapping(fields, "objects", optional=_OPTIONAL | {"orientation_availability"})


_TRACKED = _autoware("pose_with_covariance", "twist_with_covariance", "acceleration_with_covariance")
_PREDICTED = _autoware(
    "initial_pose_with_covariance", "initial_twist_with_covariance", "initial_acceleration_with_covariance"
)
_FOXGLOVE_TF = {
    "time": "timestamp",
    "frame": "parent_frame_id",
    "vehicle_frame": "child_frame_id",
    **_xy("position", "translation"),
    "orientation": "rotation",
}
_FOXGLOVE_POSE = {**_xy("position", "pose.position"), "orientation": "pose.orientation"}
_SCENE_UPDATE = Mapping(
    {
        **_FOXGLOVE,
        "vehicle_id": "id",
        **_xy("position", "cubes.0.pose.position"),
        "orientation": "cubes.0.pose.orientation",
        "length_m": "cubes.0.size.x",
        "width_m": "cubes.0.size.y",
    },
    "entities",
)
_FOXGLOVE_ODOMETRY = Mapping(
    {**_FOXGLOVE, **_FOXGLOVE_POSE, "vehicle_frame": "body_frame_id", "speed_mps": "linear_velocity.x"}
)
_LOCATION = Mapping(
    {"time": "timestamp", "latitude": "latitude", "longitude": "longitude"}, optional=frozenset({"time"})
)


@dataclass(frozen=True, slots=True)
class Format:
    """A kind of message that is read; `family` is its name in the configuration."""

    name: str
    family: Family
    message_encoding: str
    schema_encoding: str
    mapping: Mapping = field(default=Mapping({}))
    many: bool = False  # tells of several vehicles

    def fits(self, channel: Channel) -> bool:
        """Tell whether the channel is encoded as this format is."""
        schema_encoding = channel.schema.encoding if channel.schema else ""
        return channel.message_encoding == self.message_encoding and schema_encoding == self.schema_encoding


FORMATS = (
    Format("istc.v1.VehicleState", "istc", "protobuf", "protobuf", VEHICLE_STATE),
    Format("istc.v1.Scene", "istc", "protobuf", "protobuf"),
    Format("osi3.GroundTruth", "osi", "protobuf", "protobuf", GROUND_TRUTH, many=True),
    Format("osi3.SensorView", "osi", "protobuf", "protobuf", SENSOR_VIEW, many=True),
    Format("nav_msgs/msg/Odometry", "odometry", "cdr", "ros2msg", ODOMETRY),
    Format("nav_msgs/Odometry", "odometry", "ros1", "ros1msg", ODOMETRY),
    Format("foxglove.Odometry", "odometry", "protobuf", "protobuf", _FOXGLOVE_ODOMETRY),
    Format("autoware_perception_msgs/msg/TrackedObjects", "autoware", "cdr", "ros2msg", _TRACKED, many=True),
    Format(
        "autoware_perception_msgs/msg/PredictedObjects", "autoware", "cdr", "ros2msg", _PREDICTED, many=True
    ),
    Format(
        "autoware_auto_perception_msgs/msg/TrackedObjects", "autoware", "cdr", "ros2msg", _TRACKED, many=True
    ),
    Format(
        "autoware_auto_perception_msgs/msg/PredictedObjects",
        "autoware",
        "cdr",
        "ros2msg",
        _PREDICTED,
        many=True,
    ),
    Format("geometry_msgs/msg/PoseStamped", "pose", "cdr", "ros2msg", _POSE),
    Format("geometry_msgs/PoseStamped", "pose", "ros1", "ros1msg", _POSE),
    Format("foxglove.PoseInFrame", "pose", "protobuf", "protobuf", Mapping({**_FOXGLOVE, **_FOXGLOVE_POSE})),
    Format(
        "foxglove.PosesInFrame",
        "pose",
        "protobuf",
        "protobuf",
        Mapping(
            {
                "time": "/timestamp",
                "frame": "/frame_id",
                **_xy("position", "position"),
                "orientation": "orientation",
            },
            "poses",
        ),
        many=True,
    ),
    Format("foxglove.SceneUpdate", "scene_update", "protobuf", "protobuf", _SCENE_UPDATE, many=True),
    Format("foxglove.LocationFix", "location", "protobuf", "protobuf", _LOCATION),
    Format("tf2_msgs/msg/TFMessage", "tf", "cdr", "ros2msg", _TF, many=True),
    Format("tf2_msgs/TFMessage", "tf", "ros1", "ros1msg", _TF, many=True),
    Format("tf/tfMessage", "tf", "ros1", "ros1msg", _TF, many=True),
    Format("foxglove.FrameTransform", "tf", "protobuf", "protobuf", Mapping(_FOXGLOVE_TF)),
    Format(
        "foxglove.FrameTransforms",
        "tf",
        "protobuf",
        "protobuf",
        Mapping(_FOXGLOVE_TF, "transforms"),
        many=True,
    ),
)
#: Encodings that a field mapping of the configuration can be applied to: message, schema.
MAPPABLE = (
    ("protobuf", "protobuf"),
    ("cdr", "ros2msg"),
    ("ros1", "ros1msg"),
    ("json", ""),
    ("json", "jsonschema"),
)


def recognise(channel: Channel, config: IngestConfig) -> Format | None:
    """Tell the format of a channel; None where it is not read.

    A format that the configuration gives to the topic goes before the schema's name, but what is
    encoded otherwise can still not be read as it.
    """
    topic = config.topics.get(channel.topic)
    family = topic.format if topic else None
    name = channel.schema.name if channel.schema else ""
    if topic and topic.fields and family in (None, "fields"):
        return _mapped(channel, topic.items, {str(target): path for target, path in topic.fields.items()})
    known = [format_ for format_ in FORMATS if format_.fits(channel)]
    for format_ in known:
        if format_.name == name and family in (None, format_.family):
            return format_
    # A foreign name for a known format: the first of the family that the configuration names.
    return next((format_ for format_ in known if format_.family == family), None)


def _mapped(channel: Channel, items: str, fields: dict[str, str]) -> Format | None:
    encodings = (channel.message_encoding, channel.schema.encoding if channel.schema else "")
    if encodings not in MAPPABLE:
        return None
    name = f"fields of {channel.schema.name}" if channel.schema else "fields"
    return Format(name, "fields", *encodings, Mapping(fields, items), many=bool(items))


def why_not(channel: Channel, config: IngestConfig) -> str:
    """Tell why a channel is not read."""
    topic = config.topics.get(channel.topic)
    schema_encoding = channel.schema.encoding if channel.schema else ""
    if topic and topic.format == "ignore":
        return "the configuration says so"
    if (channel.message_encoding, schema_encoding) not in MAPPABLE:
        encoding = f"{channel.message_encoding or 'no encoding'} with {schema_encoding or 'no'} schema"
        return f"{encoding} is not decoded"
    if topic and topic.format is not None:
        return f"it is not encoded as {topic.format}"
    return "no known message of vehicles; ingest.topics can name its fields"


def reference_point(topic: str, format_: Format, config: IngestConfig) -> ReferencePoint:
    """Tell which point of the vehicle the positions of a topic name."""
    own = config.topics.get(topic)
    if own and own.reference_point:
        return own.reference_point
    by_frame = format_.family in ("odometry", "pose", "tf")
    return config.odometry_reference_point if by_frame else "box_centre"


def base_link_to_centre_m(topic: str, config: IngestConfig) -> float:
    """Tell the distance from a topic's base_link forward to the box centre [m]."""
    own = config.topics.get(topic)
    if own and own.base_link_to_centre_m is not None:
        return own.base_link_to_centre_m
    return config.base_link_to_centre_m
