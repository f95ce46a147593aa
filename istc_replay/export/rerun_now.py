"""The replay: what is where at the present instant.

Everything under `/now` rides on the plane of the present instant, which its transform lifts to
the height of now. The view from above has its origin at `/now` and so sees it flat; the (x, y, t)
view shows the same boxes on their way up through the corridors.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import polars as pl
import rerun as rr
from rerun.chunk import Chunk

from istc_replay.datatypes import FloatArray
from istc_replay.export.colours import LANE, Colour
from istc_replay.export.rerun_chunks import (
    CHUNK_BYTES,
    FOREVER_NS,
    at_height,
    each,
    entity,
    label,
    quaternions,
    ragged,
    same,
    shown,
    static,
    ui_radius,
)
from istc_replay.export.rerun_space_time import FILL, FOV_RAD, eye_times, line_chunks, pinhole
from istc_replay.export.rerun_stage import Stage, Track, local_cubes, local_points
from istc_replay.geometry import box_corners

_NOW: Colour = (230, 150, 20)
_STEP_NS = 100_000_000
_TRAIL_STEP_NS = 250_000_000
_TRAIL_POINTS = 13
#: Heights above the present plane [m], from the map up to the planned boxes.
_MAP_Z, _CUBE_Z, _PATH_Z, _TRAIL_Z, _RECORDED_Z, _PLANNED_Z = 0.0, 0.04, 0.06, 0.08, 0.1, 0.12
_FLAT_M = 0.01


def now_chunks(stage: Stage) -> list[Chunk]:
    """Chunks under `/now`, and the map that the (x, y, t) view stands on."""
    chunks = _map(stage) + _obstacles(stage)
    if stage.spans:
        chunks += _plane(stage) + _eye(stage)
    for vehicle_id in stage.vehicle_ids:
        chunks += _cubes(stage, vehicle_id) + _paths(stage, vehicle_id)
        if vehicle_id in stage.recorded:
            chunks += _recorded(stage, stage.recorded[vehicle_id])
        if vehicle_id in stage.in_force:
            chunks += _planned(stage, stage.in_force[vehicle_id])
    return chunks


# --- the plane and what stands on it ---------------------------------------------------------


def _plane(stage: Stage) -> list[Chunk]:
    """The lift of the present plane, and the square that shows it in the (x, y, t) view."""
    times, heights, squares = [], [], []
    for span in stage.spans:
        own = np.arange(span.start_ns, span.shown_end_ns, _STEP_NS, dtype=np.int64)
        if span is stage.spans[-1]:
            own = np.append(own, span.end_ns)
        times.append(own)
        heights.append(stage.height_m(span, own))
        x0, x1, y0, y1 = stage.extents[span.index]
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
        squares.append((span, at_height(corners, 0.0)))
    z = np.concatenate(heights)
    lift = each(rr.Transform3D, translation=at_height(np.zeros((len(z), 2)), z))
    return [
        *shown(stage.clock, entity("now"), np.concatenate(times), np.full(len(z), FOREVER_NS), lift),
        *line_chunks(stage, entity("now", "square"), squares, _NOW, 1.6),
    ]


def _eye(stage: Stage) -> list[Chunk]:
    places = []
    for span in stage.spans:
        x0, x1, y0, y1 = stage.extents[span.index]
        height = 1.05 * max(x1 - x0, y1 - y0) / 2.0 / np.tan(FOV_RAD / 2.0)
        places.append([(x0 + x1) / 2.0, (y0 + y1) / 2.0, height])
    path, rows = entity("now", "camera"), len(places)
    turn = np.tile(np.diag([1.0, -1.0, -1.0]), (rows, 1, 1))
    columns = each(rr.Transform3D, translation=np.array(places), mat3x3=turn)
    return [pinhole(path), *shown(stage.clock, path, eye_times(stage), [FOREVER_NS] * rows, columns)]


def _map(stage: Stage) -> list[Chunk]:
    """Lanes and bounds, once on the ground of space-time and once on the present plane."""
    scene, origin = stage.result.scene, np.array(stage.origin_m)
    lines = [line.points_m for line in scene.lane_lines if len(line.points_m) >= 2]
    if scene.bounds is not None:
        x, y = (scene.bounds.x_min_m, scene.bounds.x_max_m), (scene.bounds.y_min_m, scene.bounds.y_max_m)
        lines.append(np.array([[x[i], y[j]] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))]))
    style = rr.LineStrips3D.columns(colors=[LANE], radii=[ui_radius(1.0)])
    chunks = []
    for number, batch in enumerate(_batches([at_height(line - origin, _MAP_Z) for line in lines])):
        strips = rr.LineStrips3D.columns(strips=batch).partition([len(batch)])
        chunks += [
            static(entity(root, "shared", "map", str(number)), strips, style)
            for root in ("space_time", "now")
        ]
    if scene.obstacles:
        boxes = np.array([(o.x_m, o.y_m, o.heading_rad, o.length_m, o.width_m) for o in scene.obstacles])
        corners = box_corners(*boxes.T)
        outlines = [at_height(np.vstack([c, c[:1]]) - origin, _CUBE_Z) for c in corners]
        style = rr.LineStrips3D.columns(colors=[LANE], radii=[ui_radius(1.5)])
        strips = rr.LineStrips3D.columns(strips=outlines).partition([len(outlines)])
        chunks.append(static(entity("now", "shared", "outlines"), strips, style))
    return chunks


def _batches(strips: list[FloatArray]) -> Iterable[list[FloatArray]]:
    """The lines in groups that fit a chunk."""
    batch: list[FloatArray] = []
    size = 0
    for strip in strips:
        if batch and size + strip.size * 4 > CHUNK_BYTES:
            yield batch
            batch, size = [], 0
        batch.append(strip)
        size += strip.size * 4
    if batch:
        yield batch


def _obstacles(stage: Stage) -> list[Chunk]:
    """The boxes in the way in the present unit."""
    finite = pl.all_horizontal(pl.col("x_min_m", "x_max_m", "y_min_m", "y_max_m").is_finite())
    tables = stage.by_span(stage.result.obstacles.filter(finite).sort("window", "start_ns", "obstacle_id"))
    if not tables:
        return []
    starts, ends, keep = stage.in_view(tables)
    table = pl.concat([own for _, own in tables]).filter(keep)
    centres, halves, turns = local_cubes(stage, table)
    begins, first, counts = np.unique(starts, return_index=True, return_counts=True)
    return shown(
        stage.clock,
        entity("now", "shared", "obstacles"),
        begins,
        ends[first],
        ragged(
            rr.Boxes3D,
            counts,
            centers=at_height(centres, _CUBE_Z),
            half_sizes=at_height(halves, _FLAT_M),
            quaternions=turns,
            labels=[label(name) for name in table["obstacle_id"]],
        ),
        same(rr.Boxes3D, colors=LANE, fill_mode=FILL.TransparentFillMajorWireframe),
        row_bytes=64.0 * float(np.mean(counts)),
    )


# --- vehicles --------------------------------------------------------------------------------


def _cubes(stage: Stage, vehicle_id: str) -> list[Chunk]:
    """The corridor-cube of the present unit, and the pivotal points at its two ends."""
    tables = stage.by_span(
        stage.result.corridors.filter(pl.col("vehicle_id") == vehicle_id).sort("window", "k")
    )
    if not tables:
        return []
    name, colour = stage.names[vehicle_id], stage.colours[vehicle_id]
    starts, ends, keep = stage.in_view(tables)
    table = pl.concat([own for _, own in tables]).filter(keep)
    centres, halves, turns = local_cubes(stage, table)
    points = np.stack(
        [
            local_points(stage, table, table.select(f"{pivot}_x_m", f"{pivot}_y_m").to_numpy())
            for pivot in ("pivot", "pivot_end")
        ],
        axis=1,
    ).reshape(-1, 2)
    boxes = each(
        rr.Boxes3D,
        centers=at_height(centres, _CUBE_Z),
        half_sizes=at_height(halves, _FLAT_M),
        quaternions=turns,
    )
    glass = same(rr.Boxes3D, colors=(*colour, 90), fill_mode=FILL.TransparentFillMajorWireframe)
    pivots = ragged(rr.Points3D, [2] * len(starts), positions=at_height(points, _PATH_Z))
    dots = same(rr.Points3D, colors=colour, radii=ui_radius(3.0))
    return [
        *shown(stage.clock, entity("now", "planned", "cube", name), starts, ends, boxes, glass),
        *shown(stage.clock, entity("now", "planned", "pivots", name), starts, ends, pivots, dots),
    ]


def _paths(stage: Stage, vehicle_id: str) -> list[Chunk]:
    """The window's whole planned and recorded paths on the present plane."""
    chunks = []
    for source, colour, width in (
        ("planned", stage.colours[vehicle_id], 1.2),
        ("recorded", stage.recorded_colour(vehicle_id), 0.8),
    ):
        lines = [(span, stage.window_states(span, vehicle_id).get(source)) for span in stage.spans]
        drawn = [(span, at_height(states[:, 1:3], _PATH_Z)) for span, states in lines if states is not None]
        chunks += line_chunks(
            stage, entity("now", source, "path", stage.names[vehicle_id]), drawn, colour, width
        )
    return chunks


def _planned(stage: Stage, track: Track) -> list[Chunk]:
    name, colour = stage.names[track.vehicle_id], stage.colours[track.vehicle_id]
    path = entity("now", "planned", "box", name)
    style = rr.Boxes3D.columns(colors=[colour], fill_mode=[FILL.Solid], labels=[name], show_labels=[True])
    return [
        static(path, style),
        *_moving_boxes(stage, path, track, _PLANNED_Z),
        *_trail(stage, entity("now", "planned", "trail", name), track, colour, 2.2),
    ]


def _recorded(stage: Stage, track: Track) -> list[Chunk]:
    """Outlines; who has no plan is named on the box, the others where only the recording is seen."""
    name, colour = stage.names[track.vehicle_id], stage.recorded_colour(track.vehicle_id)
    path, names = entity("now", "recorded", "box", name), entity("now", "names", name)
    style = {"colors": [colour], "radii": [ui_radius(1.1)], "fill_mode": [FILL.MajorWireframe]}
    if track.vehicle_id not in stage.in_force:
        style |= {"labels": [name], "show_labels": [True]}
    places = each(rr.Points3D, positions=at_height(track.poses[:, :2], _RECORDED_Z))
    return [
        static(path, rr.Boxes3D.columns(**style)),
        *_moving_boxes(stage, path, track, _RECORDED_Z),
        *_trail(stage, entity("now", "recorded", "trail", name), track, colour, 1.6),
        static(names, rr.Points3D.columns(labels=[name], colors=[colour], show_labels=[True])),
        *shown(stage.clock, names, track.times_ns, track.ends_ns, places),
    ]


def _moving_boxes(stage: Stage, path: str, track: Track, z: float) -> list[Chunk]:
    boxes = each(
        rr.Boxes3D,
        centers=at_height(track.poses[:, :2], z),
        half_sizes=at_height(track.sizes_m / 2.0, _FLAT_M),
        quaternions=quaternions(track.poses[:, 2]),
    )
    return shown(stage.clock, path, track.times_ns, track.ends_ns, boxes)


def _trail(stage: Stage, path: str, track: Track, colour: Colour, width: float) -> list[Chunk]:
    """Where the vehicle was in the last three seconds."""
    starts, ends, strips = [], [], []
    for part in track.segments():
        own = track.times_ns[part]
        heads = np.arange(own[0] + _TRAIL_STEP_NS, own[-1] + 1, _TRAIL_STEP_NS, dtype=np.int64)
        if not len(heads):
            continue
        past_ns = heads[:, None] - own[0] - _TRAIL_STEP_NS * np.arange(_TRAIL_POINTS)  # (n, points)
        columns = [np.interp(past_ns, own - own[0], track.poses[part, axis]) for axis in (0, 1)]
        strips += list(np.stack([*columns, np.full(past_ns.shape, _TRAIL_Z)], axis=-1))
        starts.append(heads)
        ends.append(np.append(heads[1:], track.ends_ns[part][-1]))
    if not starts:
        return []
    style = rr.LineStrips3D.columns(colors=[colour], radii=[ui_radius(width)])
    rows = ragged(rr.LineStrips3D, [1] * len(strips), strips=strips)
    times = (np.concatenate(starts), np.concatenate(ends))
    return [static(path, style), *shown(stage.clock, path, *times, rows, row_bytes=12.0 * _TRAIL_POINTS)]
