"""Decoding the project's own scenes, `istc.v1.Scene`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError

from istc_replay.config import VehiclesConfig
from istc_replay.datatypes import (
    Dimensions,
    FloatArray,
    LaneLine,
    MapBounds,
    RoadArea,
    RoadEdge,
    SceneObstacle,
    VehicleInfo,
    read_only,
)
from istc_replay.ingest.payload import PayloadError
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.scene import SceneParts
from istc_replay.messages import message
from istc_replay.polyline import LINE_POINTS

_LINE_RULE = f"it needs at least two finite points, and no more than {LINE_POINTS}"


class SceneReader:
    """Reads `istc.v1.Scene` into the parts of the scene."""

    def __init__(self, parts: SceneParts, vehicles: VehiclesConfig, problems: Problems) -> None:
        self._type = message("Scene")
        self._parts = parts
        self._vehicles = vehicles
        self._problems = problems

    def read(self, data: bytes) -> None:
        """Take in one payload.

        Raises
        ------
        PayloadError
            If it is no scene.
        """
        scene = _parse(self._type, data)
        for line in scene.lane_lines:
            self._lane_line(line)
        for edge in scene.road_edges:
            self._road_edge(edge)
        for area in scene.road_areas:
            self._road_area(area)
        for obstacle in scene.obstacles:
            self._obstacle(obstacle)
        for vehicle in scene.vehicles:
            self._vehicle(vehicle)
        if scene.HasField("bounds"):
            self._bounds(scene.bounds)

    def _refuse(self, what: str, rule: str) -> None:
        self._problems.add("scene", f"{what} of the scene is left out: {rule}")

    def _lane_line(self, line: Any) -> None:
        points = points_of(line.points)
        if not is_line(points):
            self._refuse(f"lane line {quoted(line.lane_id)}", _LINE_RULE)
            return
        edges = [points_of(line.left), points_of(line.right)] if line.left or line.right else None
        if edges is not None and not all(is_line(edge) for edge in edges):
            self._refuse(f"edges of lane line {quoted(line.lane_id)}", f"of both sides, {_LINE_RULE}")
            edges = None
        self._parts.lane_lines[line.lane_id] = LaneLine(
            line.lane_id, points, line.vehicle_id or None, *(edges or (None, None))
        )

    def _road_edge(self, edge: Any) -> None:
        points = points_of(edge.points)
        if not is_line(points):
            self._refuse(f"road edge {quoted(edge.edge_id)}", _LINE_RULE)
            return
        self._parts.road_edges[edge.edge_id] = RoadEdge(edge.edge_id, points)

    def _road_area(self, area: Any) -> None:
        points = points_of(area.points)
        if len(points) < 3 or not is_line(points):
            self._refuse(
                f"road area {quoted(area.area_id)}", "it needs at least three finite points, and not too many"
            )
            return
        self._parts.road_areas[area.area_id] = RoadArea(area.area_id, points)

    def _obstacle(self, box: Any) -> None:
        numbers = (box.x_m, box.y_m, box.heading_rad, box.length_m, box.width_m)
        if not _finite(numbers) or min(box.length_m, box.width_m) <= 0.0:
            self._refuse(f"obstacle {quoted(box.obstacle_id)}", "it needs finite numbers and a size above 0")
            return
        self._parts.obstacles[box.obstacle_id] = SceneObstacle(box.obstacle_id, *numbers)

    def _bounds(self, bounds: Any) -> None:
        numbers = (bounds.x_min_m, bounds.x_max_m, bounds.y_min_m, bounds.y_max_m)
        if not _finite(numbers) or numbers[0] >= numbers[1] or numbers[2] >= numbers[3]:
            self._refuse("the map's bounds", "they need finite numbers, minimum below maximum")
            return
        self._parts.bounds = MapBounds(*numbers)

    def _vehicle(self, vehicle: Any) -> None:
        priority = vehicle.priority if vehicle.HasField("priority") else None
        if priority is not None and not (math.isfinite(priority) and priority > 0.0):
            self._refuse(f"priority of vehicle {quoted(vehicle.vehicle_id)}", "it must be above 0")
            priority = None
        dimensions = _dimensions(vehicle, self._vehicles)
        if vehicle.HasField("dimensions") and dimensions is None:
            self._refuse(f"size of vehicle {quoted(vehicle.vehicle_id)}", "it must be finite and above 0")
        self._parts.vehicles[vehicle.vehicle_id] = VehicleInfo(vehicle.vehicle_id, priority, dimensions)


def points_of(points: Iterable[Any]) -> FloatArray:
    """Points of a message as an array (P, 2) [m]."""
    return read_only([(point.x_m, point.y_m) for point in points], columns=2)


def is_line(points_m: FloatArray) -> bool:
    """Whether points (P, 2) make a line: two at least, not too many, all finite."""
    return 2 <= len(points_m) <= LINE_POINTS and bool(np.isfinite(points_m).all())


def _parse(type_: Any, data: bytes) -> Any:
    try:
        return type_.FromString(data)
    except DecodeError as error:
        raise PayloadError(f"not an {type_.DESCRIPTOR.full_name}: {error}") from None


def _optional(source: Any, *names: str) -> list[float | None]:
    return [getattr(source, name) if source.HasField(name) else None for name in names]


def _lengths(source: Any) -> tuple[float | None, ...]:
    if not source.HasField("dimensions"):
        return None, None, None, None
    box = source.dimensions
    # Length and width carry no presence: 0 is how protobuf leaves them unset.
    return box.length_m or None, box.width_m or None, *_optional(box, "wheelbase_m", "rear_axle_to_centre_m")


def _dimensions(source: Any, vehicles: VehiclesConfig) -> Dimensions | None:
    length_m, width_m, wheelbase_m, rear_m = _lengths(source)
    if length_m is None or width_m is None:
        return None
    wheelbase_m = vehicles.wheelbase_ratio * length_m if wheelbase_m is None else wheelbase_m
    rear_m = wheelbase_m / 2.0 if rear_m is None else rear_m
    sound = _finite((length_m, width_m, wheelbase_m, rear_m)) and min(length_m, width_m, wheelbase_m) > 0.0
    return Dimensions(length_m, width_m, wheelbase_m, rear_m) if sound else None


def _finite(numbers: Iterable[float]) -> bool:
    return all(math.isfinite(number) for number in numbers)
