"""Decoding ROS 2 `nav_msgs/msg/Odometry` from CDR."""

from __future__ import annotations

import math
import struct

from istc_replay.ingest.columns import PayloadError, State
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.records import Schema
from istc_replay.units import NS_PER_S

#: The message's layout, which has not changed in ROS 2; schemas are compared with it.
_FIELDS = {
    "Odometry": (
        "Header header",
        "string child_frame_id",
        "PoseWithCovariance pose",
        "TwistWithCovariance twist",
    ),
    "Header": ("Time stamp", "string frame_id"),
    "Time": ("int32 sec", "uint32 nanosec"),
    "PoseWithCovariance": ("Pose pose", "float64[36] covariance"),
    "Pose": ("Point position", "Quaternion orientation"),
    "Point": ("float64 x", "float64 y", "float64 z"),
    "Quaternion": ("float64 x", "float64 y", "float64 z", "float64 w"),
    "TwistWithCovariance": ("Twist twist", "float64[36] covariance"),
    "Twist": ("Vector3 linear", "Vector3 angular"),
    "Vector3": ("float64 x", "float64 y", "float64 z"),
}
#: Pose (position, quaternion, covariance) and twist (linear, angular, covariance).
_NUMBERS = 7 + 36 + 6 + 36
_TWIST = 7 + 36
#: Names of a vehicle's own frame that do not tell which vehicle.
_GENERIC_FRAMES = {"", "base_link", "base_footprint", "base", "body", "ego", "rear_axle"}
#: A quaternion's norm may differ this much from 1.
_NORM_TOLERANCE = 1e-3
#: Longest message definition that is compared [bytes]; the known one has 4 kB with all its comments.
_DEFINITION_LIMIT = 2**16


class OdometryReader:
    """Reads `nav_msgs/msg/Odometry`; the twist is in the child frame, its x along the heading.

    The vehicle is the configured one, else the child frame up to its last `/`, else the child
    frame itself where it is not a name like base_link, else the first part of the topic.
    """

    def __init__(self, topic: str, schema: Schema | None, vehicle_id: str | None, problems: Problems) -> None:
        if schema is not None and not _is_known(schema.data):
            raise PayloadError("the schema is not the known nav_msgs/msg/Odometry", "schema")
        self._topic = topic
        self._vehicle_id = vehicle_id
        self._problems = problems
        self._numbers = {order: struct.Struct(f"{order}{_NUMBERS}d") for order in "<>"}
        self.frames: set[str] = set()

    def states(self, data: bytes) -> list[State]:
        """Decode one payload: one state."""
        try:
            header_ns, frame, child_frame, numbers = self._decode(data)
        except (struct.error, IndexError, UnicodeDecodeError) as error:
            raise PayloadError(f"not a nav_msgs/msg/Odometry: {error}") from None
        if len(self.frames) < 2:
            self.frames.add(frame)
        vehicle_id = self._vehicle_id or vehicle_of(self._topic, child_frame)
        heading_rad = self._heading(numbers[3:7])
        return [State(vehicle_id, header_ns, "vehicle", numbers[0], numbers[1], heading_rad, numbers[_TWIST])]

    def _decode(self, data: bytes) -> tuple[int, str, str, tuple[float, ...]]:
        if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
            raise PayloadError("not plain CDR: its first bytes are " + data[:4].hex(" "))
        order = "<" if data[1] else ">"
        seconds, nanoseconds = struct.unpack_from(f"{order}iI", data, 4)
        frame, position = _string(data, 12, order)
        child_frame, position = _string(data, position, order)
        # Numbers are aligned to 8 bytes, counted from behind the four bytes of the encapsulation.
        numbers = self._numbers[order].unpack_from(data, 4 + (position - 4 + 7) // 8 * 8)
        return seconds * NS_PER_S + nanoseconds, frame, child_frame, numbers

    def _heading(self, quaternion: tuple[float, ...]) -> float | None:
        x, y, z, w = quaternion
        norm = math.hypot(x, y, z, w)
        if not abs(norm - 1.0) <= _NORM_TOLERANCE:
            detail = f"a quaternion of norm {norm:.6g} on {quoted(self._topic)} gives no heading"
            self._problems.add("quaternion", detail, kind=self._topic)
            return None
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def vehicle_of(topic: str, child_frame: str) -> str:
    """Name the vehicle of an odometry message, by the rule of `OdometryReader`."""
    prefix, _, name = child_frame.strip("/").rpartition("/")
    if prefix:
        return prefix
    if name not in _GENERIC_FRAMES:
        return name
    return topic.strip("/").split("/")[0] or name


def _string(data: bytes, position: int, order: str) -> tuple[str, int]:
    position = (position + 3) // 4 * 4
    (size,) = struct.unpack_from(f"{order}I", data, position)
    start, end = position + 4, position + 4 + size
    if end > len(data):
        raise PayloadError(f"not a nav_msgs/msg/Odometry: a string of {size} bytes in {len(data)}")
    return data[start:end].rstrip(b"\0").decode("utf-8"), end


def _is_known(schema: bytes) -> bool:
    """Tell whether a message definition has the known layout; an empty one says nothing against it."""
    if len(schema) > _DEFINITION_LIMIT:
        return False
    fields: dict[str, list[str]] = {}
    current = fields.setdefault("Odometry", [])
    for line in schema.decode("utf-8", "replace").splitlines():
        words = line.partition("#")[0].split()
        if not words or words[0].startswith("==="):
            continue
        if words[0] == "MSG:":
            current = fields.setdefault(words[-1].rpartition("/")[2], [])
            continue
        current.append(f"{words[0].rpartition('/')[2]} {' '.join(words[1:])}")
    return not any(fields.values()) or all(
        tuple(fields.get(name, ())) == known for name, known in _FIELDS.items()
    )
