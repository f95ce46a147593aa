"""Driving a path: the recorded states of vehicles that take no notice of each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from istc_replay.datatypes import Dimensions, FloatArray, StaticScene
from istc_replay.geometry import shift_along
from istc_replay.guidance.curves import Curve
from istc_replay.samples.pace import Pace
from istc_replay.states import STATES_SCHEMA, conform
from istc_replay.units import NS_PER_S, wrap_angle

#: Recorded values are multiples of this, so that they repeat on every processor.
RESOLUTION_DECIMALS = 9
_PERIOD_NS = NS_PER_S // 10


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """One vehicle's path of the rear axle, and its pace along it from `from_m` on."""

    vehicle_id: str
    dimensions: Dimensions
    path: Curve
    pace: Pace
    from_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScene:
    """A scene as recorded: `states` has the columns of `STATES_SCHEMA`, box centres, map frame.

    The columns that a file format fills in (topic, message_index, log and publish time) are null.
    """

    name: str
    scene: StaticScene
    states: pl.DataFrame


def record_drives(
    name: str, scene: StaticScene, drives: Sequence[Drive], start_ns: int, duration_s: int
) -> RecordedScene:
    """Sample all drives at 10 Hz from `start_ns`, both ends included."""
    tables = [_states(drive, start_ns, duration_s) for drive in drives]
    return RecordedScene(name, scene, conform(pl.concat(tables), STATES_SCHEMA))


def box_centres(poses: FloatArray, dimensions: Dimensions) -> FloatArray:
    """Box centres (S, 2) of rear-axle poses (S, 3) [m]."""
    return shift_along(poses[:, 0], poses[:, 1], poses[:, 2], dimensions.rear_axle_to_centre_m)


def _states(drive: Drive, start_ns: int, duration_s: int) -> pl.DataFrame:
    offsets_ns = np.arange(0, duration_s * NS_PER_S + 1, _PERIOD_NS)
    distance, speed, acceleration = drive.pace.at(offsets_ns / NS_PER_S)
    along = drive.from_m + distance
    poses = drive.path.poses(along)  # (S, 3)
    size = drive.dimensions
    centres = box_centres(poses, size)
    curvature, sharpness = drive.path.curvature(along), drive.path.sharpness(along)
    # tan(steering) = wheelbase * curvature, and its derivative in time.
    tangent = size.wheelbase_m * curvature
    values = {
        "x_m": centres[:, 0],
        "y_m": centres[:, 1],
        "heading_rad": poses[:, 2],
        "speed_mps": speed,
        "acceleration_mps2": acceleration,
        "steering_rad": np.arctan(tangent),
        "steering_rate_radps": size.wheelbase_m * sharpness * speed / (1.0 + tangent**2),
    }
    rounded = {column: _rounded(value) for column, value in values.items()}
    rounded["heading_rad"] = wrap_angle(rounded["heading_rad"])
    return pl.DataFrame({"time_ns": start_ns + offsets_ns, **rounded}).with_columns(
        vehicle_id=pl.lit(drive.vehicle_id),
        length_m=pl.lit(size.length_m),
        width_m=pl.lit(size.width_m),
        wheelbase_m=pl.lit(size.wheelbase_m),
        rear_axle_to_centre_m=pl.lit(size.rear_axle_to_centre_m),
        role=pl.lit("vehicle"),
        derived=pl.lit(0),
    )


def _rounded(values: FloatArray) -> FloatArray:
    # Adding zero turns -0.0 into 0.0.
    return np.round(values, RESOLUTION_DECIMALS) + 0.0
