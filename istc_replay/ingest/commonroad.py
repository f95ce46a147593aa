"""CommonRoad scenarios (XML, 2018b and 2020a): trajectories of obstacles, standing obstacles, lanelets."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from istc_replay.datatypes import SceneObstacle, StaticScene
from istc_replay.errors import LogError
from istc_replay.ingest.foreign import (
    BadValueError,
    ForeignRecording,
    Gathered,
    above_zero,
    finite,
    nanoseconds,
    turned,
    vehicle_name,
)
from istc_replay.ingest.lanelets import Lanelets
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.xml_stream import Progress, read_xml

ROOT = "commonRoad"
_ROLES = {"pedestrian": "pedestrian", "bicycle": "bicycle"}
_NOT_VEHICLES = {"constructionZone", "roadBoundary", "building", "pillar", "median_strip", "unknown", "train"}
_OBSTACLES = ("obstacle", "dynamicObstacle", "staticObstacle")
_STATES = ("initialState", "state")
#: Elements of a state, and what they tell.
_TOLD = {
    "orientation": "heading_rad",
    "velocity": "speed_mps",
    "acceleration": "acceleration_mps2",
    "steeringAngle": "steering_rad",
}
_INTERVAL = {"exact": 0, "intervalStart": 1, "intervalEnd": 2}


@dataclass(slots=True)
class _Obstacle:
    """An obstacle as far as it is read."""

    obstacle_id: str
    line: int
    standing: bool
    type: str = ""
    length_m: float | None = None
    width_m: float | None = None
    offset: tuple[float, float] = (0.0, 0.0)
    outline: list[tuple[float, float]] = field(default_factory=list)
    states: list[dict[str, float]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    sets: int = 0
    fault: str = ""


class _Scenario:
    """Takes in a scenario, an obstacle or a lanelet at a time."""

    def __init__(self, problems: Problems) -> None:
        self.states = Gathered(problems)
        self.obstacles: list[SceneObstacle] = []
        self.lanelets = Lanelets(problems)
        self.skipped = {"planningProblem": 0}
        self._problems = problems
        self._step_s = 0.0
        self._now: _Obstacle | None = None
        self._state: dict[str, float] = {}
        self._state_line, self._state_fault = 0, ""
        self._interval: dict[int, float] = {}
        self._point: dict[str, float] = {}

    def start(self, path: tuple[str, ...], attributes: dict[str, str], line: int) -> None:
        name = path[-1]
        if len(path) == 1:
            try:
                self._step_s = above_zero(attributes.get("timeStepSize", ""), "timeStepSize")
            except BadValueError as error:
                raise LogError(f"line {line}: {error}; it is the length of a time step in s") from None
        elif len(path) == 2 and name in self.skipped:
            self.skipped[name] += 1
        elif len(path) == 2 and name == "lanelet":
            self.lanelets.start(attributes.get("id", ""), line)
        elif len(path) == 2 and name in _OBSTACLES:
            self._now = _Obstacle(attributes.get("id", ""), line, name == "staticObstacle")
        elif self._now is not None:
            if name in _STATES:
                self._state, self._state_line, self._state_fault = {}, line, ""
            elif name == "occupancy":
                self._now.sets += 1
            elif name in _TOLD or name == "time":
                self._interval = {}

    def end(self, path: tuple[str, ...], text: str, line: int) -> None:
        now, name = self._now, path[-1]
        if now is None:
            if len(path) > 1 and path[1] == "lanelet":
                self.lanelets.end(path, text, line)
            return
        try:
            if len(path) == 2:
                self._now = None
                self._finish(now)
            elif len(path) == 3 and name == "type":
                now.type = text
            elif len(path) == 3 and name == "role":  # 2018b
                now.standing = text == "static"
            elif "shape" in path:
                self._shape(now, path, name, text)
            elif "occupancySet" not in path:
                self._of_state(now, path, name, text)
        except BadValueError as error:
            if any(part in _STATES for part in path):
                self._state_fault = self._state_fault or f"line {line}: {error}"
            else:
                now.fault = now.fault or f"line {line}: {error}"
            if len(path) == 2:
                self._refuse(now)
            elif name in _STATES:
                self._leave_out(now)

    def _shape(self, now: _Obstacle, path: tuple[str, ...], name: str, text: str) -> None:
        if name in ("length", "width"):
            setattr(now, f"{name}_m", above_zero(text, name))
        elif name == "radius":
            now.length_m = now.width_m = 2.0 * above_zero(text, name)
        elif name in ("x", "y"):
            self._point[name] = finite(text, name)
        elif name == "center":
            now.offset = self._taken()
        elif name == "point" and "polygon" in path:
            now.outline.append(self._taken())

    def _taken(self) -> tuple[float, float]:
        point, self._point = self._point, {}
        if len(point) < 2:
            raise BadValueError("a point without x or y")
        return point["x"], point["y"]

    def _of_state(self, now: _Obstacle, path: tuple[str, ...], name: str, text: str) -> None:
        if name in _INTERVAL:
            self._interval[_INTERVAL[name]] = finite(text, path[-2])
        elif name in _TOLD or name == "time":
            self._state[_TOLD.get(name, name)] = self._middle(name)
        elif name in ("x", "y") and "position" in path:
            self._point[name] = finite(text, name)
        elif name == "position":
            if path[-1] == "position" and len(self._point) == 2:
                self._state["x"], self._state["y"] = self._taken()
            self._point = {}
        elif name in _STATES:
            if self._state_fault or not {"x", "y", "time"} <= self._state.keys():
                raise BadValueError("a state without an exact position or time")
            now.states.append(self._state)
            now.lines.append(self._state_line)

    def _middle(self, name: str) -> float:
        told = self._interval
        if 0 in told:
            return told[0]
        if {1, 2} <= told.keys():
            self._problems.add("interval", f"an interval of {name} is taken as its middle", kind=name)
            return (told[1] + told[2]) / 2.0
        raise BadValueError(f"{name} is neither exact nor an interval")

    # --- whole obstacles -------------------------------------------------------------------------

    def _refuse(self, now: _Obstacle) -> None:
        self._problems.lose("bad_value", f"{now.fault}; obstacle {quoted(now.obstacle_id, 40)} is left out")

    def _leave_out(self, now: _Obstacle) -> None:
        who = quoted(now.obstacle_id, 40)
        detail = f"{self._state_fault}; this state of obstacle {who} is left out"
        self._problems.lose("bad_value", detail)

    def _finish(self, now: _Obstacle) -> None:
        if now.outline:
            self._bound(now)
        if now.fault:
            self._refuse(now)
            return
        if now.sets:
            detail = "predicted sets of obstacles are no recorded states: left out"
            self._problems.add("occupancy_set", detail, times=now.sets)
        vehicle = vehicle_name(now.obstacle_id)
        if now.standing or (now.type == "parkedVehicle" and len(now.states) == 1):
            self._stands(vehicle, now)
            return
        role = "other" if now.type in _NOT_VEHICLES else _ROLES.get(now.type, "vehicle")
        for state, line in zip(now.states, now.lines, strict=True):
            try:
                time_ns = nanoseconds(repr(state["time"]), "time", self._step_s)
                self.states.add(time_ns, vehicle, role, self._numbers(state, now))
            except BadValueError as error:
                who = quoted(now.obstacle_id, 40)
                detail = f"line {line}: a state of obstacle {who} is left out: {error}"
                self._problems.lose("bad_value", detail)

    def _numbers(self, state: dict[str, float], now: _Obstacle) -> dict[str, float | None]:
        heading = state.get("heading_rad")
        if heading is not None:
            heading = turned(heading)
        x, y = _moved(state["x"], state["y"], heading, now.offset)
        numbers: dict[str, float | None] = {name: state.get(name) for name in _TOLD.values()}
        return numbers | {
            "x_m": x,
            "y_m": y,
            "heading_rad": heading,
            "length_m": now.length_m,
            "width_m": now.width_m,
        }

    def _stands(self, vehicle: str, now: _Obstacle) -> None:
        if not now.states or now.length_m is None or now.width_m is None:
            raise BadValueError(f"standing obstacle {quoted(vehicle, 40)} has no place or no size")
        state = now.states[0]
        heading = state.get("heading_rad", 0.0)
        x, y = _moved(state["x"], state["y"], heading, now.offset)
        self.obstacles.append(SceneObstacle(vehicle, x, y, turned(heading), now.length_m, now.width_m))

    def _bound(self, now: _Obstacle) -> None:
        """Take a polygon's box, along its obstacle's heading."""
        xs, ys = ([point[axis] for point in now.outline] for axis in (0, 1))
        now.length_m, now.width_m = max(xs) - min(xs), max(ys) - min(ys)
        now.offset = ((max(xs) + min(xs)) / 2.0, (max(ys) + min(ys)) / 2.0)
        if min(now.length_m, now.width_m) <= 0.0:
            now.fault = now.fault or f"line {now.line}: a polygon without an area"
        self._problems.add("polygon", "a polygon's box is taken for its shape")


def _moved(x: float, y: float, heading: float | None, offset: tuple[float, float]) -> tuple[float, float]:
    """Move a reference point to the box centre, which lies at an offset in the turned vehicle."""
    if offset == (0.0, 0.0):
        return x, y
    if heading is None:
        raise BadValueError("a shape beside its reference point, and no orientation to turn it by")
    along, across = math.cos(heading), math.sin(heading)
    return x + along * offset[0] - across * offset[1], y + across * offset[0] + along * offset[1]


def read_commonroad(path: Path, progress: Progress) -> ForeignRecording:
    """Read the recorded obstacles of a scenario; its time step 0 is time 0.

    Raises
    ------
    LogError
        If it is not XML, is above a limit, or holds no state.
    """
    problems = Problems()
    scenario = _Scenario(problems)
    try:
        cut = read_xml(path, scenario, progress)
    except LogError as error:
        raise LogError(str(error) if str(error).startswith(str(path)) else f"{path}: {error}") from None
    if cut:
        problems.lose("truncated", f"{cut}; the obstacles before it are read")
    if not len(scenario.states):
        why = problems.first_loss or "it needs dynamic obstacles with trajectories"
        raise LogError(f"{path}: holds no recorded state: {why}")
    notes = [
        f"{count} {name}s are not recorded motion: left out"
        for name, count in scenario.skipped.items()
        if count
    ]
    lanes = scenario.lanelets
    if lanes.skipped:
        notes.append(f"{lanes.skipped} lanelets on which no car drives: left out")
    return ForeignRecording(
        "CommonRoad",
        scenario.states.table(),
        StaticScene(tuple(lanes.lanes.values()), tuple(scenario.obstacles)),
        problems.found(),
        not problems.lost,
        tuple(notes),
    )
