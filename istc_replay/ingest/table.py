"""From columns in file order to the states table: box centres, sorted, speeds filled in."""

from __future__ import annotations

import polars as pl

from istc_replay.config import VehiclesConfig
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.units import NS_PER_S, wrap_angle

#: Bit of the column `derived` for a speed from positions.
SPEED_DERIVED = 2
#: Positions further apart in time than this give no speed.
_LONGEST_STEP_NS = NS_PER_S


def check_times(states: pl.DataFrame, problems: Problems) -> None:
    """Tell times that go back, or repeat, within one vehicle's states of one topic.

    Parameters
    ----------
    states : polars.DataFrame
        States in the order of the file, where such times still show.
    problems : Problems
        Where to tell them.
    """
    steps = states.select(
        "topic", "message_index", step=pl.col("time_ns").diff().over("vehicle_id", "topic")
    ).filter(pl.col("step") < 0)
    _tell(steps, "backward_time", "go back in time", problems)
    repeated = states.select(
        "topic", "message_index", again=~pl.struct("vehicle_id", "time_ns").is_first_distinct()
    )
    _tell(repeated.filter("again"), "duplicate_time", "repeat a time of their vehicle", problems)


def _tell(found: pl.DataFrame, code: str, what: str, problems: Problems) -> None:
    counted = found.group_by("topic", maintain_order=True).agg(pl.len(), pl.col("message_index").min())
    for topic, count, first in counted.iter_rows():
        problems.add(
            code, f"{count} states on {quoted(topic)} {what}, first in its message {first}", None, topic
        )


def to_centres(
    states: pl.DataFrame, references: dict[str, float | None], vehicles: VehiclesConfig, problems: Problems
) -> pl.DataFrame:
    """Move positions from the topics' reference points to the box centres.

    Parameters
    ----------
    states : polars.DataFrame
        States of STATES_SCHEMA.
    references : dict[str, float | None]
        For each topic whose positions are not box centres, the distance from its reference point
        forward to the centre [m]; None for the rear axle of each vehicle.
    vehicles : VehiclesConfig
        Where a rear axle's distance comes from, after the log: half the wheelbase by default.
    problems : Problems
        Told where a position without heading cannot be moved; it becomes null.

    Returns
    -------
    polars.DataFrame
        The states with their positions moved.
    """
    if not references:
        return states
    fixed = {topic: distance for topic, distance in references.items() if distance is not None}
    distance = pl.coalesce(_lookup("topic", fixed), _rear_axle_to_centre(vehicles))
    moved = pl.col("topic").is_in(list(references))
    lost = states.filter(moved & pl.col("heading_rad").is_null() & pl.col("x_m").is_not_null())
    for topic, count in lost.group_by("topic", maintain_order=True).len().iter_rows():
        detail = f"{count} positions on {quoted(topic)} have no heading, so their box centres are unknown"
        problems.add("no_heading", detail, None, topic)
    along, across = pl.col("heading_rad").cos(), pl.col("heading_rad").sin()
    return states.with_columns(
        pl.when(moved).then(pl.col("x_m") + distance * along).otherwise("x_m").alias("x_m"),
        pl.when(moved).then(pl.col("y_m") + distance * across).otherwise("y_m").alias("y_m"),
    )


def _rear_axle_to_centre(vehicles: VehiclesConfig) -> pl.Expr:
    """Distance from the rear axle to the box centre: by id, else from the log, else the default [m]."""
    half = vehicles.wheelbase_ratio / 2.0
    by_id: dict[str, float] = {}
    for vehicle_id, vehicle in vehicles.by_id.items():
        if vehicle.rear_axle_to_centre_m is not None:
            by_id[vehicle_id] = vehicle.rear_axle_to_centre_m
        elif vehicle.wheelbase_m is not None:
            by_id[vehicle_id] = vehicle.wheelbase_m / 2.0
        elif vehicle.length_m is not None:
            by_id[vehicle_id] = vehicle.length_m * half
    return pl.coalesce(
        _lookup("vehicle_id", by_id),
        "rear_axle_to_centre_m",
        pl.col("wheelbase_m") / 2.0,
        pl.col("length_m") * half,
        pl.lit(vehicles.length_m * half),
    )


def _lookup(column: str, values: dict[str, float]) -> pl.Expr:
    if not values:
        return pl.lit(None, dtype=pl.Float64)
    return pl.col(column).replace_strict(values, default=None, return_dtype=pl.Float64)


def wrap_headings(states: pl.DataFrame) -> pl.DataFrame:
    """Wrap the headings to [-pi, pi)."""
    wrapped = pl.Series("heading_rad", wrap_angle(states["heading_rad"].to_numpy())).fill_nan(None)
    return states.with_columns(wrapped)


def sort_states(states: pl.DataFrame) -> pl.DataFrame:
    """Sort by vehicle and time; states of the same time stay in the order of the file."""
    return states.sort("vehicle_id", "time_ns", maintain_order=True)


def fill_speeds(states: pl.DataFrame) -> pl.DataFrame:
    """Derive missing speeds from sorted box centres.

    The speed is the displacement along the heading between the states before and after, by their
    time (one-sided at the ends); null stays where a step is longer than 1 s or no heading is known.
    """
    if not states["speed_mps"].has_nulls():
        return states
    span = {}
    for name in ("time_ns", "x_m", "y_m"):
        value = pl.col(name)
        after = value.shift(-1).over("vehicle_id").fill_null(value)
        before = value.shift(1).over("vehicle_id").fill_null(value)
        span[name] = after - before
    step = pl.col("time_ns").diff().over("vehicle_id").fill_null(0)
    longest = pl.max_horizontal(step, step.shift(-1).over("vehicle_id").fill_null(0))
    along = span["x_m"] * pl.col("heading_rad").cos() + span["y_m"] * pl.col("heading_rad").sin()
    sound = (span["time_ns"] > 0) & (longest <= _LONGEST_STEP_NS)
    derived = pl.when(sound).then(along / (span["time_ns"] / NS_PER_S))
    missing = pl.col("speed_mps").is_null()
    filled = states.with_columns(_derived_mps=derived)
    marks = pl.when(missing & pl.col("_derived_mps").is_not_null()).then(SPEED_DERIVED).otherwise(0)
    return filled.with_columns(
        speed_mps=pl.coalesce("speed_mps", "_derived_mps"),
        derived=pl.col("derived") | marks.cast(pl.UInt8),
    ).drop("_derived_mps")
