"""Data types as `istc.v1` messages, each with the instant it belongs to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import polars as pl

from istc_replay import messages
from istc_replay.config import CorridorsConfig
from istc_replay.datatypes import (
    SOUND,
    Certificate,
    Corridor,
    Dimensions,
    FloatArray,
    Frame,
    Guidance,
    Obstacle,
    SolveRecord,
    StaticScene,
    Window,
    WindowPlan,
)
from istc_replay.export.placing import (
    PlannedMotion,
    absolute_ns,
    map_poses,
    planned_motion,
    topic_name,
    unit_span_ns,
)
from istc_replay.export.stamped import Stamped
from istc_replay.units import seconds_to_ns

_KINEMATICS = (
    "heading_rad",
    "speed_mps",
    "acceleration_mps2",
    "steering_rad",
    "steering_rate_radps",
    "jerk_mps3",
)
#: States made messages of at a time.
_ROWS = 8192
_SIZES = ("length_m", "width_m", "wheelbase_m", "rear_axle_to_centre_m")


def recorded_messages(states: pl.DataFrame) -> Iterator[Stamped]:
    """Give every recorded state as it was read, in its order in the file.

    States of one vehicle and instant keep the table's order. A size is told where both length and
    width are known.
    """
    names = {
        vehicle: f"/istc/recorded/{topic_name(vehicle)}" for vehicle in states["vehicle_id"].unique().sort()
    }
    rank = {vehicle: row for row, vehicle in enumerate(sorted(names, key=lambda vehicle: names[vehicle]))}
    ranks = states["vehicle_id"].replace_strict(rank, return_dtype=pl.Int32)
    order = np.lexsort([ranks.to_numpy(), states["time_ns"].clip(0).to_numpy()])
    for first in range(0, len(order), _ROWS):
        yield from _recorded(states[order[first : first + _ROWS]], names)


def _recorded(states: pl.DataFrame, names: Mapping[str, str]) -> Iterator[Stamped]:
    vehicle_state, dimensions = messages.message("VehicleState"), messages.message("Dimensions")
    columns = ("time_ns", "vehicle_id", "x_m", "y_m", *_KINEMATICS, "role", "derived")
    size_columns = states.select(_SIZES).iter_rows()
    # A vehicle is what a state tells of unless it says otherwise.
    role, derived = pl.col("role").replace("vehicle", None), pl.col("derived").cast(pl.Int64)
    told = states.select(columns).with_columns(role, derived)
    for row, (length, width, wheelbase, axle) in zip(told.iter_rows(), size_columns, strict=True):
        size = None
        if length is not None and width is not None:
            size = dimensions(
                length_m=length, width_m=width, wheelbase_m=wheelbase, rear_axle_to_centre_m=axle
            )
        yield (
            row[0],
            names[row[1]],
            vehicle_state(**dict(zip(columns, row, strict=True)), dimensions=size),
        )


def plan_messages(plan: WindowPlan, config: CorridorsConfig) -> Iterator[Stamped]:
    """Give one window's plan: corridors, obstacles, guidance, planned states and solves.

    Trajectories that are not certified are no plan: they go to topics of their own.
    """
    kind = "planned" if plan.status in SOUND else "rejected"
    window = plan.scenario.window
    yield window.start_ns, "/istc/corridors", _corridors(plan, config)
    yield window.start_ns, "/istc/obstacles", _obstacles(plan)
    for guidance in plan.guidance:
        yield (
            window.start_ns,
            f"/istc/guidance/{topic_name(guidance.vehicle_id)}",
            _guidance(guidance, window),
        )
    for trajectory in plan.trajectories:
        yield from _motion(planned_motion(trajectory, window), kind)
    for record in solve_records(plan):
        yield window.start_ns, "/istc/solves", _solve(record, window)


def solve_records(plan: WindowPlan) -> list[SolveRecord]:
    """List the solver calls of one window, in the order of the solves table."""
    layer_one = plan.corridors.records if plan.corridors is not None else ()
    return [record for record in layer_one if record not in plan.records] + list(plan.records)


def certificate_message(certificate: Certificate, start_ns: int) -> Stamped:
    """Give one check; `start_ns` is its window's start."""
    time_ns = None if certificate.time_s is None else start_ns + seconds_to_ns(certificate.time_s)
    message = messages.message("Certificate")(
        window=certificate.window,
        check=certificate.check,
        verdict=certificate.verdict.value,
        margin=certificate.margin,
        unit=certificate.unit,
        time_ns=time_ns,
        vehicles=list(certificate.vehicles),
        detail=certificate.detail,
    )
    return start_ns, "/istc/certificates", message


def finding_messages(findings: pl.DataFrame) -> Iterator[Stamped]:
    """Give the findings of the audit, each at the instant at which it is worst, in order of time."""
    finding = messages.message("Finding")
    for row in by_time(findings).iter_rows(named=True):
        yield row["worst_ns"], "/istc/findings", finding(**row)


def by_time(findings: pl.DataFrame) -> pl.DataFrame:
    """Findings in their order in the file."""
    return findings.sort(pl.col("worst_ns").clip(0), maintain_order=True)


def scene_message(scene: StaticScene) -> Any:
    """Give the static scene as istc.v1.Scene."""
    message = messages.message("Scene")()
    for line in scene.lane_lines:
        edges = {
            side: _points(points)
            for side, points in (("left", line.left_m), ("right", line.right_m))
            if points is not None
        }
        message.lane_lines.add(
            lane_id=line.lane_id, points=_points(line.points_m), vehicle_id=line.vehicle_id or "", **edges
        )
    for edge in scene.road_edges:
        message.road_edges.add(edge_id=edge.edge_id, points=_points(edge.points_m))
    for area in scene.road_areas:
        message.road_areas.add(area_id=area.area_id, points=_points(area.points_m))
    for obstacle in scene.obstacles:
        message.obstacles.add(**_fields(obstacle))
    if scene.bounds is not None:
        message.bounds.CopyFrom(messages.message("MapBounds")(**_fields(scene.bounds)))
    for vehicle in scene.vehicles:
        size = None if vehicle.dimensions is None else _dimensions(vehicle.dimensions)
        message.vehicles.add(vehicle_id=vehicle.vehicle_id, priority=vehicle.priority, dimensions=size)
    return message


def _corridors(plan: WindowPlan, config: CorridorsConfig) -> Any:
    window = plan.scenario.window
    corridors = plan.corridors.corridors if plan.corridors is not None else ()
    return messages.message("Corridors")(
        window=window.index,
        start_ns=window.start_ns,
        end_ns=window.end_ns,
        unit_s=window.unit_s,
        frame=_frame(window.frame),
        corridors=[_corridor(corridor, window) for corridor in corridors],
        vehicle_gap_m=config.vehicle_gap_m if plan.vehicle_gap_m is None else plan.vehicle_gap_m,
        obstacle_gap_m=config.obstacle_gap_m if plan.obstacle_gap_m is None else plan.obstacle_gap_m,
    )


def _corridor(corridor: Corridor, window: Window) -> Any:
    cubes = [
        _cube(window, corridor.first_unit + row, box) for row, box in enumerate(corridor.cubes_m.tolist())
    ]
    return messages.message("Corridor")(
        vehicle_id=corridor.vehicle_id,
        cubes=cubes,
        pivots=_points(corridor.pivots_m),
        references=_points(corridor.references_m),
    )


def _obstacles(plan: WindowPlan) -> Any:
    window, bounds_m = plan.scenario.window, plan.scenario.bounds_m
    names = ("x_min_m", "x_max_m", "y_min_m", "y_max_m")
    bounds = None if bounds_m is None else dict(zip(names, bounds_m, strict=True))
    return messages.message("Obstacles")(
        window=window.index,
        start_ns=window.start_ns,
        frame=_frame(window.frame),
        obstacles=[_obstacle(obstacle, window) for obstacle in plan.scenario.obstacles],
        bounds=bounds,
    )


def _obstacle(obstacle: Obstacle, window: Window) -> Any:
    boxes = [
        _cube(window, k, box)
        for k, box in enumerate(obstacle.boxes_m.tolist())
        if not np.isnan(box).any()  # absent in this unit
    ]
    return messages.message("Obstacle")(obstacle_id=obstacle.obstacle_id, boxes=boxes)


def _guidance(guidance: Guidance, window: Window) -> Any:
    poses = map_poses(guidance.poses, window.frame)
    return messages.message("Guidance")(
        window=window.index,
        vehicle_id=guidance.vehicle_id,
        kind=guidance.kind,
        speed_mps=guidance.speed_mps,
        times_ns=absolute_ns(window, guidance.times_s).tolist(),
        x_m=poses[:, 0].tolist(),
        y_m=poses[:, 1].tolist(),
        heading_rad=poses[:, 2].tolist(),
    )


def _motion(motion: PlannedMotion, kind: str) -> Iterator[Stamped]:
    vehicle_state, size = messages.message("VehicleState"), _dimensions(motion.dimensions)
    topic = f"/istc/{kind}/{topic_name(motion.vehicle_id)}"
    columns = (
        motion.times_ns,
        motion.poses[:, 0],
        motion.poses[:, 1],
        motion.poses[:, 2],
        motion.speeds_mps,
        motion.accelerations_mps2,
        motion.steerings_rad,
        motion.controls[:, 0],
        motion.controls[:, 1],
    )
    names = ("time_ns", "x_m", "y_m", *_KINEMATICS)
    for row in zip(*(column.tolist() for column in columns), strict=True):
        fields = dict(zip(names, row, strict=True))
        message = vehicle_state(**fields, vehicle_id=motion.vehicle_id, dimensions=size, window=motion.window)
        yield row[0], topic, message


def _solve(record: SolveRecord, window: Window) -> Any:
    return messages.message("SolveReport")(
        window=window.index,
        vehicle_id=record.vehicle_id or "",
        layer=record.layer,
        stage=record.stage,
        solver=record.solver,
        status=record.status.value,
        objective=record.objective,
        bound=record.bound,
        gap=record.gap,
        iterations=record.iterations,
        nodes=record.nodes,
        binaries=record.binaries,
        detail=record.detail,
    )


def _cube(window: Window, k: int, box: list[float]) -> Any:
    start_ns, end_ns = unit_span_ns(window, k)
    x_min, x_max, y_min, y_max = box
    return messages.message("Cube")(
        k=k, start_ns=start_ns, end_ns=end_ns, x_min_m=x_min, x_max_m=x_max, y_min_m=y_min, y_max_m=y_max
    )


def _points(points_m: FloatArray) -> list[Any]:
    point = messages.message("Point")
    return [point(x_m=x, y_m=y) for x, y in points_m.tolist()]


def _frame(frame: Frame) -> Any:
    return messages.message("Frame")(**_fields(frame))


def _dimensions(dimensions: Dimensions) -> Any:
    return messages.message("Dimensions")(**_fields(dimensions))


def _fields(record: Any) -> dict[str, Any]:
    return {name: getattr(record, name) for name in record.__slots__}
