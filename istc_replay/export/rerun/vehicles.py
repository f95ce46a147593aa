"""The vehicles on the present plane: boxes, names, trails, paths, and the cubes that they are in.

Boxes are drawn for all vehicles, the rest for those that lead (see `rerun.cast`); cubes and paths
of the others wait under `/now/quiet`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import polars as pl
import rerun as rr
from rerun.chunk import Chunk

from istc_replay.export.colours import Colour
from istc_replay.export.rerun.chunks import (
    FOREVER_NS,
    at_height,
    each,
    entity,
    quaternions,
    ragged,
    same,
    shown,
    ui_radius,
)
from istc_replay.export.rerun.slots import look, place
from istc_replay.export.rerun.space_time import FILL, line_chunks
from istc_replay.export.rerun.stage import Root, Stage, local_cubes, local_points
from istc_replay.export.rerun.tracks import Track

_TRAIL_STEP_NS = 250_000_000
_TRAIL_POINTS = 13
#: Heights above the present plane [m].
_CUBE_Z, _PATH_Z, _TRAIL_Z, _RECORDED_Z, _PLANNED_Z = 0.04, 0.06, 0.08, 0.1, 0.12
_FLAT_M = 0.01
#: Size of a box's row, and of its colours, sizes and name where they stand in each row.
_ROW_BYTES, _STYLE_BYTES = 64.0, 90.0


def vehicle_chunks(stage: Stage) -> list[Chunk]:
    """Chunks of all vehicles under `/now`."""
    chunks = []
    for vehicle_id in stage.vehicle_ids:
        for root, spans in stage.roots("now", vehicle_id):
            chunks += _cubes(stage, vehicle_id, root, spans) + _paths(stage, vehicle_id, root, spans)
        for tracks, draw in ((stage.recorded, _recorded), (stage.in_force, _planned)):
            if vehicle_id in tracks and len(stage.own(tracks[vehicle_id]).times_ns):
                chunks += draw(stage, tracks[vehicle_id])
    return chunks


def _cubes(stage: Stage, vehicle_id: str, root: Root, shown_in: set[int]) -> list[Chunk]:
    """The corridor-cube of the present unit, and the pivotal points at its two ends."""
    tables = stage.cubes_of(vehicle_id, shown_in)
    if not tables:
        return []
    name, colour = place(stage, vehicle_id), stage.colours[vehicle_id]
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
        *shown(stage.clock, entity(*root, "planned", "cube", name), starts, ends, boxes, glass),
        *shown(stage.clock, entity(*root, "planned", "pivots", name), starts, ends, pivots, dots),
    ]


def _paths(stage: Stage, vehicle_id: str, root: Root, shown_in: set[int]) -> list[Chunk]:
    """The window's whole planned and recorded paths on the present plane."""
    chunks = []
    for source, colour, width in (
        ("planned", stage.colours[vehicle_id], 1.2),
        ("recorded", stage.recorded_colour(vehicle_id), 0.8),
    ):
        spans = [span for span in stage.spans if span.index in shown_in]
        lines = [(span, stage.window_states(span, vehicle_id).get(source)) for span in spans]
        drawn = [(span, at_height(states[:, 1:3], _PATH_Z)) for span, states in lines if states is not None]
        chunks += line_chunks(
            stage, entity(*root, source, "path", place(stage, vehicle_id)), drawn, colour, width
        )
    return chunks


def _planned(stage: Stage, track: Track) -> list[Chunk]:
    name, colour = stage.names[track.vehicle_id], stage.colours[track.vehicle_id]
    where = place(stage, track.vehicle_id)
    path, own = entity("now", "planned", "box", where), stage.own(track)
    return [
        *_moving_boxes(stage, path, own, _PLANNED_Z, colors=colour, fill_mode=FILL.Solid, labels=name),
        *_naming(stage, path, own),
        *_trail(stage, entity("now", "planned", "trail", where), track, colour, 2.2),
    ]


def _recorded(stage: Stage, track: Track) -> list[Chunk]:
    """Outlines; who has no plan is named on the box, the others where only the recording is seen."""
    name, colour = stage.names[track.vehicle_id], stage.recorded_colour(track.vehicle_id)
    where = place(stage, track.vehicle_id)
    path, names = entity("now", "recorded", "box", where), entity("now", "names", where)
    own = stage.own(track)
    style = {"colors": colour, "radii": ui_radius(1.1), "fill_mode": FILL.MajorWireframe}
    chunks = [
        *_moving_boxes(stage, path, own, _RECORDED_Z, **style, labels=name),
        *_trail(stage, entity("now", "recorded", "trail", where), track, colour, 1.6),
    ]
    if track.vehicle_id not in stage.in_force:
        return chunks + _naming(stage, path, own)
    led = stage.leads_at(track.vehicle_id, own.times_ns)
    places = each(rr.Points3D, positions=at_height(own.poses[led, :2], _RECORDED_Z))
    still, moving = look(stage, names, rr.Points3D, labels=name, colors=colour, show_labels=True)
    return [
        *chunks,
        *still,
        *shown(stage.clock, names, own.times_ns[led], own.ends_ns[led], places, *moving),
    ]


def _moving_boxes(stage: Stage, path: str, track: Track, z: float, **style: Any) -> list[Chunk]:
    halves = at_height(track.sizes_m / 2.0, _FLAT_M)
    constant = bool((halves == halves[0]).all())
    still, moving = look(stage, path, rr.Boxes3D, **style, **({"half_sizes": halves[0]} if constant else {}))
    boxes = each(
        rr.Boxes3D,
        centers=at_height(track.poses[:, :2], z),
        quaternions=quaternions(track.poses[:, 2]),
        **({} if constant else {"half_sizes": halves}),
    )
    size = _ROW_BYTES + (_STYLE_BYTES if moving else 0.0)
    return [
        *still,
        *shown(stage.clock, path, track.times_ns, track.ends_ns, boxes, *moving, row_bytes=size),
    ]


def _naming(stage: Stage, path: str, track: Track) -> list[Chunk]:
    """Shows a box's name while its vehicle leads; else the view decides."""
    begins = [track.times_ns[part][0] for part in track.segments()]
    first, last = track.times_ns[0], track.times_ns[-1]
    begins += [span.start_ns for span in stage.spans if first < span.start_ns < last]
    times = np.unique(np.array(begins, dtype=np.int64))
    led = stage.leads_at(track.vehicle_id, times)
    rows = ragged(rr.Boxes3D, led.astype(np.int64), show_labels=[True] * int(led.sum()))
    # Each a tick after the box appears: a clear of the same instant would strike it.
    return shown(stage.clock, path, times + 1, np.full(len(times), FOREVER_NS), rows)


def _trail(stage: Stage, path: str, track: Track, colour: Colour, width: float) -> list[Chunk]:
    """Where a leading vehicle was in the last three seconds."""
    starts, ends, strips = [], [], []
    for part in track.segments():
        own = track.times_ns[part]
        heads = np.arange(own[0] + _TRAIL_STEP_NS, own[-1] + 1, _TRAIL_STEP_NS, dtype=np.int64)
        led = stage.leads_at(track.vehicle_id, heads) & stage.in_part(heads)
        if not led.any():
            continue
        past_ns = heads[led, None] - own[0] - _TRAIL_STEP_NS * np.arange(_TRAIL_POINTS)  # (n, points)
        columns = [np.interp(past_ns, own - own[0], track.poses[part, axis]) for axis in (0, 1)]
        strips += list(np.stack([*columns, np.full(past_ns.shape, _TRAIL_Z)], axis=-1))
        starts.append(heads[led])
        ends.append(np.append(heads[1:], max(track.ends_ns[part][-1], heads[-1] + 1))[led])
    if not starts:
        return []
    still, moving = look(stage, path, rr.LineStrips3D, colors=colour, radii=ui_radius(width))
    rows = ragged(rr.LineStrips3D, [1] * len(strips), strips=strips)
    times = (np.concatenate(starts), np.concatenate(ends))
    size = 12.0 * _TRAIL_POINTS + (_STYLE_BYTES if moving else 0.0)
    return [*still, *shown(stage.clock, path, *times, rows, *moving, row_bytes=size)]
