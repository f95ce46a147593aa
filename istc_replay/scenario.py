"""Scenarios: the log cut into windows, and in each who takes part and what stands in the way."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from istc_replay.datatypes import (
    Dimensions,
    Exclusion,
    Frame,
    Log,
    MapBounds,
    Obstacle,
    Participant,
    Recording,
    Scenario,
    SceneObstacle,
    StartState,
    VehicleInfo,
    Window,
    read_only,
)
from istc_replay.errors import ScenarioError
from istc_replay.geometry import box_corners, rotate, to_frame
from istc_replay.road_frame import Body, conflicts, road_yaw
from istc_replay.tracks import UsableTrack, known_poses, known_states, swept_boxes, usable_track
from istc_replay.units import NS_PER_S, seconds_to_ns

if TYPE_CHECKING:
    from collections.abc import Iterator

    from istc_replay.config import Config, VehiclesConfig, WindowConfig

#: Time units by rule: of a scene, of traffic from coarse to fine, of traffic without any conflict.
SCENE_UNIT_S, TRAFFIC_UNITS_S, CALM_UNIT_S = 1.0, (0.5, 0.25), 1.0
#: Limits and weights of layer 2 in traffic, where the configuration does not set them.
TRAFFIC_LIMITS = {
    "acceleration_max_mps2": 3.5,
    "deceleration_max_mps2": 6.0,
    "pivotal_x_weight": 20.0,
    "pivotal_y_weight": 20.0,
    "steering_rate_weight": 5.0,
}
#: Reasons of exclusion that tell of a road user whose motion is well known.
AS_RECORDED = ("not_a_vehicle", "uncooperative")
#: States this far outside a window still tell the state at its ends.
_MARGIN_S = 1.0


def build_scenarios(log: Log, config: Config) -> Iterator[Scenario]:
    """Cut a log into windows and build the scenario of each.

    Raises
    ------
    ScenarioError
        If the log has no vehicle, or is shorter than one time unit.
    """
    check_states(log)
    for span in window_spans(log, config):
        yield build_scenario(log, config, span)


def check_states(log: Log) -> None:
    """Refuse a log without vehicles.

    Raises
    ------
    ScenarioError
        If it has none.
    """
    if log.states.is_empty():
        understood = ", ".join(sorted({c.schema for c in log.channels if c.schema})) or "none"
        raise ScenarioError(
            f"{log.path}: no vehicle states; schemas in the log: {understood}; "
            "see docs/formats.md for what is read, or name the topic in [ingest.topics]"
        )


def settled_config(log: Log, config: Config) -> Config:
    """The settings in force: in traffic, layer 2 may brake and speed up as recorded traffic does.

    It also keeps closer to its pivotal points, which lie on the road where nothing needs to change.
    """
    limits = config.trajectories
    if not is_traffic(log, config.window):
        return config
    free = {name: value for name, value in TRAFFIC_LIMITS.items() if name not in limits.model_fields_set}
    return config.model_copy(update={"trajectories": limits.model_copy(update=free)})


def window_spans(log: Log, config: Config) -> list[tuple[int, int, int]]:
    """Start [ns], length [ns] and index of every window of a log.

    Raises
    ------
    ScenarioError
        If the log is shorter than one time unit.
    """
    window, traffic = config.window, is_traffic(log, config.window)
    unit_ns = seconds_to_ns(first_unit_s(log, window))
    firsts = log.states.group_by("vehicle_id").agg(pl.col("time_ns").min())["time_ns"].to_numpy()
    # Vehicles are sampled in turn: start when all that are there at the start have been seen.
    start = int(firsts[firsts - firsts.min() < unit_ns // 2].max())
    end = int(log.states["time_ns"].max())  # type: ignore[arg-type]
    span = end - start
    if span < unit_ns:
        raise ScenarioError(
            f"{log.path}: {span / NS_PER_S:.3f} s of states, less than one time unit of "
            f"{unit_ns / NS_PER_S:g} s; set window.unit_s lower"
        )
    if span <= seconds_to_ns(window.horizon_s if traffic else window.whole_log_s):
        return [(start, span, 0)]
    horizon = seconds_to_ns(window.horizon_s)
    offsets = range(0, span, seconds_to_ns(window.stride_s))
    spans = ((start + offset, min(horizon, span - offset), index) for index, offset in enumerate(offsets))
    return [whole for whole in spans if whole[1] >= unit_ns]


def is_traffic(log: Log, config: WindowConfig) -> bool:
    """Whether a log is recorded traffic: nothing of a scene is told, and someone is fast."""
    if config.rules != "auto":
        return config.rules == "traffic"
    scene = log.scene
    if scene.lane_lines or scene.obstacles or scene.vehicles or scene.bounds is not None:
        return False
    speeds = log.states["speed_mps"].drop_nulls()
    speeds = speeds.filter(speeds.is_finite())
    return bool(len(speeds)) and float(speeds.abs().max()) > config.slow_mps  # type: ignore[arg-type]


def first_unit_s(log: Log, config: WindowConfig) -> float:
    """Length of the time unit that is tried first [s]; a window of calm traffic may have a longer one."""
    if config.unit_s != "auto":
        return config.unit_s
    return TRAFFIC_UNITS_S[0] if is_traffic(log, config) else SCENE_UNIT_S


def build_scenario(
    log: Log, config: Config, span: tuple[int, int, int], unit_s: float | None = None
) -> Scenario:
    """Build the scenario of one window, a span as of `window_spans`.

    With `unit_s` unset the time unit is the configured one, in traffic the calm one where the
    recording has no conflict at it.
    """
    traffic = is_traffic(log, config.window)
    if unit_s is None:
        unit_s = first_unit_s(log, config.window)
        if traffic and config.window.unit_s == "auto" and span[1] >= seconds_to_ns(CALM_UNIT_S):
            calm = _Builder.of(log, config, span, CALM_UNIT_S, traffic)
            if calm.calm():
                return calm.scenario()
    return _Builder.of(log, config, span, unit_s, traffic).scenario()


@dataclass(slots=True)
class _Builder:
    """A window while its scenario is being built; tracks in the frame of `window`."""

    log: Log
    config: Config
    window: Window
    traffic: bool
    present: list[str]
    states: dict[tuple[object, ...], pl.DataFrame]
    parked: frozenset[str]
    usable: dict[str, UsableTrack] = field(default_factory=dict)
    excluded: dict[str, Exclusion] = field(default_factory=dict)

    @classmethod
    def of(
        cls, log: Log, config: Config, span: tuple[int, int, int], unit_s: float, traffic: bool
    ) -> _Builder:
        """Sort the road users of a window and choose its frame."""
        start_ns, length_ns, index = span
        units = length_ns // seconds_to_ns(unit_s)
        end_ns = start_ns + units * seconds_to_ns(unit_s)
        present, states = _around(log.states, start_ns, end_ns)
        window = Window(index, start_ns, end_ns, unit_s, int(units), _local_frame(states))
        tracks = states.partition_by("vehicle_id", as_dict=True, maintain_order=True)
        parked = _parked(log.states, present, config.window) if traffic else frozenset()
        builder = cls(log, config, window, traffic, sorted(present, key=_natural), tracks, parked)
        builder.sort()
        if config.window.frame == "road" or (config.window.frame == "auto" and traffic):
            builder.turn(road_yaw(builder.bodies(), window.units, unit_s))
        return builder

    def sort(self) -> None:
        """Tell who can be planned from who cannot, and why."""
        for vehicle_id in self.present:
            track = self.states[(vehicle_id,)]
            found = usable_track(track, vehicle_id, self.window, self.config.window, traffic=self.traffic)
            own = self.config.vehicles.by_id.get(vehicle_id)
            reason = ""
            if isinstance(found, Exclusion):
                self.excluded[vehicle_id] = found
                continue
            if track["role"].drop_nulls().is_in(["pedestrian", "bicycle", "other"]).any():
                reason, detail = "not_a_vehicle", f"{track['role'][0]}: an obstacle that moves as recorded"
            elif own is not None and not own.cooperative:
                reason, detail = "uncooperative", "marked so: an obstacle that moves as recorded"
            elif vehicle_id in self.parked:
                reason, detail = "parked", "never moves: a standing obstacle"
            if reason:
                self.excluded[vehicle_id] = Exclusion(vehicle_id, reason, detail)
            else:
                self.usable[vehicle_id] = found

    def bodies(self) -> list[Body]:
        """The vehicles to plan, for the choice of the frame."""
        found = []
        for vehicle_id, usable in self.usable.items():
            size = self.size(vehicle_id)[0]
            poses = usable.at_units(self.window.unit_s)
            found.append(Body(usable.first_unit, poses, size.length_m, size.width_m))
        return found

    def turn(self, yaw_rad: float) -> None:
        """Turn the corridor frame."""
        self.window = replace(self.window, frame=replace(self.window.frame, yaw_rad=yaw_rad))
        self.usable = {name: usable.turned(yaw_rad) for name, usable in self.usable.items()}

    def calm(self) -> bool:
        """Whether the recording has no conflict."""
        return conflicts(self.bodies(), self.window.units, self.window.unit_s, 0.0)[1] == 0

    def size(self, vehicle_id: str) -> tuple[Dimensions, str]:
        """Dimensions of a road user, and where they come from."""
        vehicles = self.log.scene.vehicles
        info = next((v for v in vehicles if v.vehicle_id == vehicle_id), VehicleInfo(vehicle_id))
        return vehicle_dimensions(self.states[(vehicle_id,)], info, self.config.vehicles)

    def scenario(self) -> Scenario:
        """The scenario of the window."""
        window = self.window
        participants = tuple(self.participant(vehicle_id) for vehicle_id in self.usable)
        moving = (self.obstacle(vehicle_id) for vehicle_id in self.present)
        return Scenario(
            window=window,
            participants=participants,
            obstacles=(
                *(_standing_obstacle(o, window) for o in self.log.scene.obstacles),
                *(obstacle for obstacle in moving if obstacle is not None),
            ),
            bounds_m=_bounds(self.log.scene.bounds, window.frame),
            excluded=tuple(self.excluded.values()),
            vehicles_present=len(self.present),
            traffic=self.traffic,
        )

    def obstacle(self, vehicle_id: str) -> Obstacle | None:
        """What a road user sweeps as recorded while it is not planned; None where nothing is known."""
        exclusion, usable = self.excluded.get(vehicle_id), self.usable.get(vehicle_id)
        if not (self.traffic or (exclusion is not None and exclusion.reason in AS_RECORDED)):
            return None
        known = known_states(self.states[(vehicle_id,)])
        if known.is_empty():
            return None
        vulnerable = exclusion is not None and exclusion.reason == "not_a_vehicle"
        size = self.size(vehicle_id)[0]
        box = _recorded_box(known) if vulnerable else (size.length_m, size.width_m)
        boxes = np.array(swept_boxes(*known_poses(known, self.window), box, self.window))
        if usable is not None:  # it enters before its first whole unit, or leaves after its last
            boxes[usable.first_unit : usable.first_unit + usable.units] = np.nan
        return None if np.isnan(boxes).all() else Obstacle(vehicle_id, read_only(boxes))

    def participant(self, vehicle_id: str) -> Participant:
        """A vehicle to plan."""
        usable, scene, config = self.usable[vehicle_id], self.log.scene, self.config.vehicles
        info = next((v for v in scene.vehicles if v.vehicle_id == vehicle_id), VehicleInfo(vehicle_id))
        dimensions, source = self.size(vehicle_id)
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
            lane_m=None if lane is None else read_only(to_frame(lane.points_m, self.window.frame), columns=2),
            dimensions_source=source,
        )


def _parked(states: pl.DataFrame, present: list[str], config: WindowConfig) -> frozenset[str]:
    """Vehicles that never move in the whole log; one that stands in a queue moves at another time."""
    x, y = pl.col("x_m"), pl.col("y_m")
    moved = (
        states.filter(pl.col("vehicle_id").is_in(present))
        .group_by("vehicle_id")
        .agg(((x.max() - x.min()) ** 2 + (y.max() - y.min()) ** 2).sqrt().alias("moved_m"))
    )
    return frozenset(moved.filter(pl.col("moved_m") < config.parked_m)["vehicle_id"].to_list())


def _recorded_box(track: pl.DataFrame) -> tuple[float, float]:
    """Length and width of a road user that is no vehicle, 1 m where they are not recorded."""
    length, width = track["length_m"].drop_nulls(), track["width_m"].drop_nulls()
    return float(length[0]) if len(length) else 1.0, float(width[0]) if len(width) else 1.0


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


# --- participants and obstacles --------------------------------------------------------------


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
