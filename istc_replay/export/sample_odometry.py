"""Sample logs as ROS 2 odometry: a topic of nav_msgs/msg/Odometry a vehicle, poses of the rear axle."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import IO, Any

from mcap_ros2.writer import Writer

from istc_replay.geometry import shift_along
from istc_replay.units import NS_PER_S

#: The message and what it is made of, by their ROS 2 names.
_DEFINITIONS = {
    "nav_msgs/Odometry": (
        "std_msgs/Header header",
        "string child_frame_id",
        "geometry_msgs/PoseWithCovariance pose",
        "geometry_msgs/TwistWithCovariance twist",
    ),
    "std_msgs/Header": ("builtin_interfaces/Time stamp", "string frame_id"),
    "builtin_interfaces/Time": ("int32 sec", "uint32 nanosec"),
    "geometry_msgs/PoseWithCovariance": ("geometry_msgs/Pose pose", "float64[36] covariance"),
    "geometry_msgs/Pose": ("geometry_msgs/Point position", "geometry_msgs/Quaternion orientation"),
    "geometry_msgs/Point": ("float64 x", "float64 y", "float64 z"),
    "geometry_msgs/Quaternion": ("float64 x", "float64 y", "float64 z", "float64 w"),
    "geometry_msgs/TwistWithCovariance": ("geometry_msgs/Twist twist", "float64[36] covariance"),
    "geometry_msgs/Twist": ("geometry_msgs/Vector3 linear", "geometry_msgs/Vector3 angular"),
    "geometry_msgs/Vector3": ("float64 x", "float64 y", "float64 z"),
}
_DECIMALS = 9


def write_odometry(instants: Iterable[tuple[int, list[dict[str, Any]]]], stream: IO[bytes]) -> None:
    """Write the states of each instant to `/vehicle_<id>/odom`.

    Parameters
    ----------
    instants : iterable of (int, list of dict)
        Time [ns] and that instant's rows of the states table.
    stream : IO
        Takes the file's bytes.
    """
    with Writer(stream) as writer:
        schema = writer.register_msgdef("nav_msgs/msg/Odometry", _definition())
        for index, (time_ns, rows) in enumerate(instants):
            for row in rows:
                topic = f"/vehicle_{row['vehicle_id']}/odom"
                writer.write_message(topic, schema, _odometry(row), time_ns, time_ns, index)


def _definition() -> str:
    """The definitions as one text: the message's own, then each part under its name."""
    parts = [
        "\n".join(lines) if name == "nav_msgs/Odometry" else "\n".join((f"MSG: {name}", *lines))
        for name, lines in _DEFINITIONS.items()
    ]
    return ("\n" + "=" * 80 + "\n").join(parts)


def _odometry(row: dict[str, Any]) -> dict[str, Any]:
    heading, speed = row["heading_rad"], row["speed_mps"]
    x, y = shift_along(row["x_m"], row["y_m"], heading, -row["rear_axle_to_centre_m"]).tolist()
    turning = speed * math.tan(row["steering_rad"]) / row["wheelbase_m"]
    seconds, nanoseconds = divmod(row["time_ns"], NS_PER_S)
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": "map"},
        "child_frame_id": f"vehicle_{row['vehicle_id']}/base_link",
        "pose": {
            "pose": {
                "position": _vector(x, y),
                "orientation": {
                    **_vector(z=math.sin(heading / 2)),
                    "w": round(math.cos(heading / 2), _DECIMALS),
                },
            },
            "covariance": [0.0] * 36,
        },
        "twist": {
            "twist": {"linear": _vector(x=speed), "angular": _vector(z=turning)},
            "covariance": [0.0] * 36,
        },
    }


def _vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> dict[str, float]:
    return {"x": round(x, _DECIMALS), "y": round(y, _DECIMALS), "z": round(z, _DECIMALS)}
