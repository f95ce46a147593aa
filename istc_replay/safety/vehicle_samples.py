"""What each single vehicle did: accelerations, jerk, yaw rate, and the bicycle that would do it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from istc_replay.config import AuditConfig
from istc_replay.datatypes import FloatArray
from istc_replay.safety.bodies import Body
from istc_replay.safety.smoothing import pieces_of, smoothed
from istc_replay.states import VEHICLE_SAMPLES_SCHEMA, conform
from istc_replay.units import NS_PER_S, wrap_angle

#: A curvature is not told of vehicles slower than this [m/s].
_TURNING_MPS = 1.0
#: Steps whose median is the usual pace.
_PACES = 7
#: Longest fit, reached above 600 samples a second.
_MOST_SAMPLES = 501


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A body's smoothed motion at its samples, (S,) each; NaN is not judged.

    `jumps` are the samples before which it moved further than it could have: no fit crosses them.
    `course_rad` and `travel_mps` are those of the positions alone; `steering_rad` is what a
    bicycle needs for the curvature yaw rate / v, `side_slip_rad` the course against the heading
    less what a rolling rear axle gives the box centre.
    """

    window: int
    jumps: NDArray[np.int64]
    acceleration_mps2: FloatArray
    lateral_mps2: FloatArray
    jerk_mps3: FloatArray
    yaw_rate_radps: FloatArray
    steering_rad: FloatArray
    steering_rate_radps: FloatArray
    side_slip_rad: FloatArray
    course_rad: FloatArray
    travel_mps: FloatArray


def smoothed_motion(body: Body, audit: AuditConfig) -> Motion:
    """Smooth a body's recorded motion, never across gaps or jumps.

    Acceleration and jerk are derivatives of the recorded speed, the yaw rate of the heading; the
    course is that of the smoothed positions.
    """
    track = body.track
    longest = audit.gap_periods * track.period_ns
    jumped = jumps(body, audit)
    pieces = pieces_of(track.times_ns, longest)
    pieces = pieces + np.cumsum(np.bincount(jumped, minlength=pieces.size))
    times = (track.times_ns - track.times_ns[0]) / NS_PER_S
    window = fit_samples(track.period_ns / NS_PER_S, audit)
    x, y, heading, speed = track.states.T
    finite = np.isfinite(heading)
    unwrapped = np.full(heading.shape, np.nan)
    unwrapped[finite] = np.unwrap(heading[finite])
    columns = np.stack([x, y, speed, unwrapped])
    if np.isfinite(columns).all():
        value, rate, second = smoothed(times, columns, pieces, window)
    else:  # what one does not know ends no piece of another
        apart = [smoothed(times, column, pieces, window) for column in columns]
        value, rate, second = np.stack(apart, axis=1)
    dx, dy, acceleration, yaw_rate = rate
    even, turned, jerk = value[2], value[3], second[2]
    with np.errstate(invalid="ignore", divide="ignore"):
        curvature = np.where(np.abs(even) > _TURNING_MPS, yaw_rate / even, np.nan)
        steering = np.arctan(body.wheelbase_m * curvature)
        _, steering_rate, _ = smoothed(times, steering, pieces, window)
        forward = np.where(even < 0.0, np.pi, 0.0)
        course = wrap_angle(np.arctan2(dy, dx))
        travel = np.hypot(dx, dy)
        rolling = np.arctan(body.rear_axle_to_centre_m * curvature)
        slip = np.where(
            travel > audit.heading_speed_mps, wrap_angle(course - forward - turned - rolling), np.nan
        )
    return Motion(
        window=window,
        jumps=jumped,
        acceleration_mps2=acceleration,
        lateral_mps2=even * yaw_rate,
        jerk_mps3=jerk,
        yaw_rate_radps=yaw_rate,
        steering_rad=steering,
        steering_rate_radps=steering_rate,
        side_slip_rad=slip,
        course_rad=course,
        travel_mps=travel,
    )


def jumps(body: Body, audit: AuditConfig) -> NDArray[np.int64]:
    """Samples before which a body moved further than it could have."""
    track = body.track
    if track.times_ns.size < 2:
        return np.empty(0, dtype=np.int64)
    step = np.diff(track.times_ns) / NS_PER_S
    moved = np.hypot(*np.diff(track.states[:, :2], axis=0).T)
    if body.speed_derived:
        # A speed derived from positions has the jump in it; the usual pace about it has not.
        paces = sliding_window_view(np.pad(moved / step, _PACES // 2, mode="edge"), _PACES)
        speed = np.median(paces, axis=1)
    else:
        speed = np.fmax(np.abs(track.states[:-1, 3]), np.abs(track.states[1:, 3]))
    speed = np.where(np.isfinite(speed), speed, np.inf)
    able = speed * step + audit.acceleration_bound_mps2 * step**2 / 2.0 + 3.0 * audit.position_sigma_m
    found = np.flatnonzero(moved > able) + 1
    # Who jumps at most steps is told in other units than its speed.
    return np.asarray(found if found.size < moved.size / 2 else found[:0])


def fit_samples(period_s: float, audit: AuditConfig) -> int:
    """Odd number of samples of a fit: those configured, or more where they span too little."""
    if period_s <= 0.0:
        return audit.smoothing_samples
    spanning = int(np.ceil(audit.smoothing_s / period_s - 1e-6)) + 1
    return max(audit.smoothing_samples, min(spanning + (spanning + 1) % 2, _MOST_SAMPLES))


def vehicles_table(
    bodies: list[Body], motions: list[Motion], affected: list[NDArray[np.bool_]]
) -> pl.DataFrame:
    """The table of VEHICLE_SAMPLES_SCHEMA, pedestrians and others left out."""
    parts = []
    for body, motion, doubtful in zip(bodies, motions, affected, strict=True):
        if not body.is_vehicle:
            continue
        columns = {
            name: getattr(motion, name)
            for name in VEHICLE_SAMPLES_SCHEMA
            if name in Motion.__dataclass_fields__
        }
        x, y, _, speed = body.track.states.T
        parts.append(
            pl.DataFrame(
                {
                    "vehicle_id": [body.name] * x.size,
                    "time_ns": body.track.times_ns,
                    "x_m": x,
                    "y_m": y,
                    "speed_mps": speed,
                    **columns,
                    "topic": body.topic.tolist(),
                    "message_index": body.message_index,
                    "affected": doubtful,
                }
            )
        )
    table = pl.concat(parts) if parts else pl.DataFrame(schema=VEHICLE_SAMPLES_SCHEMA)
    return conform(table.with_columns(pl.col(pl.Float64).fill_nan(None)), VEHICLE_SAMPLES_SCHEMA)
