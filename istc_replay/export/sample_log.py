"""Writing a recorded scene as an MCAP log, in each of the formats that ingest reads.

The bytes depend on the scene and on the locked versions alone.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from typing import Any

from mcap.writer import Writer

from istc_replay import messages
from istc_replay.datatypes import StaticScene
from istc_replay.errors import UsageError
from istc_replay.export.sample_odometry import write_odometry
from istc_replay.export.sample_osi import write_osi
from istc_replay.samples.drive import RecordedScene

Row = dict[str, Any]

_SIZE_FIELDS = ("length_m", "width_m", "wheelbase_m", "rear_axle_to_centre_m")
_STATE_FIELDS = (
    *("time_ns", "vehicle_id", "x_m", "y_m", "heading_rad"),
    *("speed_mps", "acceleration_mps2", "steering_rad"),
)


def sample_bytes(recorded: RecordedScene, format: str = "istc") -> bytes:  # noqa: A002
    """Write a recorded scene as an MCAP log.

    Parameters
    ----------
    recorded : RecordedScene
        What to write.
    format : str
        `istc`: a topic of istc.v1.VehicleState a vehicle and one istc.v1.Scene.
        `osi`: osi3.GroundTruth, one message an instant. `odometry`: a topic of
        nav_msgs/msg/Odometry a vehicle, poses of the rear axle.

    Raises
    ------
    UsageError
        If the format is none of these.
    """
    if format not in _WRITERS:
        raise UsageError(f"no sample format is named {format!r}; there are {', '.join(_WRITERS)}")
    stream = io.BytesIO()
    _WRITERS[format](recorded, stream)
    return stream.getvalue()


def _instants(recorded: RecordedScene) -> Iterator[tuple[int, list[Row]]]:
    """The states of each instant, as a recorder sees them come in."""
    for (time_ns,), rows in recorded.states.sort("time_ns", maintain_order=True).group_by(
        "time_ns", maintain_order=True
    ):
        yield int(time_ns), rows.to_dicts()


# --- istc.v1 ---------------------------------------------------------------------------------


def _write_istc(recorded: RecordedScene, stream: io.BytesIO) -> None:
    writer = Writer(stream)
    writer.start(profile="", library="istc-replay")
    schemas = messages.descriptor_set()
    scene_schema = writer.register_schema(f"{messages.PACKAGE}.Scene", "protobuf", schemas)
    state_schema = writer.register_schema(f"{messages.PACKAGE}.VehicleState", "protobuf", schemas)
    scene_channel = writer.register_channel("/scene", "protobuf", scene_schema)
    channels = {
        vehicle: writer.register_channel(f"/vehicles/{vehicle}/state", "protobuf", state_schema)
        for vehicle in recorded.states["vehicle_id"].unique(maintain_order=True)
    }
    for index, (time_ns, rows) in enumerate(_instants(recorded)):
        if index == 0:
            writer.add_message(scene_channel, time_ns, _encoded(_scene(recorded.scene)), time_ns)
        for row in rows:
            writer.add_message(
                channels[row["vehicle_id"]], time_ns, _encoded(_vehicle_state(row)), time_ns, sequence=index
            )
    writer.finish()


def _encoded(message: Any) -> bytes:
    return bytes(message.SerializeToString(deterministic=True))


def _vehicle_state(row: Row) -> Any:
    known = {name: row[name] for name in _STATE_FIELDS}
    return messages.message("VehicleState")(**known, dimensions={name: row[name] for name in _SIZE_FIELDS})


def _scene(scene: StaticScene) -> Any:
    message = messages.message("Scene")()
    for line in scene.lane_lines:
        points = [{"x_m": x, "y_m": y} for x, y in line.points_m.tolist()]
        message.lane_lines.add(lane_id=line.lane_id, vehicle_id=line.vehicle_id or "", points=points)
    for obstacle in scene.obstacles:
        message.obstacles.add(**_fields(obstacle))
    if scene.bounds is not None:
        message.bounds.CopyFrom(messages.message("MapBounds")(**_fields(scene.bounds)))
    for vehicle in scene.vehicles:
        size = None if vehicle.dimensions is None else _fields(vehicle.dimensions)
        message.vehicles.add(vehicle_id=vehicle.vehicle_id, priority=vehicle.priority, dimensions=size)
    return message


def _fields(record: Any) -> Row:
    return {name: getattr(record, name) for name in record.__slots__}


_WRITERS: dict[str, Callable[[RecordedScene, io.BytesIO], None]] = {
    "istc": _write_istc,
    "osi": lambda recorded, stream: write_osi(_instants(recorded), recorded.scene.obstacles, stream),
    "odometry": lambda recorded, stream: write_odometry(_instants(recorded), stream),
}
