"""What stands still in a log, and what it says of its vehicles once and for all [m, rad, map frame]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from istc_replay.datatypes.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Dimensions:
    """A vehicle's box and axles [m].

    `rear_axle_to_centre_m` is the distance from the rear axle forward to the box centre:
    wheelbase / 2 + (front overhang - rear overhang) / 2.
    """

    length_m: float
    width_m: float
    wheelbase_m: float
    rear_axle_to_centre_m: float


@dataclass(frozen=True, slots=True, eq=False)
class LaneLine:
    """A lane's centre line (P, 2) in driving order [m, map frame]; `vehicle_id` says whose intent it is.

    `left_m` (L, 2) and `right_m` (R, 2) are its edges in driving order: both, or None where they are
    not known. What lies between the edges of all lanes, and in areas, is the road.
    """

    lane_id: str
    points_m: FloatArray
    vehicle_id: str | None = None
    left_m: FloatArray | None = None
    right_m: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RoadEdge:
    """What no vehicle drives across, a polyline (P, 2) [m, map frame]."""

    edge_id: str
    points_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RoadArea:
    """A part of the road told by its outline (P, 2) [m, map frame]; the last point joins the first."""

    area_id: str
    points_m: FloatArray


@dataclass(frozen=True, slots=True)
class SceneObstacle:
    """A standing oriented box [m, rad, map frame]."""

    obstacle_id: str
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    width_m: float


@dataclass(frozen=True, slots=True)
class MapBounds:
    """The axis-aligned rectangle of the map frame that no vehicle leaves [m]."""

    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float


@dataclass(frozen=True, slots=True)
class VehicleInfo:
    """What the log says of a vehicle once and for all; None where it is silent."""

    vehicle_id: str
    priority: float | None = None
    dimensions: Dimensions | None = None


@dataclass(frozen=True, slots=True)
class StaticScene:
    """Lane lines, obstacles, bounds, per-vehicle facts, road edges and road areas of a log."""

    lane_lines: tuple[LaneLine, ...] = ()
    obstacles: tuple[SceneObstacle, ...] = ()
    bounds: MapBounds | None = None
    vehicles: tuple[VehicleInfo, ...] = ()
    road_edges: tuple[RoadEdge, ...] = ()
    road_areas: tuple[RoadArea, ...] = ()

    @property
    def edges_m(self) -> list[FloatArray]:
        """All polylines (P, 2) that edge the road: of its lanes and areas, and what nobody drives across."""
        sides = [side for line in self.lane_lines for side in (line.left_m, line.right_m)]
        known = [side for side in sides if side is not None] + [edge.points_m for edge in self.road_edges]
        return known + [np.vstack([area.points_m, area.points_m[:1]]) for area in self.road_areas]
