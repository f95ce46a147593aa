"""The tables' declared schemas: what users compute with and what the modules hand over."""

from __future__ import annotations

import polars as pl

from istc_replay.errors import LogError

#: One row a recorded state, as ingest gives it: box centre, map frame, sorted by vehicle and time.
STATES_SCHEMA = pl.Schema(
    {
        "vehicle_id": pl.String(),
        "time_ns": pl.Int64(),  # the chosen time source
        "log_time_ns": pl.Int64(),
        "publish_time_ns": pl.Int64(),
        "x_m": pl.Float64(),
        "y_m": pl.Float64(),
        "heading_rad": pl.Float64(),
        "speed_mps": pl.Float64(),  # along the heading, negative when reversing
        "acceleration_mps2": pl.Float64(),
        "steering_rad": pl.Float64(),
        "steering_rate_radps": pl.Float64(),
        "jerk_mps3": pl.Float64(),
        "length_m": pl.Float64(),
        "width_m": pl.Float64(),
        "wheelbase_m": pl.Float64(),
        "rear_axle_to_centre_m": pl.Float64(),
        "role": pl.String(),  # vehicle, pedestrian, bicycle, other
        "topic": pl.String(),
        "message_index": pl.Int64(),  # position of the message within its topic
        "derived": pl.UInt8(),  # bits: 1 heading, 2 speed, 4 acceleration were derived
    }
)

#: One row a state of a result; source is recorded, planned (certified), rejected (not certified)
#: or guidance.
RESULT_STATES_SCHEMA = pl.Schema(
    {
        "source": pl.String(),
        "window": pl.Int32(),
        "vehicle_id": pl.String(),
        "time_ns": pl.Int64(),
        "x_m": pl.Float64(),
        "y_m": pl.Float64(),
        "heading_rad": pl.Float64(),
        "speed_mps": pl.Float64(),
        "acceleration_mps2": pl.Float64(),
        "steering_rad": pl.Float64(),
        "steering_rate_radps": pl.Float64(),
        "jerk_mps3": pl.Float64(),
        "length_m": pl.Float64(),
        "width_m": pl.Float64(),
        "wheelbase_m": pl.Float64(),
        "rear_axle_to_centre_m": pl.Float64(),
    }
)

CORRIDORS_SCHEMA = pl.Schema(
    {
        "window": pl.Int32(),
        "vehicle_id": pl.String(),
        "k": pl.Int32(),
        "start_ns": pl.Int64(),
        "end_ns": pl.Int64(),
        "x_min_m": pl.Float64(),
        "x_max_m": pl.Float64(),
        "y_min_m": pl.Float64(),
        "y_max_m": pl.Float64(),
        "pivot_x_m": pl.Float64(),  # at start_ns
        "pivot_y_m": pl.Float64(),
        "pivot_end_x_m": pl.Float64(),  # at end_ns
        "pivot_end_y_m": pl.Float64(),
        "reference_x_m": pl.Float64(),  # at start_ns
        "reference_y_m": pl.Float64(),
        "reference_end_x_m": pl.Float64(),
        "reference_end_y_m": pl.Float64(),
        "frame_yaw_rad": pl.Float64(),
        "frame_x_m": pl.Float64(),
        "frame_y_m": pl.Float64(),
    }
)

OBSTACLES_SCHEMA = pl.Schema(
    {
        "window": pl.Int32(),
        "obstacle_id": pl.String(),
        "k": pl.Int32(),
        "start_ns": pl.Int64(),
        "end_ns": pl.Int64(),
        "x_min_m": pl.Float64(),
        "x_max_m": pl.Float64(),
        "y_min_m": pl.Float64(),
        "y_max_m": pl.Float64(),
        "frame_yaw_rad": pl.Float64(),
        "frame_x_m": pl.Float64(),
        "frame_y_m": pl.Float64(),
    }
)

SOLVES_SCHEMA = pl.Schema(
    {
        "window": pl.Int32(),
        "vehicle_id": pl.String(),
        "layer": pl.String(),
        "stage": pl.String(),
        "solver": pl.String(),
        "status": pl.String(),
        "objective": pl.Float64(),
        "bound": pl.Float64(),
        "gap": pl.Float64(),
        "wall_s": pl.Float64(),
        "iterations": pl.Int64(),
        "nodes": pl.Int64(),
        "binaries": pl.Int64(),
        "detail": pl.String(),
    }
)

CERTIFICATES_SCHEMA = pl.Schema(
    {
        "window": pl.Int32(),
        "check": pl.String(),
        "verdict": pl.String(),
        "margin": pl.Float64(),
        "unit": pl.String(),
        "time_ns": pl.Int64(),
        "vehicles": pl.List(pl.String()),
        "detail": pl.String(),
    }
)


def conform(table: pl.DataFrame, schema: pl.Schema) -> pl.DataFrame:
    """Give the table exactly the schema's columns and types; columns it lacks become null.

    Raises
    ------
    LogError
        If the table has a column that the schema does not know.
    """
    unknown = [name for name in table.columns if name not in schema]
    if unknown:
        known = ", ".join(schema)
        raise LogError(f"table has unknown columns {', '.join(unknown)}; the schema has {known}")
    return table.select(
        (pl.col(name) if name in table.columns else pl.lit(None)).cast(dtype).alias(name)
        for name, dtype in schema.items()
    )
