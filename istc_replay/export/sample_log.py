"""Writing a recorded scene as an MCAP log, in each of the formats that ingest reads.

The bytes depend on the scene and on the locked versions alone.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from typing import Any

from istc_replay.errors import UsageError
from istc_replay.export.sample_odometry import write_odometry
from istc_replay.export.sample_osi import write_osi
from istc_replay.export.states_log import write_states
from istc_replay.samples.drive import RecordedScene

Row = dict[str, Any]

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


_WRITERS: dict[str, Callable[[RecordedScene, io.BytesIO], None]] = {
    "istc": lambda recorded, stream: write_states(recorded.states, recorded.scene, stream, _STATE_FIELDS),
    "osi": lambda recorded, stream: write_osi(_instants(recorded), recorded.scene.obstacles, stream),
    "odometry": lambda recorded, stream: write_odometry(_instants(recorded), stream),
}
