"""Gathering the static scene of a log from the messages that tell of it."""

from __future__ import annotations

from istc_replay.datatypes import LaneLine, MapBounds, SceneObstacle, StaticScene, VehicleInfo


class SceneParts:
    """The parts of the scene by their ids; what is told later replaces what was told before."""

    def __init__(self) -> None:
        self.lane_lines: dict[str, LaneLine] = {}
        self.obstacles: dict[str, SceneObstacle] = {}
        self.vehicles: dict[str, VehicleInfo] = {}
        self.bounds: MapBounds | None = None

    def scene(self) -> StaticScene:
        """Return the scene, in the order in which its parts were first told."""
        return StaticScene(
            tuple(self.lane_lines.values()),
            tuple(self.obstacles.values()),
            self.bounds,
            tuple(self.vehicles.values()),
        )
