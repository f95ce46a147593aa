"""Corridors and trajectories in (x, y, t): every window stands on the ground, time goes up."""

from __future__ import annotations

import numpy as np
import polars as pl
import rerun as rr
from rerun.chunk import Chunk

from istc_replay.datatypes import FloatArray
from istc_replay.export.colours import LANE, Colour
from istc_replay.export.rerun.chunks import (
    at_height,
    each,
    entity,
    ragged,
    same,
    shown,
    ui_radius,
)
from istc_replay.export.rerun.slots import place
from istc_replay.export.rerun.spans import Span
from istc_replay.export.rerun.stage import Root, Stage, local_cubes, local_points
from istc_replay.geometry import rotate

FILL = rr.components.FillMode

_DASH_S = 0.25
#: Foot of the ruler in shares of the ground's half sides.
_RULER = (-1.0, -0.3)
_TICKS_S = (1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 300.0, 3600.0)


def space_time_chunks(stage: Stage) -> list[Chunk]:
    """Chunks under `/space_time`."""
    chunks = _obstacles(stage)
    if stage.spans:
        chunks += _ruler(stage)
    for vehicle_id in stage.vehicle_ids:
        for root, spans in stage.roots("space_time", vehicle_id):
            chunks += _corridor(stage, vehicle_id, root, spans)
        chunks += _trajectories(stage, vehicle_id)
    return chunks


def _ruler_foot(stage: Stage, span: Span) -> tuple[float, float]:
    """Where a window's ruler of time stands: at the side that the eye sees on the left."""
    x, y = stage.grounds[span.index].points([_RULER])[0].tolist()
    return x, y


def _ruler(stage: Stage) -> list[Chunk]:
    """A pole with up to eight ticks, labelled with the scenario time."""
    strips: list[FloatArray] = []
    names: list[str] = []
    counts = []
    for span in stage.spans:
        x, y = _ruler_foot(stage, span)
        step_s = next((s for s in _TICKS_S if span.duration_s / s <= 7.0), span.duration_s)
        ticks_s = np.arange(0.0, span.duration_s + 1e-9, step_s)
        offset_s = (span.start_ns - stage.clock.origin_ns) / 1e9
        heights = ticks_s * stage.metres_per_second
        top = span.duration_s * stage.metres_per_second
        strips.append(np.array([[x, y, 0.0], [x, y, top]]))
        tick = rotate([-1.0, 0.0], span.frame.yaw_rad)
        strips += [np.array([[x + tick[0], y + tick[1], z], [x, y, z]]) for z in heights]
        names += [f"t = {offset_s + tick:g} s" for tick in ticks_s]
        counts.append(len(ticks_s))
    starts, ends = stage.overview(list(stage.spans))
    ends_of_ticks = np.array([strip[0] for strip in strips if strip[0, 2] == strip[1, 2]])
    path = ("space_time", "shared", "ruler")
    return [
        *shown(
            stage.clock,
            entity(*path),
            starts,
            ends,
            ragged(rr.LineStrips3D, [n + 1 for n in counts], strips=strips),
            same(rr.LineStrips3D, colors=LANE, radii=ui_radius(1.5)),
            row_bytes=500,
        ),
        *shown(
            stage.clock,
            entity(*path, "labels"),
            starts,
            ends,
            ragged(rr.Points3D, counts, positions=ends_of_ticks, labels=names),
            same(rr.Points3D, colors=LANE, radii=ui_radius(0.5), show_labels=True),
            row_bytes=500,
        ),
    ]


def _obstacles(stage: Stage) -> list[Chunk]:
    """Everything in the way, as towers of boxes; one row a window."""
    table = stage.result.obstacles.filter(
        pl.all_horizontal(pl.col("x_min_m", "x_max_m", "y_min_m", "y_max_m").is_finite())
    ).sort("window", "obstacle_id", "k")
    tables = stage.by_span(_merged(table))
    if not tables:
        return []
    table, (bottom, top) = pl.concat([own for _, own in tables]), _heights(stage, tables)
    centres, halves, turns = local_cubes(stage, table)
    counts = [own.height for _, own in tables]
    return shown(
        stage.clock,
        entity("space_time", "shared", "obstacles"),
        *stage.overview([span for span, _ in tables]),
        ragged(
            rr.Boxes3D,
            counts,
            centers=at_height(centres, (bottom + top) / 2.0),
            half_sizes=at_height(halves, (top - bottom) / 2.0),
            quaternions=turns,
        ),
        same(rr.Boxes3D, colors=(*LANE, 90), fill_mode=FILL.TransparentFillMajorWireframe),
        row_bytes=44.0 * float(np.mean(counts)),
    )


def _merged(table: pl.DataFrame) -> pl.DataFrame:
    """Units in which an obstacle's box stays the same become one tall box."""
    box = ["window", "obstacle_id", "x_min_m", "x_max_m", "y_min_m", "y_max_m"]
    frame = ["frame_x_m", "frame_y_m", "frame_yaw_rad"]
    runs = table.with_columns(run=pl.struct(*box, pl.col("k") - pl.int_range(pl.len()).over(box)).rle_id())
    return runs.group_by("run", maintain_order=True).agg(
        *(pl.col(name).first() for name in [*box, "k", *frame, "start_ns"]), pl.col("end_ns").last()
    )


def _heights(stage: Stage, tables: list[tuple[Span, pl.DataFrame]]) -> tuple[FloatArray, FloatArray]:
    """Bottoms and tops (n,) of the tables' boxes."""
    bottoms = [stage.height_m(span, own["start_ns"].to_numpy()) for span, own in tables]
    tops = [stage.height_m(span, own["end_ns"].to_numpy()) for span, own in tables]
    return np.concatenate(bottoms), np.concatenate(tops)


def _corridor(stage: Stage, vehicle_id: str, root: Root, shown_in: set[int]) -> list[Chunk]:
    """Corridor-cubes of the whole window, the present one filled, and the pivotal points."""
    tables = stage.cubes_of(vehicle_id, shown_in)
    if not tables:
        return []
    name, colour, clock = place(stage, vehicle_id), stage.colours[vehicle_id], stage.clock
    spans, counts = [span for span, _ in tables], [own.height for _, own in tables]
    table, (bottom, top) = pl.concat([own for _, own in tables]), _heights(stage, tables)
    centres, halves, turns = local_cubes(stage, table)
    cubes = {
        "centers": at_height(centres, (bottom + top) / 2.0),
        "half_sizes": at_height(halves, (top - bottom) / 2.0),
        "quaternions": turns,
    }
    starts, ends, keep = stage.in_view(tables)
    pivots = [_pivots(stage, span, own) for span, own in tables]
    return [
        *shown(
            clock,
            entity(*root, "planned", "corridors", name),
            *stage.overview(spans),
            ragged(rr.Boxes3D, counts, **cubes),
            same(rr.Boxes3D, colors=(*colour, 120), fill_mode=FILL.TransparentFillMajorWireframe),
            row_bytes=44.0 * float(np.mean(counts)),
        ),
        *shown(
            clock,
            entity(*root, "planned", "present", name),
            starts,
            ends,
            each(rr.Boxes3D, **{key: values[keep] for key, values in cubes.items()}),
            same(rr.Boxes3D, colors=colour, fill_mode=FILL.Solid),
        ),
        *shown(
            clock,
            entity(*root, "planned", "pivots", name),
            *stage.overview(spans),
            ragged(rr.Points3D, [len(p) for p in pivots], positions=np.vstack(pivots)),
            same(rr.Points3D, colors=colour, radii=ui_radius(3.0)),
            row_bytes=12.0 * float(np.mean(counts)),
        ),
    ]


def _pivots(stage: Stage, span: Span, table: pl.DataFrame) -> FloatArray:
    """The pivotal points of a window in space-time; (K + 1, 3)."""
    first = local_points(stage, table, table.select("pivot_x_m", "pivot_y_m").to_numpy())
    last = local_points(stage, table, table.select("pivot_end_x_m", "pivot_end_y_m").to_numpy())
    times = np.append(table["start_ns"].to_numpy(), table["end_ns"][-1])
    return at_height(np.vstack([first, last[-1:]]), stage.height_m(span, times))


def _trajectories(stage: Stage, vehicle_id: str) -> list[Chunk]:
    """Planned (thick), recorded (thin) and guidance (dashed) trajectories, one row a window."""
    lines: dict[str, list[tuple[Span, FloatArray]]] = {"planned": [], "recorded": [], "guidance": []}
    for span in stage.spans:
        for source, states in stage.window_states(span, vehicle_id).items():
            points = at_height(states[:, 1:3], states[:, 0] * stage.metres_per_second)
            lines[source].append((span, points))
    name, colour = place(stage, vehicle_id), stage.colours[vehicle_id]
    grey = stage.recorded_colour(vehicle_id)
    roots = {source: ("space_time", source, "trajectory", name) for source in ("planned", "recorded")}
    dashed = [(span, _dashes(points, stage.metres_per_second)) for span, points in lines["guidance"]]
    thick = 2.6 if vehicle_id in stage.starring else 1.2
    return [
        *line_chunks(stage, entity(*roots["planned"]), lines["planned"], colour, thick),
        *line_chunks(stage, entity(*roots["recorded"]), lines["recorded"], grey, 1.1),
        *line_chunks(stage, entity("space_time", "planned", "guidance", name), dashed, colour, 1.2),
    ]


def _dashes(points: FloatArray, metres_per_second: float) -> FloatArray:
    """Every other piece of a line in space-time; (D, 2, 3)."""
    times = points[:, 2] / metres_per_second
    starts = np.arange(times[0], times[-1], 2.0 * _DASH_S)
    pieces = np.column_stack([starts, np.minimum(starts + _DASH_S, times[-1])])
    return np.stack([np.interp(pieces, times, column) for column in points.T], axis=-1)


def line_chunks(
    stage: Stage, path: str, lines: list[tuple[Span, FloatArray]], colour: Colour, width: float
) -> list[Chunk]:
    """One row a window: a line (P, 3), or many of them (D, P, 3)."""
    if not lines:
        return []
    groups = [list(points) if points.ndim == 3 else [points] for _, points in lines]
    strips = [strip for group in groups for strip in group]
    return shown(
        stage.clock,
        path,
        *stage.overview([span for span, _ in lines]),
        ragged(rr.LineStrips3D, [len(group) for group in groups], strips=strips),
        same(rr.LineStrips3D, colors=colour, radii=ui_radius(width)),
        row_bytes=12.0 * float(np.mean([points.size // 3 for _, points in lines])),
    )
