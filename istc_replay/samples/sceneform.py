"""The form of a scene file: start and goal poses of vehicles, obstacles and a map, as JSON."""

from __future__ import annotations

import json
import math
from typing import Annotated, Any, NoReturn, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from istc_replay.datatypes import Dimensions
from istc_replay.errors import ScenarioError

Coordinate = Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False)]
Size = Annotated[float, Field(gt=0, le=50, allow_inf_nan=False)]
_MAP_SIDE_MAX_M = 2000.0


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, use_attribute_docstrings=True)


class Box(_Part):
    """An axis-aligned rectangle of the map frame."""

    x_min_m: Coordinate
    """Western edge."""
    x_max_m: Coordinate
    """Eastern edge."""
    y_min_m: Coordinate
    """Southern edge."""
    y_max_m: Coordinate
    """Northern edge."""

    @model_validator(mode="after")
    def _edges_in_order(self) -> Self:
        if not (self.x_min_m < self.x_max_m and self.y_min_m < self.y_max_m):
            raise ValueError("x_min_m must be below x_max_m, and y_min_m below y_max_m")
        return self


class ScenePose(_Part):
    """A pose of the rear axle's centre."""

    x_m: Coordinate
    """East."""
    y_m: Coordinate
    """North."""
    heading_rad: Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi, allow_inf_nan=False)]
    """Counter-clockwise from east."""


class SceneCar(_Part):
    """The one kind of vehicle of a scene."""

    length_m: Size
    """Box length."""
    width_m: Size
    """Box width."""
    wheelbase_m: Size
    """Distance between the axles."""
    rear_overhang_m: Annotated[float, Field(ge=0, le=50, allow_inf_nan=False)]
    """From the rear axle back to the rear of the box."""
    min_turn_radius_m: Size | None = None
    """Least turning radius of the rear axle; unset: what a steering angle of 0.6 rad gives."""

    @model_validator(mode="after")
    def _axles_in_the_box(self) -> Self:
        if self.rear_overhang_m + self.wheelbase_m > self.length_m:
            raise ValueError("rear_overhang_m + wheelbase_m must be at most length_m")
        return self

    @property
    def dimensions(self) -> Dimensions:
        """The box and axles."""
        to_centre_m = self.length_m / 2.0 - self.rear_overhang_m
        return Dimensions(self.length_m, self.width_m, self.wheelbase_m, round(to_centre_m, 9))


class SceneVehicle(_Part):
    """A vehicle's task: from a standing pose to another."""

    id: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
    """Name, also of its topic."""
    start: ScenePose
    """Where it is at the start of the recording."""
    goal: ScenePose
    """Where it comes to stand."""

    @model_validator(mode="after")
    def _goes_somewhere(self) -> Self:
        if math.hypot(self.goal.x_m - self.start.x_m, self.goal.y_m - self.start.y_m) < 1.0:
            raise ValueError("start and goal must be at least 1 m apart")
        return self


class SceneFile(_Part):
    """A scene: vehicles that want from a start to a goal on a map with obstacles.

    Metres and radians in one right-handed frame, x east, y north. Poses are of the rear axle's
    centre; all vehicles are alike and drive at one speed.
    """

    name: Annotated[str, Field(min_length=1, max_length=200)]
    """What the scene is called."""
    note: str = ""
    """A remark for people."""
    source: str = ""
    """Where the scene comes from."""
    map: Box
    """What no vehicle leaves; its sides are at most 2000 m."""
    speed_mps: Annotated[float, Field(ge=0.5, le=50, allow_inf_nan=False)]
    """Speed of every vehicle until it brakes for its goal."""
    vehicle: SceneCar
    """Dimensions of every vehicle."""
    vehicles: Annotated[list[SceneVehicle], Field(min_length=1, max_length=100)]
    """The vehicles, each with an id of its own."""
    obstacles: Annotated[list[Box], Field(max_length=1000)]
    """What stands in the way."""

    @model_validator(mode="after")
    def _is_sound(self) -> Self:
        names = [vehicle.id for vehicle in self.vehicles]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"vehicle id {twice[0]!r} is given twice; each id must be unique")
        sides = (self.map.x_max_m - self.map.x_min_m, self.map.y_max_m - self.map.y_min_m)
        if max(sides) > _MAP_SIDE_MAX_M:
            raise ValueError(f"a side of the map has {max(sides):g} m; at most {_MAP_SIDE_MAX_M:g} m")
        return self


def parse_scene(text: str, name: str = "scene") -> SceneFile:
    """Read a scene from JSON text.

    Raises
    ------
    ScenarioError
        If the text is not JSON or breaks the form; one line that names each fault.
    """
    try:
        values = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{name}: not JSON: {error}") from None
    try:
        return SceneFile.model_validate(values)
    except ValidationError as error:
        faults = "; ".join(_fault(fault) for fault in error.errors()[:5])
        raise ScenarioError(f"{name}: {faults}; the form is schemas/scene.schema.json") from None


def scene_schema() -> dict[str, Any]:
    """Return the JSON Schema of the form."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **SceneFile.model_json_schema()}


def _no_constant(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a number of JSON")


def _fault(fault: Any) -> str:
    key = ".".join(str(part) for part in fault["loc"]) or "scene"
    if fault["type"] == "extra_forbidden":
        return f"unknown key {key}"
    if fault["type"] == "missing":
        return f"missing key {key}"
    shown = "" if isinstance(fault["input"], dict) else f" = {fault['input']!r:.60}"
    return f"{key}{shown}: {fault['msg']}"
