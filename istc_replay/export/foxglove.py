"""A result as Foxglove messages: transforms, planned paths and a scene, all in the frame `map`.

Every message of `/istc/scene` holds all there is to see at its instant, since a player that jumps
in time shows the last message alone; whatever it shows ends with the next message.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import groupby

import numpy as np
from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.duration_pb2 import Duration
from google.protobuf.timestamp_pb2 import Timestamp

from istc_replay.config import VehiclesConfig
from istc_replay.datatypes import FloatArray, Log, StaticScene, Window, WindowPlan
from istc_replay.export.colours import EDGE, LANE, OBSTACLE, Colour
from istc_replay.export.film import Film, Frame, film
from istc_replay.export.film_tracks import LAST_NS, Block, Track, blocks
from istc_replay.export.placing import first_ns, planned_motions, topic_name
from istc_replay.export.stamped import Stamped, in_order, merged
from istc_replay.units import NS_PER_S

MAP = "map"
_CAR_HEIGHT_M, _LABEL_HEIGHT_M = 1.5, 0.6
#: Points of lane lines in the whole file, before they stand in the first scene alone.
_LINE_POINTS_LIMIT = 500_000


def foxglove_messages(
    log: Log, plans: Sequence[WindowPlan], windows: Sequence[Window], vehicles: VehiclesConfig
) -> Iterator[Stamped]:
    """Give `/tf`, `/istc/path/<vehicle>` and `/istc/scene`, in their order in the file.

    Transforms lead from `map` to the box centres `recorded/<vehicle>` at every recorded state and
    `vehicle/<vehicle>` at every knot of the plan, and to `corridor/<window>`. Where windows lie
    over each other, the later window's plan is shown.

    Parameters
    ----------
    log : Log
        What was recorded.
    plans : sequence of WindowPlan
        One a window, in order; gone through more than once.
    windows : sequence of Window
        Those of the plans.
    vehicles : VehiclesConfig
        The sizes at which vehicles of unknown size are drawn.
    """
    starts_ns = [window.start_ns for window in windows]
    made = film(log, plans, starts_ns, vehicles)
    boxes = (
        (start_ns, blocks(plan, until_ns))
        for plan, start_ns, until_ns in zip(plans, starts_ns, [*starts_ns[1:], LAST_NS], strict=False)
    )
    return merged(
        _transforms(made, windows),
        _paths(plans, made),
        _scenes(made.frames(boxes), len(made.times_ns), log.scene, first_ns(log, windows)),
    )


# --- transforms and paths --------------------------------------------------------------------


def _transforms(made: Film, windows: Sequence[Window]) -> Iterator[Stamped]:
    frames = [
        (
            window.start_ns,
            f"corridor/{window.index}",
            [window.frame.x_m, window.frame.y_m, window.frame.yaw_rad],
        )
        for window in windows
    ]
    for start_ns, until_ns in made.spans():
        rows = [row for row in frames if start_ns <= row[0] < until_ns]
        for track in made.tracks:
            if start_ns <= track.times_ns[-1] and track.times_ns[0] < until_ns:
                here = slice(*np.searchsorted(track.times_ns, [start_ns, until_ns]))
                poses = track.poses[here].tolist()
                rows += [
                    (time_ns, track.frame_id, pose)
                    for time_ns, pose in zip(track.times_ns[here].tolist(), poses, strict=True)
                ]
        rows.sort(key=lambda row: row[0])
        for time_ns, group in groupby(rows, key=lambda row: row[0]):
            yield time_ns, "/tf", _transform(time_ns, group)


def _transform(time_ns: int, rows: Iterable[tuple[int, str, list[float]]]) -> FrameTransforms:
    stamp = timestamp(time_ns)
    transforms = [
        FrameTransform(
            timestamp=stamp,
            parent_frame_id=MAP,
            child_frame_id=frame_id,
            translation=Vector3(x=x, y=y, z=0.0),
            rotation=_rotation(heading),
        )
        for _, frame_id, (x, y, heading) in rows
    ]
    return FrameTransforms(transforms=transforms)


def _paths(plans: Iterable[WindowPlan], made: Film) -> Iterator[Stamped]:
    starts = {(vehicle_id, start_ns) for vehicle_id, start_ns, _ in made.planned}
    last_ns = max((end_ns for _, _, end_ns in made.planned), default=0)

    def of_window(plan: WindowPlan) -> Iterator[Stamped]:
        for motion in planned_motions(plan):
            topic = f"/istc/path/{topic_name(motion.vehicle_id)}"
            start_ns, end_ns = int(motion.times_ns[0]), int(motion.times_ns[-1])
            poses = [_pose(*pose) for pose in motion.poses.tolist()]
            yield start_ns, topic, PosesInFrame(timestamp=timestamp(start_ns), frame_id=MAP, poses=poses)
            followed = (motion.vehicle_id, end_ns) in starts
            if end_ns < last_ns and not followed:
                # A path has no lifetime: an empty one takes it off the screen.
                yield end_ns, topic, PosesInFrame(timestamp=timestamp(end_ns), frame_id=MAP)

    return in_order((plan.scenario.window.start_ns, of_window(plan)) for plan in plans)


# --- the scene -------------------------------------------------------------------------------


def _scenes(frames: Iterator[Frame], count: int, scene: StaticScene, start_ns: int) -> Iterator[Stamped]:
    still = SceneUpdate(entities=_still_entities(scene, start_ns))
    points = sum(len(line.points_m) for line in scene.lane_lines) + sum(map(len, scene.edges_m))
    repeated = points * count <= _LINE_POINTS_LIMIT
    yielded = False
    for time_ns, cars, boxes in frames:
        message = SceneUpdate()
        if repeated or not yielded:
            message.MergeFrom(still)
        message.entities.extend(_box_entity(block) for block in boxes)
        message.entities.extend(_car_entity(time_ns, *car) for car in cars)
        yielded = True
        yield time_ns, "/istc/scene", message
    if not yielded and still.entities:
        yield start_ns, "/istc/scene", still


def _car_entity(time_ns: int, track: Track, pose: Sequence[float], lifetime_ns: int) -> SceneEntity:
    x, y, heading = pose
    cube = CubePrimitive(
        pose=_pose(x, y, heading, _CAR_HEIGHT_M / 2.0),
        size=Vector3(x=track.length_m, y=track.width_m, z=_CAR_HEIGHT_M),
        color=_colour(track.colour, track.opacity),
    )
    label = TextPrimitive(
        pose=_pose(x, y, 0.0, _CAR_HEIGHT_M + _LABEL_HEIGHT_M),
        billboard=True,
        font_size=_LABEL_HEIGHT_M,
        color=_colour(track.colour, 1.0),
        text=track.label,
    )
    return SceneEntity(
        timestamp=timestamp(time_ns),
        frame_id=MAP,
        id=track.entity_id,
        lifetime=_duration(lifetime_ns),
        cubes=[cube],
        arrows=[_heading_arrow(track, pose)],
        texts=[label] if track.label else [],
    )


def _heading_arrow(track: Track, pose: Sequence[float]) -> ArrowPrimitive:
    """Where the front is: from the middle of the roof to the nose."""
    x, y, heading = pose
    reach, width = 0.5 * track.length_m, 0.25 * track.width_m
    return ArrowPrimitive(
        pose=_pose(x, y, heading, _CAR_HEIGHT_M),
        shaft_length=0.6 * reach,
        shaft_diameter=0.5 * width,
        head_length=0.4 * reach,
        head_diameter=width,
        color=_colour(track.colour, 1.0),
    )


def _box_entity(block: Block) -> SceneEntity:
    x, y, yaw = block.pose
    cube = CubePrimitive(
        pose=_pose(x, y, yaw, block.height_m / 2.0),
        size=Vector3(x=block.length_m, y=block.width_m, z=block.height_m),
        color=_colour(block.colour, block.opacity),
    )
    return SceneEntity(
        timestamp=timestamp(block.start_ns),
        frame_id=MAP,
        id=block.entity_id,
        lifetime=_duration(block.end_ns - block.start_ns),
        cubes=[cube],
    )


def _still_entities(scene: StaticScene, start_ns: int) -> list[SceneEntity]:
    """What stands for the whole log: lane lines, road, obstacles and bounds, without a lifetime."""
    stamp = timestamp(start_ns)
    entities = [
        SceneEntity(
            timestamp=stamp, frame_id=MAP, id=f"lane/{index}", lines=[_line(line.points_m, closed=False)]
        )
        for index, line in enumerate(scene.lane_lines)
    ]
    if scene.edges_m:
        lines = [_line(edge, closed=False, colour=EDGE) for edge in scene.edges_m]
        entities.append(SceneEntity(timestamp=stamp, frame_id=MAP, id="road", lines=lines))
    for obstacle in scene.obstacles:
        cube = CubePrimitive(
            pose=_pose(obstacle.x_m, obstacle.y_m, obstacle.heading_rad, 0.5),
            size=Vector3(x=obstacle.length_m, y=obstacle.width_m, z=1.0),
            color=_colour(OBSTACLE, 0.9),
        )
        name = f"standing/{topic_name(obstacle.obstacle_id)}"
        entities.append(SceneEntity(timestamp=stamp, frame_id=MAP, id=name, cubes=[cube]))
    if scene.bounds is not None:
        b = scene.bounds
        corners = np.array(
            [[b.x_min_m, b.y_min_m], [b.x_max_m, b.y_min_m], [b.x_max_m, b.y_max_m], [b.x_min_m, b.y_max_m]]
        )
        lines = [_line(corners, closed=True)]
        entities.append(SceneEntity(timestamp=stamp, frame_id=MAP, id="bounds", lines=lines))
    return entities


# --- primitives ------------------------------------------------------------------------------


def _line(points_m: FloatArray, closed: bool, colour: Colour = LANE) -> LinePrimitive:
    return LinePrimitive(
        type=LinePrimitive.LINE_LOOP if closed else LinePrimitive.LINE_STRIP,
        pose=_pose(0.0, 0.0, 0.0),
        thickness=2.0,
        scale_invariant=True,
        points=[Point3(x=x, y=y, z=0.0) for x, y in points_m.tolist()],
        color=_colour(colour, 0.8),
    )


def _pose(x_m: float, y_m: float, heading_rad: float, z_m: float = 0.0) -> Pose:
    return Pose(position=Vector3(x=x_m, y=y_m, z=z_m), orientation=_rotation(heading_rad))


def _rotation(heading_rad: float) -> Quaternion:
    return Quaternion(x=0.0, y=0.0, z=math.sin(heading_rad / 2.0), w=math.cos(heading_rad / 2.0))


@cache
def _colour(colour: Colour, opacity: float) -> Color:
    red, green, blue = colour
    return Color(r=red / 255.0, g=green / 255.0, b=blue / 255.0, a=opacity)


def timestamp(time_ns: int) -> Timestamp:
    """An instant as protobuf has it."""
    seconds, nanos = divmod(time_ns, NS_PER_S)
    return Timestamp(seconds=seconds, nanos=nanos)


def _duration(time_ns: int) -> Duration:
    seconds, nanos = divmod(time_ns, NS_PER_S)
    return Duration(seconds=seconds, nanos=nanos)
