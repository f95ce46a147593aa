"""The messages of a result.mcap as rows of its tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from google.protobuf.message import DecodeError

from istc_replay import messages
from istc_replay.datatypes import (
    Dimensions,
    LaneLine,
    MapBounds,
    RoadArea,
    RoadEdge,
    SceneObstacle,
    StaticScene,
    VehicleInfo,
)
from istc_replay.ingest.istc import points_of
from istc_replay.ingest.problems import quoted
from istc_replay.ingest.records import Channel, Message

Row = tuple[Any, ...]

_KINEMATICS = (
    "heading_rad",
    "speed_mps",
    "acceleration_mps2",
    "steering_rad",
    "steering_rate_radps",
    "jerk_mps3",
)


@dataclass(slots=True)
class ResultRows:
    """The rows of a result's tables as its messages come in, and its scenes."""

    states: list[Row] = field(default_factory=list)
    windows: list[Row] = field(default_factory=list)
    corridors: list[Row] = field(default_factory=list)
    obstacles: list[Row] = field(default_factory=list)
    solves: list[Row] = field(default_factory=list)
    certificates: list[Row] = field(default_factory=list)
    findings: list[Row] = field(default_factory=list)
    scenes: list[StaticScene] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)


def _known(message: Any, name: str) -> Any:
    return getattr(message, name) if message.HasField(name) else None


def _collect_state(rows: ResultRows, state: Any, topic: str) -> None:
    source = topic.split("/")[2]
    size: Row = (None,) * 4
    if state.HasField("dimensions"):
        box = state.dimensions
        size = (box.length_m, box.width_m, _known(box, "wheelbase_m"), _known(box, "rear_axle_to_centre_m"))
    window = _known(state, "window")
    if source != "recorded" and window is None:
        raise ValueError(f"a {source} state without its window")
    motion = (_known(state, name) for name in _KINEMATICS)
    rows.states.append(
        (
            *(source, window, state.vehicle_id, state.time_ns, state.x_m, state.y_m),
            *(*motion, *size, state.role or "vehicle", topic, rows.counts[topic], state.derived),
        )
    )


def _collect_guidance(rows: ResultRows, guidance: Any, topic: str) -> None:
    columns = (guidance.times_ns, guidance.x_m, guidance.y_m, guidance.heading_rad)
    if len({len(column) for column in columns}) > 1:
        raise ValueError(f"a guidance of {len(columns[0])} times whose places differ in number")
    rows.states += [
        (
            "guidance",
            guidance.window,
            guidance.vehicle_id,
            *place,
            *(None,) * 10,
            topic,
            rows.counts[topic],
            0,
        )
        for place in zip(*columns, strict=True)
    ]


def _collect_corridors(rows: ResultRows, corridors: Any, _: str) -> None:
    rows.windows.append((corridors.window, corridors.start_ns, corridors.end_ns))
    frame = _frame(corridors.frame)
    for corridor in corridors.corridors:
        cubes, pivots, references = corridor.cubes, corridor.pivots, corridor.references
        if not len(pivots) == len(references) == len(cubes) + 1:
            counts = f"{len(cubes)} cubes, {len(pivots)} pivotal and {len(references)} reference points"
            raise ValueError(f"a corridor of {counts}; of both there is one more than cubes")
        for i, cube in enumerate(cubes):
            points = [(point.x_m, point.y_m) for point in (*pivots[i : i + 2], *references[i : i + 2])]
            ends = tuple(value for point in points for value in point)
            rows.corridors.append((corridors.window, corridor.vehicle_id, *_box(cube), *ends, *frame))


def _collect_obstacles(rows: ResultRows, obstacles: Any, _: str) -> None:
    frame = _frame(obstacles.frame)
    rows.obstacles += [
        (obstacles.window, obstacle.obstacle_id, *_box(box), *frame)
        for obstacle in obstacles.obstacles
        for box in obstacle.boxes
    ]


def _frame(frame: Any) -> Row:
    return frame.yaw_rad, frame.x_m, frame.y_m


def _box(cube: Any) -> Row:
    return cube.k, cube.start_ns, cube.end_ns, cube.x_min_m, cube.x_max_m, cube.y_min_m, cube.y_max_m


def _collect_solve(rows: ResultRows, solve: Any, _: str) -> None:
    told = (solve.window, solve.vehicle_id or None, solve.layer, solve.stage, solve.solver, solve.status)
    values = (_known(solve, name) for name in ("objective", "bound", "gap"))
    counts = (_known(solve, name) for name in ("iterations", "nodes", "binaries"))
    rows.solves.append((*told, *values, None, *counts, solve.detail))


def _collect_certificate(rows: ResultRows, c: Any, _: str) -> None:
    margin, time_ns = _known(c, "margin"), _known(c, "time_ns")
    rows.certificates.append(
        (c.window, c.check, c.verdict, margin, c.unit, time_ns, list(c.vehicles), c.detail)
    )


def _collect_finding(rows: ResultRows, f: Any, _: str) -> None:
    value, threshold = _known(f, "value"), _known(f, "threshold")
    rows.findings.append(
        (
            *(f.finding_id, f.rule, f.verdict, f.severity or None, list(f.vehicles)),
            *(f.start_ns, f.worst_ns, f.end_ns, _known(f, "x_m"), _known(f, "y_m"), value, f.unit),
            *(threshold, f.threshold_source, f.topic, _known(f, "message_index")),
            *(f.encounter_id or None, f.detail),
        )
    )


def _collect_scene(rows: ResultRows, scene: Any, _: str) -> None:
    lines = [
        LaneLine(
            line.lane_id,
            points_of(line.points),
            line.vehicle_id or None,
            points_of(line.left) if line.left else None,
            points_of(line.right) if line.right else None,
        )
        for line in scene.lane_lines
    ]
    edges = [RoadEdge(edge.edge_id, points_of(edge.points)) for edge in scene.road_edges]
    areas = [RoadArea(area.area_id, points_of(area.points)) for area in scene.road_areas]
    obstacles = [
        SceneObstacle(**{name: getattr(o, name) for name in SceneObstacle.__slots__}) for o in scene.obstacles
    ]
    bounds = None
    if scene.HasField("bounds"):
        bounds = MapBounds(**{name: getattr(scene.bounds, name) for name in MapBounds.__slots__})
    vehicles = [
        VehicleInfo(v.vehicle_id, _known(v, "priority"), _dimensions(_known(v, "dimensions")))
        for v in scene.vehicles
    ]
    rows.scenes.append(
        StaticScene(tuple(lines), tuple(obstacles), bounds, tuple(vehicles), tuple(edges), tuple(areas))
    )


def _dimensions(box: Any) -> Dimensions | None:
    if box is None:
        return None
    return Dimensions(**{name: getattr(box, name) for name in Dimensions.__slots__})


#: The kind of message of each topic, or of each family of topics that ends in a slash.
_COLLECTORS: dict[str, tuple[str, Callable[[ResultRows, Any, str], None]]] = {
    "/istc/static": ("Scene", _collect_scene),
    "/istc/recorded/": ("VehicleState", _collect_state),
    "/istc/planned/": ("VehicleState", _collect_state),
    "/istc/rejected/": ("VehicleState", _collect_state),
    "/istc/guidance/": ("Guidance", _collect_guidance),
    "/istc/corridors": ("Corridors", _collect_corridors),
    "/istc/obstacles": ("Obstacles", _collect_obstacles),
    "/istc/solves": ("SolveReport", _collect_solve),
    "/istc/certificates": ("Certificate", _collect_certificate),
    "/istc/findings": ("Finding", _collect_finding),
}


_STATES = frozenset(f"/istc/{source}/" for source in ("recorded", "planned", "rejected", "guidance"))


def holds_rows(channel: Channel) -> bool:
    """Tell whether the channel's topic is one that the tables are made of."""
    return _family(channel.topic) in _COLLECTORS


def holds_states(channel: Channel) -> bool:
    """Tell whether the channel's topic is one that the table of states is made of."""
    return _family(channel.topic) in _STATES


def skip(rows: ResultRows, message: Message) -> None:
    """Count a message that is not read."""
    rows.counts[message.channel.topic] += 1


def collect(rows: ResultRows, message: Message) -> None:
    """Add the rows of one message of a channel that `holds_rows`.

    Raises
    ------
    ValueError
        If the message is not what its topic promises.
    """
    channel = message.channel
    kind, add = _COLLECTORS[_family(channel.topic)]
    expected = f"{messages.PACKAGE}.{kind}"
    found = channel.schema.name if channel.schema is not None else ""
    if channel.message_encoding != "protobuf" or found != expected:
        raise ValueError(
            f"it is {quoted(channel.message_encoding)} of {quoted(found)}, not protobuf of {expected}"
        )
    try:
        add(rows, messages.message(kind).FromString(message.data), channel.topic)
        rows.counts[channel.topic] += 1
    except DecodeError as error:
        raise ValueError(f"not a message of {expected}: {error}") from None


def _family(topic: str) -> str:
    parts = topic.split("/")
    return topic if len(parts) < 4 else "/".join(parts[:3]) + "/"
