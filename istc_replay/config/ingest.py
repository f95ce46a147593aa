"""The configuration's section `ingest`: reading logs."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from istc_replay.config.sections import Section

#: What a field mapping can tell of a vehicle; docs/formats.md explains each.
FieldTarget = Literal[
    "vehicle_id",
    "vehicle_frame",
    "frame",
    "time",
    "time_ns",
    "time_s",
    "position",
    "x_m",
    "y_m",
    "latitude",
    "longitude",
    "orientation",
    "heading_rad",
    "heading_deg",
    "speed_mps",
    "velocity",
    "acceleration_mps2",
    "acceleration",
    "steering_rad",
    "steering_rate_radps",
    "jerk_mps3",
    "length_m",
    "width_m",
    "wheelbase_m",
    "rear_axle_to_centre_m",
]


TopicFormat = Literal[
    "istc", "osi", "odometry", "pose", "tf", "autoware", "scene_update", "location", "fields", "ignore"
]


class TopicConfig(Section):
    """How to read one topic, where the schema alone does not tell."""

    format: TopicFormat | None = None
    """Read the topic as this format; unset: by `fields` if there are any, else recognised from its schema."""
    items: str = ""
    """Path of the repeated part of the message that holds a vehicle each; empty: one vehicle a message."""
    fields: dict[FieldTarget, str] = Field(default={})
    """Paths of the message's fields by what they tell, such as x_m = "pose.position.x"."""
    vehicle_id: str | None = None
    """The vehicle that the topic belongs to; unset: from the message or the topic's name."""
    reference_point: Literal["box_centre", "rear_axle", "base_link"] | None = None
    """Which point of the vehicle the positions name; unset: the format's own."""
    base_link_to_centre_m: float | None = None
    """Distance from base_link forward to the box centre; needed for base_link."""


#: What a column of a table can tell.
ColumnTarget = Literal[
    "vehicle_id",
    "role",
    "time_ns",
    "time_us",
    "time_ms",
    "time_s",
    "x_m",
    "y_m",
    "heading_rad",
    "heading_deg",
    "speed_mps",
    "velocity_x_mps",
    "velocity_y_mps",
    "acceleration_mps2",
    "steering_rad",
    "steering_rate_radps",
    "jerk_mps3",
    "length_m",
    "width_m",
    "wheelbase_m",
    "rear_axle_to_centre_m",
]


class IngestConfig(Section):
    """Reading logs."""

    time_source: Literal["header", "log", "publish"] = "header"
    """Which time stamps the states: the message's own, the recorder's, or the publisher's."""
    odometry_reference_point: Literal["box_centre", "rear_axle", "base_link"] = "rear_axle"
    """What nav_msgs/Odometry poses name (Autoware: the rear axle)."""
    base_link_to_centre_m: float = 0.0
    """Distance from base_link forward to the box centre, for reference point base_link."""
    columns: dict[ColumnTarget, str] = Field(default={})
    """Columns of a table that `convert` reads, by what they tell, such as x_m = "utm_east"."""
    topics: dict[str, TopicConfig] = Field(default={})
    """Per topic, what differs from the above."""
    road_file: str | None = None
    """GeoJSON with lanes and road edges in the log's metric frame, beside what the log tells of them."""
