"""Gathering the static scene of a log from the messages that tell of it."""

from __future__ import annotations

from collections.abc import Callable

from istc_replay.datatypes import (
    LaneLine,
    MapBounds,
    RoadArea,
    RoadEdge,
    SceneObstacle,
    StaticScene,
    VehicleInfo,
)


class SceneParts:
    """The parts of the scene by their ids; what is told later replaces what was told before.

    What can only be joined when everything is told is added to `last`.
    """

    def __init__(self) -> None:
        self.last: list[Callable[[], None]] = []
        self.lane_lines: dict[str, LaneLine] = {}
        self.road_edges: dict[str, RoadEdge] = {}
        self.road_areas: dict[str, RoadArea] = {}
        self.obstacles: dict[str, SceneObstacle] = {}
        self.vehicles: dict[str, VehicleInfo] = {}
        self.bounds: MapBounds | None = None

    def scene(self) -> StaticScene:
        """Return the scene, in the order in which its parts were first told."""
        for join in self.last:
            join()
        self.last.clear()
        return StaticScene(
            tuple(self.lane_lines.values()),
            tuple(self.obstacles.values()),
            self.bounds,
            tuple(self.vehicles.values()),
            tuple(self.road_edges.values()),
            tuple(self.road_areas.values()),
        )
