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
from istc_replay.export.colours import EDGE, LANE, Colour
from istc_replay.export.rerun.chunks import (
    CHUNK_BYTES,
    FOREVER_NS,
    IntArray,
    at_height,
    each,
    entity,
    label,
    ragged,
    same,
    shown,
    static,
    ui_radius,
)
from istc_replay.export.rerun.space_time import FILL, line_chunks
from istc_replay.export.rerun.stage import Stage, local_cubes
from istc_replay.geometry import box_corners

_NOW: Colour = (230, 150, 20)
_STEP_NS = 100_000_000
#: Heights above the present plane [m].
_MAP_Z, _CUBE_Z = 0.0, 0.04
_FLAT_M = 0.01
#: Where the present time is written, and the corners of its plane, in shares of the ground's half sides.
_POINTER = (-1.0, -0.62)
_SQUARE = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0))


def now_chunks(stage: Stage) -> list[Chunk]:
    """Chunks of the present plane, and of the map that the (x, y, t) view stands on."""
    chunks = _map(stage) + _obstacles(stage)
    if stage.spans:
        chunks += _plane(stage)
    return chunks


# --- the plane and what stands on it ---------------------------------------------------------


def _plane(stage: Stage) -> list[Chunk]:
    """The lift of the present plane, and the square that shows it in the (x, y, t) view."""
    times, heights, squares = [], [], []
    for span in stage.spans:
        own = np.arange(span.start_ns, span.shown_end_ns, _STEP_NS, dtype=np.int64)
        if span is stage.spans[-1] and stage.anchor.until_ns is None:
            own = np.append(own, span.end_ns)
        times.append(own)
        heights.append(stage.height_m(span, own))
        corners = stage.grounds[span.index].points(_SQUARE)
        squares.append((span, at_height(corners, 0.0)))
    z = np.concatenate(heights)
    lift = each(rr.Transform3D, translation=at_height(np.zeros((len(z), 2)), z))
    return [
        *shown(stage.clock, entity("now"), np.concatenate(times), np.full(len(z), FOREVER_NS), lift),
        *line_chunks(stage, entity("now", "square"), squares, _NOW, 1.6),
        *_pointer(stage, np.concatenate(times)),
    ]


def _pointer(stage: Stage, times_ns: IntArray) -> list[Chunk]:
    """The present time, written at the edge of its plane, beside the ruler's marks."""
    spans = np.searchsorted([span.start_ns for span in stage.spans], times_ns, side="right") - 1
    places = [stage.grounds[span.index].points([_POINTER])[0] for span in stage.spans]
    seconds = (times_ns - stage.clock.origin_ns) / 1e9
    path, style = entity("now", "square", "time"), {"colors": [_NOW], "radii": [ui_radius(4.0)]}
    rows = each(
        rr.Points3D,
        positions=at_height(np.array(places)[spans], 0.0),
        labels=[f"now: {second:.1f} s" for second in seconds],
    )
    return [
        static(path, rr.Points3D.columns(**style, show_labels=[True])),
        *shown(stage.clock, path, times_ns, np.full(len(times_ns), FOREVER_NS), rows),
    ]


def _map(stage: Stage) -> list[Chunk]:
    """Lanes, road edges and bounds, once on the ground of space-time and once on the present plane."""
    scene, origin = stage.result.scene, np.array(stage.origin_m)
    lines = [line.points_m for line in scene.lane_lines if len(line.points_m) >= 2]
    if scene.bounds is not None:
        x, y = (scene.bounds.x_min_m, scene.bounds.x_max_m), (scene.bounds.y_min_m, scene.bounds.y_max_m)
        lines.append(np.array([[x[i], y[j]] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))]))
    edges = [edge for edge in scene.edges_m if len(edge) >= 2]
    chunks = []
    for name, polylines, colour in (("map", lines, LANE), ("road", edges, EDGE)):
        style = rr.LineStrips3D.columns(colors=[colour], radii=[ui_radius(1.0)])
        for number, batch in enumerate(_batches([at_height(line - origin, _MAP_Z) for line in polylines])):
            strips = rr.LineStrips3D.columns(strips=batch).partition([len(batch)])
            chunks += [
                static(entity(root, "shared", name, str(number)), strips, style)
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
