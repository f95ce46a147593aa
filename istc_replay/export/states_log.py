"""Writing states and a scene as an MCAP log of the project's own messages.

The bytes depend on the states, the scene and the locked versions alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import IO, Any

import polars as pl
from mcap.writer import Writer

from istc_replay import messages
from istc_replay.datatypes import StaticScene
from istc_replay.export.encode import scene_message
from istc_replay.export.placing import topic_name

_SIZE_FIELDS = ("length_m", "width_m", "wheelbase_m", "rear_axle_to_centre_m")
STATE_FIELDS = (
    *("time_ns", "vehicle_id", "x_m", "y_m", "heading_rad", "speed_mps", "acceleration_mps2"),
    *("steering_rad", "steering_rate_radps", "jerk_mps3"),
)


def write_states(
    states: pl.DataFrame, scene: StaticScene, stream: IO[bytes], fields: Sequence[str] = STATE_FIELDS
) -> None:
    """Write states, a topic a vehicle, and a scene if it tells anything.

    Parameters
    ----------
    states : DataFrame
        Columns of STATES_SCHEMA; what is null stays untold.
    scene : StaticScene
        Told once, with the first state.
    stream : binary file
        Written to; not closed.
    fields : sequence of str
        The columns that the messages tell, beside the size and the role.
    """
    writer = Writer(stream)
    writer.start(profile="", library="istc-replay")
    schemas = messages.descriptor_set()
    scene_schema = writer.register_schema(f"{messages.PACKAGE}.Scene", "protobuf", schemas)
    state_schema = writer.register_schema(f"{messages.PACKAGE}.VehicleState", "protobuf", schemas)
    scene_channel = writer.register_channel("/scene", "protobuf", scene_schema)
    vehicles = states["vehicle_id"].unique(maintain_order=True).to_list()
    channels = {
        vehicle: writer.register_channel(f"/vehicles/{topic_name(vehicle)}/state", "protobuf", state_schema)
        for vehicle in vehicles
    }
    state_type, size_type = messages.message("VehicleState"), messages.message("Dimensions")
    ordered = states.sort("time_ns", maintain_order=True)
    instant, last_ns = -1, None
    for known, size, (role,) in zip(
        ordered.select(fields).iter_rows(named=True),
        ordered.select(_SIZE_FIELDS).iter_rows(named=True),
        ordered.select("role").iter_rows(),
        strict=True,
    ):
        time_ns = known["time_ns"]
        if last_ns is None and scene != StaticScene():
            writer.add_message(scene_channel, time_ns, _encoded(scene_message(scene)), time_ns)
        if time_ns != last_ns:
            instant, last_ns = instant + 1, time_ns
        state = state_type(**known, role="" if role in (None, "vehicle") else role)
        if any(value is not None for value in size.values()):
            state.dimensions.CopyFrom(size_type(**size))
        writer.add_message(channels[known["vehicle_id"]], time_ns, _encoded(state), time_ns, sequence=instant)
    writer.finish()


def _encoded(message: Any) -> bytes:
    return bytes(message.SerializeToString(deterministic=True))
