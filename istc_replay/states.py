"""The tables' declared schemas: what users compute with and what the modules hand over."""

from __future__ import annotations

import polars as pl

from istc_replay.errors import LogError

#: Pose and motion of a box's centre, in the map frame.
_MOTION = {
    "x_m": pl.Float64(),
    "y_m": pl.Float64(),
    "heading_rad": pl.Float64(),
    "speed_mps": pl.Float64(),  # along the heading, negative when reversing
    "acceleration_mps2": pl.Float64(),
    "steering_rad": pl.Float64(),
    "steering_rate_radps": pl.Float64(),
    "jerk_mps3": pl.Float64(),
}
#: The body, and where its message stands.
_BODY = {
    "length_m": pl.Float64(),
    "width_m": pl.Float64(),
    "wheelbase_m": pl.Float64(),
    "rear_axle_to_centre_m": pl.Float64(),
    "role": pl.String(),  # vehicle, pedestrian, bicycle, other
    "topic": pl.String(),
    "message_index": pl.Int64(),  # position of the message within its topic
    "derived": pl.UInt8(),  # bits: 1 heading, 2 speed, 4 acceleration were derived
}

#: One row a recorded state, as ingest gives it: box centre, map frame, sorted by vehicle and time.
STATES_SCHEMA = pl.Schema(
    {
        "vehicle_id": pl.String(),
        "time_ns": pl.Int64(),  # the chosen time source
        "log_time_ns": pl.Int64(),
        "publish_time_ns": pl.Int64(),
        **_MOTION,
        **_BODY,
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
        **_MOTION,
        **_BODY,
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


#: One row a finding of the audit, behaviour and data quality alike.
FINDINGS_SCHEMA = pl.Schema(
    {
        "finding_id": pl.String(),  # the same for the same log, whatever the thresholds
        "rule": pl.String(),
        "verdict": pl.String(),  # fail, or inconclusive where the data cannot be trusted
        "severity": pl.String(),  # minor, serious, critical; null for data quality
        "vehicles": pl.List(pl.String()),
        "start_ns": pl.Int64(),
        "worst_ns": pl.Int64(),
        "end_ns": pl.Int64(),
        "x_m": pl.Float64(),  # map frame, at the worst time
        "y_m": pl.Float64(),
        "value": pl.Float64(),
        "unit": pl.String(),
        "threshold": pl.Float64(),  # of the severity reached
        "threshold_source": pl.String(),
        "topic": pl.String(),
        "message_index": pl.Int64(),  # of the first vehicle's state at or before the worst time
        "encounter_id": pl.String(),  # null for single vehicles
        "detail": pl.String(),
    }
)

#: One row a span of time in which a pair has findings.
ENCOUNTERS_SCHEMA = pl.Schema(
    {
        "encounter_id": pl.String(),
        "first": pl.String(),
        "second": pl.String(),
        "verdict": pl.String(),
        "severity": pl.String(),
        "conflict_type": pl.String(),  # at the worst time
        "start_ns": pl.Int64(),
        "worst_ns": pl.Int64(),
        "end_ns": pl.Int64(),
        "x_m": pl.Float64(),
        "y_m": pl.Float64(),
        "least_gap_m": pl.Float64(),  # until the pause that ends an encounter is over
        "least_gap_ns": pl.Int64(),
        "least_ttc_s": pl.Float64(),
        "most_drac_mps2": pl.Float64(),  # at most what a car can brake
        "most_required_mps2": pl.Float64(),  # of the vehicle that needed less
        "least_thw_s": pl.Float64(),
        "least_pet_s": pl.Float64(),  # positive: first was there first
        "event_pet_s": pl.Float64(),  # where the vehicle there first left the other's path
        "pet_resolution_s": pl.Float64(),
        "least_rss_margin_m": pl.Float64(),
        "tet_s": pl.Float64(),
        "tit_s2": pl.Float64(),
        "delta_v_first_mps": pl.Float64(),
        "delta_v_second_mps": pl.Float64(),
        "consequence": pl.String(),  # serious or critical by the changes of speed, else null
        "rules": pl.List(pl.String()),
    }
)

#: One row a pair of vehicles near each other at a common time.
PAIR_SAMPLES_SCHEMA = pl.Schema(
    {
        "first": pl.String(),
        "second": pl.String(),
        "time_ns": pl.Int64(),
        "gap_m": pl.Float64(),  # negative: overlap
        "gap_bound_m": pl.Float64(),  # how far off the gap may be between samples
        "relative_speed_mps": pl.Float64(),
        "ttc_s": pl.Float64(),
        "ttc_turning_s": pl.Float64(),  # yaw rates held; told of serious samples of turning vehicles
        "silhouette_m": pl.Float64(),  # overlap seen along the relative velocity
        "drac_mps2": pl.Float64(),  # at most what a car can brake, in contact too
        "required_first_mps2": pl.Float64(),  # as DRAC; infinite where braking avoids nothing
        "required_second_mps2": pl.Float64(),
        "follower": pl.String(),
        "thw_s": pl.Float64(),
        "rss_margin_m": pl.Float64(),
        "angle_rad": pl.Float64(),
        "conflict_type": pl.String(),
        "delta_v_first_mps": pl.Float64(),
        "delta_v_second_mps": pl.Float64(),
    }
)

#: One row a recorded state, with what follows from it; NaN is not judged.
VEHICLE_SAMPLES_SCHEMA = pl.Schema(
    {
        "vehicle_id": pl.String(),
        "time_ns": pl.Int64(),
        "x_m": pl.Float64(),
        "y_m": pl.Float64(),
        "speed_mps": pl.Float64(),
        "acceleration_mps2": pl.Float64(),
        "lateral_mps2": pl.Float64(),
        "jerk_mps3": pl.Float64(),
        "yaw_rate_radps": pl.Float64(),
        "steering_rad": pl.Float64(),  # that a bicycle needs for the curvature
        "steering_rate_radps": pl.Float64(),
        "side_slip_rad": pl.Float64(),
        "topic": pl.String(),
        "message_index": pl.Int64(),
        "affected": pl.Boolean(),  # within a span of doubtful data
    }
)

#: One row a window and vehicle with a plan: what was recorded against it, a counterfactual estimate.
AGAINST_PLAN_SCHEMA = pl.Schema(
    {
        "window": pl.Int32(),
        "vehicle_id": pl.String(),
        "start_ns": pl.Int64(),  # the plan's span
        "end_ns": pl.Int64(),
        "samples": pl.Int64(),  # recorded in it
        "first_exit_ns": pl.Int64(),  # of the recorded box from its planned corridor, null: none
        "last_out_ns": pl.Int64(),
        "deepest_m": pl.Float64(),  # how far out a corner was at most; negative: never out
        "deepest_ns": pl.Int64(),
        "outside_s": pl.Float64(),
        "deviation_mean_m": pl.Float64(),  # of the box centres at equal times
        "deviation_most_m": pl.Float64(),
        "deviation_most_ns": pl.Int64(),
        "deviation_end_m": pl.Float64(),
        "delay_end_s": pl.Float64(),  # planned less recorded time at equal arc length
        "delay_most_s": pl.Float64(),
        "compared_m": pl.Float64(),  # the arc length that both drive
        "recorded_braking_mps2": pl.Float64(),  # the most of each, through the same filter
        "planned_braking_mps2": pl.Float64(),
        "recorded_lateral_mps2": pl.Float64(),
        "planned_lateral_mps2": pl.Float64(),
        "recorded_jerk_mps3": pl.Float64(),
        "planned_jerk_mps3": pl.Float64(),
        "estimate": pl.String(),  # counterfactual estimate: nobody drove the plan
    }
)

#: One row a vehicle and measure: how much of its recorded time was judged.
COVERAGE_SCHEMA = pl.Schema(
    {
        "vehicle_id": pl.String(),
        "rule": pl.String(),
        "verdict": pl.String(),  # pass, fail, inconclusive or not_applicable
        "recorded_s": pl.Float64(),
        "judged_s": pl.Float64(),
        "affected_s": pl.Float64(),
        "late_start_s": pl.Float64(),  # after the log's first state
        "early_end_s": pl.Float64(),  # before the log's last state
        "dimensions_source": pl.String(),  # log, config or default
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
