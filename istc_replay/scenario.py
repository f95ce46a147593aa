"""Scenarios: the log cut into windows, and in each who takes part and what stands in the way."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from istc_replay.datatypes import (
    Dimensions,
    Exclusion,
    FloatArray,
    Frame,
    Log,
    MapBounds,
    Obstacle,
    Participant,
    Recording,
    Scenario,
    SceneObstacle,
    StartState,
    StaticScene,
    VehicleInfo,
    Window,
    read_only,
)
from istc_replay.errors import ScenarioError
from istc_replay.geometry import box_corners, rotate, to_frame
from istc_replay.units import NS_PER_S, seconds_to_ns

if TYPE_CHECKING:
    from collections.abc import Iterator

    from istc_replay.config import Config, VehiclesConfig, WindowConfig

#: A recording with a hole longer than this many median sample periods is not planned across it.
HOLE_PERIODS = 3.0
_LEAST_HOLE_S = 0.5
#: States this far outside a window still tell the state at its ends.
_MARGIN_S = 1.0


def build_scenarios(log: Log, config: Config) -> Iterator[Scenario]:
    """Cut a log into windows and build the scenario of each.

    Raises
    ------
    ScenarioError
        If the log has no vehicle, or is shorter than one time unit.
    """
    if log.states.is_empty():
        understood = ", ".join(sorted({c.schema for c in log.channels if c.schema})) or "none"
        raise ScenarioError(
            f"{log.path}: no vehicle states; schemas in the log: {understood}; "
            "see docs/formats.md for what is read, or name the topic in [ingest.topics]"
        )
    for start_ns, units, index in _spans(log.states, config.window, log.path):
        yield build_scenario(log, config, start_ns, units, index)


def _spans(states: pl.DataFrame, config: WindowConfig, path: str) -> list[tuple[int, int, int]]:
    unit_ns = seconds_to_ns(config.unit_s)
    firsts = states.group_by("vehicle_id").agg(pl.col("time_ns").min())["time_ns"].to_numpy()
    # Vehicles are sampled in turn: start when all that are there at the start have been seen.
    start = int(firsts[firsts - firsts.min() < unit_ns // 2].max())
    end = int(states["time_ns"].max())  # type: ignore[arg-type]
    span = end - start
    if span <= seconds_to_ns(config.whole_log_s):
        units = span // unit_ns
        if units == 0:
            raise ScenarioError(
                f"{path}: {span / NS_PER_S:.3f} s of states, less than one time unit of "
                f"{config.unit_s} s; set window.unit_s lower"
            )
        return [(start, int(units), 0)]
    horizon = max(1, round(config.horizon_s / config.unit_s))
    spans = []
    for index, offset in enumerate(range(0, span, seconds_to_ns(config.stride_s))):
        units = min(horizon, (span - offset) // unit_ns)
        if units >= 1:
            spans.append((start + offset, int(units), index))
    return spans


def build_scenario(log: Log, config: Config, start_ns: int, units: int, index: int) -> Scenario:
    """Build the scenario of one window of `units` time units from `start_ns`."""
    unit_ns = seconds_to_ns(config.window.unit_s)
    end_ns = start_ns + units * unit_ns
    present, states = _around(log.states, start_ns, end_ns)
    frame = _local_frame(states)
    window = Window(index, start_ns, end_ns, config.window.unit_s, units, frame)
    participants, excluded = [], []
    moving: list[Obstacle] = []
    tracks = states.partition_by("vehicle_id", as_dict=True, maintain_order=True)
    for vehicle_id in sorted(present, key=_natural):
        track = tracks[(vehicle_id,)]
        usable = _usable(track, vehicle_id, window, config.window)
        if isinstance(usable, Exclusion):
            excluded.append(usable)
            continue
        if track["role"].drop_nulls().is_in(["pedestrian", "bicycle", "other"]).any():
            moving.append(_moving_obstacle(usable, vehicle_id, window, track))
            excluded.append(
                Exclusion(
                    vehicle_id, "not_a_vehicle", f"{track['role'][0]}: an obstacle that moves as recorded"
                )
            )
            continue
        participants.append(_participant(usable, track, vehicle_id, window, log.scene, config.vehicles))
    return Scenario(
        window=window,
        participants=tuple(participants),
        obstacles=(*(_standing_obstacle(o, window) for o in log.scene.obstacles), *moving),
        bounds_m=_bounds(log.scene.bounds, frame),
        excluded=tuple(excluded),
        vehicles_present=len(present),
    )


def _around(states: pl.DataFrame, start_ns: int, end_ns: int) -> tuple[list[str], pl.DataFrame]:
    """Vehicles with a state in the span, and their states in it and just outside, to interpolate from."""
    time_ns = pl.col("time_ns")
    present = states.filter(time_ns.is_between(start_ns, end_ns))["vehicle_id"].unique().to_list()
    margin = seconds_to_ns(_MARGIN_S)
    near = states.filter(time_ns.is_between(start_ns - margin, end_ns + margin))
    return present, near.filter(pl.col("vehicle_id").is_in(present))


def _natural(vehicle_id: str) -> tuple[int, str]:
    """Sort 2 before 10, and numbers before names."""
    return (int(vehicle_id), "") if vehicle_id.isdecimal() else (1 << 62, vehicle_id)


def _local_frame(states: pl.DataFrame) -> Frame:
    """Origin at the median position, in whole metres, so that no digit is lost by the shift."""
    x, y = states["x_m"].median(), states["y_m"].median()
    if not isinstance(x, float) or not isinstance(y, float):
        return Frame()
    return Frame(float(round(x)), float(round(y)), 0.0)


# --- what of a track can be used -------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """A usable part of a track: whole units, times from the window's start, corridor frame."""

    first_unit: int
    units: int
    times_s: FloatArray  # (S,)
    poses: FloatArray  # (S, 3)
    speeds_mps: FloatArray  # (S,)
    steering_rad: FloatArray  # (S,), NaN where unknown
    acceleration_mps2: FloatArray  # (S,), NaN where unknown


def _usable(track: pl.DataFrame, vehicle_id: str, window: Window, config: WindowConfig) -> _Track | Exclusion:
    for column, reason in (
        ("x_m", "missing_position"),
        ("y_m", "missing_position"),
        ("heading_rad", "missing_heading"),
    ):
        if track[column].null_count() == len(track):
            return Exclusion(vehicle_id, reason, f"no state has {column}")
    known = track.filter(
        pl.all_horizontal(pl.col(name).is_finite().fill_null(False) for name in ("x_m", "y_m", "heading_rad"))
    )
    known = known.unique("time_ns", keep="first", maintain_order=True)
    if len(known) < 2:
        return Exclusion(
            vehicle_id, "one_sample", f"{len(known)} usable state(s) in the window; two are needed"
        )
    if not known["speed_mps"].is_finite().fill_null(False).all():
        return Exclusion(vehicle_id, "missing_speed", "no speed is recorded, and none can be derived")
    times = (known["time_ns"].to_numpy() - window.start_ns) / NS_PER_S
    return _unbroken(known, times, vehicle_id, window, config)


def _unbroken(
    known: pl.DataFrame, times: FloatArray, vehicle_id: str, window: Window, config: WindowConfig
) -> _Track | Exclusion:
    periods = np.diff(times)
    # A hole that lies outside the window is none of its business.
    periods[(times[1:] <= 0.0) | (times[:-1] >= window.units * window.unit_s)] = 0.0
    hole = int(np.argmax(periods))
    if periods[hole] > max(HOLE_PERIODS * float(np.median(np.diff(times))), _LEAST_HOLE_S):
        return Exclusion(
            vehicle_id, "hole", f"nothing recorded for {periods[hole]:.2f} s from {times[hole]:.2f} s on"
        )
    first_unit = max(0, math.ceil(times[0] / window.unit_s - 1e-9))
    end_unit = min(window.units, math.floor(times[-1] / window.unit_s + 1e-9))
    if end_unit - first_unit < min(config.minimum_presence_units, window.units):
        return Exclusion(
            vehicle_id, "short_presence", f"present for {max(0, end_unit - first_unit)} whole time units"
        )
    return _resampled(known, times, first_unit, end_unit, window)


def _resampled(
    known: pl.DataFrame, times: FloatArray, first_unit: int, end_unit: int, window: Window
) -> _Track:
    boundaries = np.arange(first_unit, end_unit + 1) * window.unit_s
    at = np.union1d(times[(times > boundaries[0]) & (times < boundaries[-1])], boundaries)
    points = to_frame(known.select("x_m", "y_m").to_numpy(), window.frame)
    headings = np.unwrap(known["heading_rad"].to_numpy() - window.frame.yaw_rad)

    def sampled(values: FloatArray) -> FloatArray:
        return np.asarray(np.interp(at, times, values))

    def optional(name: str, derived: int = 0) -> FloatArray:
        # What was derived is no measurement: the plan stays free where nothing was recorded.
        recorded = pl.when((pl.col("derived").fill_null(0) & derived) == 0).then(name)
        return sampled(known.select(recorded.fill_null(math.nan)).to_series().to_numpy())

    return _Track(
        first_unit,
        end_unit - first_unit,
        read_only(at),
        read_only(np.stack([sampled(points[:, 0]), sampled(points[:, 1]), sampled(headings)], axis=-1)),
        read_only(sampled(known["speed_mps"].to_numpy())),
        read_only(optional("steering_rad")),
        read_only(optional("acceleration_mps2", derived=4)),
    )


# --- participants and obstacles --------------------------------------------------------------


def _participant(
    usable: _Track,
    track: pl.DataFrame,
    vehicle_id: str,
    window: Window,
    scene: StaticScene,
    config: VehiclesConfig,
) -> Participant:
    info = next((v for v in scene.vehicles if v.vehicle_id == vehicle_id), VehicleInfo(vehicle_id))
    dimensions, source = vehicle_dimensions(track, info, config)
    own = config.by_id.get(vehicle_id)
    priority = own.priority if own is not None and own.priority is not None else info.priority
    lane = next((line for line in scene.lane_lines if line.vehicle_id == vehicle_id), None)
    x, y, heading = usable.poses[0]
    return Participant(
        vehicle_id=vehicle_id,
        dimensions=dimensions,
        priority=config.priority if priority is None else priority,
        first_unit=usable.first_unit,
        units=usable.units,
        start=StartState(float(x), float(y), float(heading), float(usable.speeds_mps[0])),
        recording=Recording(usable.times_s, usable.poses, usable.speeds_mps),
        lane_m=None if lane is None else read_only(to_frame(lane.points_m, window.frame), columns=2),
        dimensions_source=source,
    )


def vehicle_dimensions(
    track: pl.DataFrame, info: VehicleInfo, config: VehiclesConfig
) -> tuple[Dimensions, str]:
    """Dimensions from the log, else from the config, else the defaults; and which of the three."""

    def recorded(name: str) -> float | None:
        values = track[name].drop_nulls()
        finite = values.filter(values.is_finite())
        if name != "rear_axle_to_centre_m":
            finite = finite.filter(finite > 0)
        return float(finite[0]) if len(finite) else None

    own = config.by_id.get(info.vehicle_id)
    sources: list[str] = []

    def pick(name: str, default: float) -> float:
        told = getattr(info.dimensions, name, None)
        for source, value in (
            ("log", recorded(name)),
            ("log", told if told is not None and math.isfinite(told) else None),
            ("config", None if own is None else getattr(own, name)),
        ):
            if value is not None:
                sources.append(source)
                return float(value)
        sources.append("default")
        return default

    length, width = pick("length_m", config.length_m), pick("width_m", config.width_m)
    box_source = next((s for s in ("default", "config") if s in sources), "log")
    wheelbase = pick("wheelbase_m", length * config.wheelbase_ratio)
    return Dimensions(length, width, wheelbase, pick("rear_axle_to_centre_m", wheelbase / 2.0)), box_source


def _standing_obstacle(obstacle: SceneObstacle, window: Window) -> Obstacle:
    corners = to_frame(
        box_corners(obstacle.x_m, obstacle.y_m, obstacle.heading_rad, obstacle.length_m, obstacle.width_m),
        window.frame,
    )
    box = [corners[:, 0].min(), corners[:, 0].max(), corners[:, 1].min(), corners[:, 1].max()]
    return Obstacle(obstacle.obstacle_id, read_only([box] * window.units), read_only(corners))


def _moving_obstacle(usable: _Track, obstacle_id: str, window: Window, track: pl.DataFrame) -> Obstacle:
    """Boxes of a road user that moves as recorded: what it sweeps in each unit, NaN where absent."""
    length = track["length_m"].drop_nulls()
    width = track["width_m"].drop_nulls()
    size = (float(length[0]) if len(length) else 1.0, float(width[0]) if len(width) else 1.0)
    corners = box_corners(usable.poses[:, 0], usable.poses[:, 1], usable.poses[:, 2], *size)  # (S, 4, 2)
    boxes = np.full((window.units, 4), np.nan)
    for unit in range(usable.first_unit, usable.first_unit + usable.units):
        start, end = unit * window.unit_s, (unit + 1) * window.unit_s
        at = np.flatnonzero((usable.times_s >= start - 1e-9) & (usable.times_s <= end + 1e-9))
        swept = corners[at].reshape(-1, 2)
        boxes[unit] = swept[:, 0].min(), swept[:, 0].max(), swept[:, 1].min(), swept[:, 1].max()
    return Obstacle(obstacle_id, read_only(boxes))


def _bounds(bounds: MapBounds | None, frame: Frame) -> tuple[float, float, float, float] | None:
    if bounds is None:
        return None
    corners = rotate(
        np.array([[bounds.x_min_m, bounds.y_min_m], [bounds.x_max_m, bounds.y_max_m]])
        - (frame.x_m, frame.y_m),
        -frame.yaw_rad,
    )
    low, high = corners.min(axis=0), corners.max(axis=0)
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])
