"""Scenarios: the log cut into windows, and in each who takes part and what stands in the way."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.datatypes import (
    Dimensions,
    Exclusion,
    FloatArray,
    Frame,
    LateralBound,
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
from istc_replay.geometry import box_corners, rotate, to_frame, to_map
from istc_replay.handover import Handed
from istc_replay.lanes import lane_ahead
from istc_replay.lateral import in_frame, lateral_bound
from istc_replay.road_frame import Body, conflicts, least_boxes, road_yaw
from istc_replay.tracks import RoadUser, UsableTrack, road_users, swept_boxes, usable_track
from istc_replay.units import seconds_to_ns
from istc_replay.windows import (
    CALM_UNITS_S,
    CROWDED_UNIT_S,
    SMALL_CROWD_UNIT_S,
    LogPart,
    first_unit_s,
    fitting_unit_s,
    in_steps,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from istc_replay.config import Config, VehiclesConfig

#: Reasons of exclusion that tell of a road user whose motion is well known.
AS_RECORDED = ("not_a_vehicle", "uncooperative")
#: Lanes are followed over this share of the recorded way, and some more [m].
_WAY_SHARE, _WAY_MORE_M = 2.0, 50.0
#: Length and width of a road user that is no vehicle and of unknown size [m].
_SMALL_M = 1.0


def build_scenario(
    part: LogPart,
    config: Config,
    unit_s: float | None = None,
    *,
    users: Mapping[str, RoadUser] | None = None,
    handed: Mapping[str, Handed] | None = None,
    bounds: dict[str, LateralBound] | None = None,
    frame: Frame | None = None,
) -> Scenario:
    """Build the scenario of one window.

    Parameters
    ----------
    part : LogPart
        What the log tells of the window.
    config : Config
        The settings in force.
    unit_s : float, optional
        Length of a time unit [s]; otherwise the configured one, in traffic the calm one where the
        recording has no conflict at it.
    users : mapping, optional
        The road users of the part by name, where they are known already.
    handed : mapping, optional
        By name the vehicles that start where the plan of the window before has led them.
    bounds : dict, optional
        Keeps lateral bounds (map frame) by name, for other time units.
    frame : Frame, optional
        The corridor frame, where it is not to be chosen.
    """
    known: dict[str, LateralBound] = {} if bounds is None else bounds
    if users is None:
        users = road_users(part.states)
    if unit_s is None:
        unit_s = first_unit_s(config.window, traffic=part.traffic)
        for longer in CALM_UNITS_S if part.traffic and config.window.unit_s == "auto" else ():
            if part.span[1] >= seconds_to_ns(longer):
                calm = _Builder.of(part, users, config, longer, handed or {}, known)
                if calm.calm():
                    return calm.scenario()
        scenario = _Builder.of(part, users, config, unit_s, handed or {}, known).scenario()
        if not scenario.crowded or config.window.unit_s != "auto" or config.corridors.formulation == "paper":
            return scenario
        unit_s = SMALL_CROWD_UNIT_S if scenario.small_crowd else CROWDED_UNIT_S
        unit_s = fitting_unit_s(unit_s, config.window, traffic=part.traffic)
    return _Builder.of(part, users, config, unit_s, handed or {}, known, frame).scenario()


@dataclass(slots=True)
class _Builder:
    """A window while its scenario is being built; tracks in the frame of `window`."""

    part: LogPart
    config: Config
    window: Window
    users: dict[str, RoadUser]
    handed: Mapping[str, Handed]
    bounds: dict[str, LateralBound]
    usable: dict[str, UsableTrack] = field(default_factory=dict)
    excluded: dict[str, Exclusion] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        part: LogPart,
        users: Mapping[str, RoadUser],
        config: Config,
        unit_s: float,
        handed: Mapping[str, Handed],
        bounds: dict[str, LateralBound],
        frame: Frame | None = None,
    ) -> _Builder:
        """Sort the road users of a window and choose its frame."""
        start_ns, length_ns, index = part.span
        units = length_ns // seconds_to_ns(unit_s)
        end_ns = start_ns + units * seconds_to_ns(unit_s)
        here = (name for name, user in users.items() if user.present(start_ns, end_ns))
        present = {name: users[name] for name in sorted(here, key=_natural)}
        local = _local_frame(present.values()) if frame is None else frame
        window = Window(index, start_ns, end_ns, unit_s, int(units), local)
        builder = cls(part, config, window, present, handed, bounds)
        builder.sort()
        turned = config.window.frame == "road" or (config.window.frame == "auto" and part.traffic)
        if frame is None and turned:
            builder.turn(road_yaw(builder.bodies(), window.units, unit_s))
        return builder

    def sort(self) -> None:
        """Tell who can be planned from who cannot, and why."""
        for vehicle_id, user in self.users.items():
            found = usable_track(user, self.window, self.config.window, traffic=self.part.traffic)
            own = self.config.vehicles.by_id.get(vehicle_id)
            reason = ""
            if isinstance(found, Exclusion):
                self.excluded[vehicle_id] = found
                continue
            if user.role != "vehicle":
                reason, detail = "not_a_vehicle", f"{user.role}: an obstacle that moves as recorded"
            elif own is not None and not own.cooperative:
                reason, detail = "uncooperative", "marked so: an obstacle that moves as recorded"
            elif vehicle_id in self.part.parked:
                reason, detail = "parked", "never moves: a standing obstacle"
            if reason:
                self.excluded[vehicle_id] = Exclusion(vehicle_id, reason, detail)
            else:
                self.usable[vehicle_id] = found

    def bodies(self) -> list[Body]:
        """The vehicles to plan, and who moves as recorded, for the choice of frame and time unit."""
        found = []
        for vehicle_id, user in self.users.items():
            track: UsableTrack | Exclusion | None = self.usable.get(vehicle_id)
            planned = track is not None
            if track is None:
                anyone = self.config.window.model_copy(update={"minimum_presence_units": 1})
                track = usable_track(user, self.window, anyone, traffic=False)
            if isinstance(track, UsableTrack):
                size = self.size(vehicle_id)[0]
                poses = track.at_units(self.window.unit_s)
                found.append(Body(track.first_unit, poses, size.length_m, size.width_m, planned))
        return found

    def turn(self, yaw_rad: float) -> None:
        """Turn the corridor frame."""
        self.window = replace(self.window, frame=replace(self.window.frame, yaw_rad=yaw_rad))
        self.usable = {name: usable.turned(yaw_rad) for name, usable in self.usable.items()}

    def calm(self) -> bool:
        """Whether the recording has no conflict, obstacles and those that enter or leave included."""
        unit_s, bodies = self.window.unit_s, [body for body in self.bodies() if body.planned]
        if conflicts(bodies, self.window.units, unit_s, 0.0)[1]:
            return False
        obstacles = {name: found for name in self.users if (found := self.obstacle(name)) is not None}
        for name, body in zip(self.usable, bodies, strict=True):
            own, units = (
                least_boxes(body, unit_s, 0.0),
                slice(body.first_unit, body.first_unit + len(body.poses) - 1),
            )
            for other in (o.boxes_m[units] for o in obstacles.values() if o.obstacle_id != name):
                apart = np.maximum(own[:, 0::2] - other[:, 1::2], other[:, 0::2] - own[:, 1::2]).max(axis=1)
                if (apart < 0.0).any():
                    return False
        return True

    def size(self, vehicle_id: str) -> tuple[Dimensions, str]:
        """Dimensions of a road user, and where they come from."""
        vehicles = self.part.scene.vehicles
        info = next((v for v in vehicles if v.vehicle_id == vehicle_id), VehicleInfo(vehicle_id))
        return vehicle_dimensions(self.users[vehicle_id].sizes, info, self.config.vehicles)

    def scenario(self) -> Scenario:
        """The scenario of the window."""
        window = self.window
        participants = tuple(self.participant(vehicle_id) for vehicle_id in self.usable)
        moving = (self.obstacle(vehicle_id) for vehicle_id in self.users)
        return Scenario(
            window=window,
            participants=participants,
            obstacles=(
                *(_standing_obstacle(o, window) for o in self.part.scene.obstacles),
                *(obstacle for obstacle in moving if obstacle is not None),
            ),
            bounds_m=_bounds(self.part.scene.bounds, window.frame),
            excluded=tuple(self.excluded.values()),
            vehicles_present=len(self.users),
            traffic=self.part.traffic,
        )

    def obstacle(self, vehicle_id: str) -> Obstacle | None:
        """What a road user sweeps as recorded while it is not planned; None where nothing is known."""
        exclusion, usable = self.excluded.get(vehicle_id), self.usable.get(vehicle_id)
        if not (self.part.traffic or (exclusion is not None and exclusion.reason in AS_RECORDED)):
            return None
        user = self.users[vehicle_id]
        if not len(user.times_ns):
            return None
        vulnerable = exclusion is not None and exclusion.reason == "not_a_vehicle"
        size = self.size(vehicle_id)[0]
        box = (size.length_m, size.width_m)
        if vulnerable:
            box = (user.sizes.get("length_m", _SMALL_M), user.sizes.get("width_m", _SMALL_M))
        boxes = np.array(swept_boxes(*user.in_frame(self.window), box, self.window))
        if usable is not None:  # it enters before its first whole unit, or leaves after its last
            boxes[usable.first_unit : usable.first_unit + usable.units] = np.nan
        return None if np.isnan(boxes).all() else Obstacle(vehicle_id, read_only(boxes))

    def participant(self, vehicle_id: str) -> Participant:
        """A vehicle to plan."""
        usable, scene, config = self.usable[vehicle_id], self.part.scene, self.config.vehicles
        info = next((v for v in scene.vehicles if v.vehicle_id == vehicle_id), VehicleInfo(vehicle_id))
        dimensions, source = self.size(vehicle_id)
        own = config.by_id.get(vehicle_id)
        priority = own.priority if own is not None and own.priority is not None else info.priority
        x, y, heading = (float(value) for value in usable.poses[0])
        start, approach, ahead = StartState(x, y, heading, float(usable.speeds_mps[0])), None, None
        before = self.handed.get(vehicle_id) if usable.first_unit == 0 else None
        if before is not None:
            start = before.start(self.window.frame, heading)
            approach = self.approach(vehicle_id, heading)
            ahead = before.plan(self.window.frame, heading)
        return Participant(
            vehicle_id=vehicle_id,
            dimensions=dimensions,
            priority=config.priority if priority is None else priority,
            first_unit=usable.first_unit,
            units=usable.units,
            start=start,
            recording=Recording(usable.times_s, usable.poses, usable.speeds_mps),
            lane_m=self.lane(vehicle_id, usable.poses),
            dimensions_source=source,
            approach=approach,
            ahead=None if self.part.traffic else ahead,
            route=self.route(vehicle_id),
            lateral=self.lateral(vehicle_id, dimensions) if self.part.traffic else None,
        )

    def lane(self, vehicle_id: str, poses: FloatArray) -> FloatArray | None:
        """The line (P, 2) of its intent; in traffic, for a constant speed, of the lane that it is in."""
        frame, lanes = self.window.frame, self.part.scene.lane_lines
        intent = next((line.points_m for line in lanes if line.vehicle_id == vehicle_id), None)
        if intent is None and self.part.traffic and self.config.guidance.law == "constant":
            away = np.column_stack([to_map(poses[:, :2], frame), poses[:, 2] + frame.yaw_rad])
            way = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
            intent = lane_ahead(lanes, away, _WAY_SHARE * way + _WAY_MORE_M)
        return None if intent is None else read_only(to_frame(intent, frame), columns=2)

    def route(self, vehicle_id: str) -> Recording | None:
        """Of a scene that is planned in steps, its track before, in and after the window."""
        if not in_steps(self.config.window, traffic=self.part.traffic):
            return None
        user, (start_ns, length_ns, _) = self.users[vehicle_id], self.part.span
        times, poses = user.in_frame(self.window)
        # What ends within the window does not go on, though its last moments are less than a time unit.
        ends = int(user.times_ns[-1]) <= start_ns + length_ns
        told = times <= (self.usable[vehicle_id].times_s[-1] if ends else times[-1])
        return Recording(read_only(times[told]), read_only(poses[told]), read_only(user.speeds_mps[told]))

    def approach(self, vehicle_id: str, heading_rad: float) -> FloatArray:
        """The recorded path (P, 3) up to the window's start; its last heading is near that given."""
        times, poses = self.users[vehicle_id].in_frame(self.window)
        poses = poses[: max(1, int(np.searchsorted(times, 0.0, side="right")))]
        turns = np.round((heading_rad - poses[-1, 2]) / (2.0 * np.pi))
        return read_only(poses + [0.0, 0.0, 2.0 * np.pi * turns])

    def lateral(self, vehicle_id: str, size: Dimensions) -> LateralBound:
        """How far it may leave its recorded path sideways."""
        if vehicle_id not in self.bounds:
            box, poses = (size.length_m, size.width_m), self.users[vehicle_id].poses
            most = self.config.corridors.lateral_m
            self.bounds[vehicle_id] = lateral_bound(poses, box, self.part.road, most)
        return in_frame(self.bounds[vehicle_id], self.window.frame)


def _natural(vehicle_id: str) -> tuple[int, str]:
    """Sort 2 before 10, and numbers before names."""
    return (int(vehicle_id), "") if vehicle_id.isdecimal() else (1 << 62, vehicle_id)


def _local_frame(users: Iterable[RoadUser]) -> Frame:
    """Origin at the median position, in whole metres, so that no digit is lost by the shift."""
    poses = np.concatenate([user.poses for user in users] or [np.empty((0, 3))])
    if not len(poses):
        return Frame()
    x, y = np.median(poses[:, :2], axis=0)
    return Frame(float(round(x)), float(round(y)), 0.0)


# --- participants and obstacles --------------------------------------------------------------


def vehicle_dimensions(
    recorded: Mapping[str, float], info: VehicleInfo, config: VehiclesConfig
) -> tuple[Dimensions, str]:
    """Dimensions from the log, else from the config, else the defaults; and which of the three."""
    own = config.by_id.get(info.vehicle_id)
    sources: list[str] = []

    def pick(name: str, default: float) -> float:
        told = getattr(info.dimensions, name, None)
        for source, value in (
            ("log", recorded.get(name)),
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
