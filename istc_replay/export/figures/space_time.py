"""Corridors in space-time (x, y, t): of all vehicles at once, and of each with its trajectory."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from math import ceil
from typing import Any

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D, proj3d
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from istc_replay.datatypes import FloatArray
from istc_replay.export.figures.style import (
    GRID,
    INK,
    MUTED,
    NAMED,
    PAPER,
    SIDE_ENTRIES,
    VehicleStyle,
    foot_height_in,
    foot_legend,
    line_legend,
    new_figure,
    origin_note,
    vehicle_legend,
)
from istc_replay.export.figures.tracks import CorridorShape, Track, WindowScene

#: One figure shows at most this many vehicles' own corridors.
PANELS = 9
_COLUMNS = 3
_ELEVATION_DEG = 24.0
_METRES_PER_SECOND = 2.0
#: Corners of a prism's six faces: 0 to 3 its foot, 4 to 7 its top.
_FACES = np.array(
    [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]], dtype=np.intp
)
#: Left, bottom, width and height as fractions of the figure.
Place = tuple[float, float, float, float]

_PLANNED: dict[str, Any] = {"linewidth": 1.8, "linestyle": "-"}
_GUIDANCE: dict[str, Any] = {"linewidth": 1.1, "linestyle": (0, (1.2, 1.6))}
_RECORDED: dict[str, Any] = {"linewidth": 1.0, "linestyle": (0, (4, 2))}


def draw_all_corridors(scene: WindowScene) -> Figure:
    """Draw the corridors of all vehicles with their pivotal points, as the paper's Fig. 5."""
    figure = new_figure(9.0, 5.6)
    _draw_corridors(figure, (0.02, 0.08, 0.80, 0.91), scene, list(scene.corridors.values()))
    shown = [scene.styles[name] for name in scene.corridors]
    vehicle_legend(figure, shown, SIDE_ENTRIES, loc="upper right", bbox_to_anchor=(1.0, 0.99))
    line_legend(figure, _meaning([scene]), loc="lower right", bbox_to_anchor=(1.0, 0.03))
    origin_note(figure, scene.origin_m, at_top=False)
    return figure


def draw_corridors_beside(scenes: tuple[WindowScene, WindowScene], names: tuple[str, str]) -> Figure:
    """Draw the corridors of two results in axes of the same extent, seen from the same side."""
    styles = [scenes[0].styles[name] for name in scenes[0].corridors | scenes[1].corridors]
    foot_in = 0.35 + foot_height_in(styles)
    height_in = 4.6 + foot_in
    figure = new_figure(9.9, height_in)
    shapes = [shape for scene in scenes for shape in scene.corridors.values()]
    for left, scene, name in zip((0.0, 0.5), scenes, names, strict=True):
        place = (left + 0.02, (foot_in + 0.3) / height_in, 0.41, 4.0 / height_in)
        _draw_corridors(figure, place, scene, shapes)
        figure.text(left + 0.02, 0.985, name, va="top", fontsize=9.5)
    foot_legend(figure, styles, _meaning(scenes))
    origin_note(figure, scenes[0].origin_m, at_top=True)
    return figure


def _draw_corridors(figure: Figure, place: Place, scene: WindowScene, shapes: list[CorridorShape]) -> None:
    """Draw a scene's corridors in axes that hold `shapes`."""
    axes = _space_time_axes(figure, place, scene, shapes)
    _draw_floor(axes, scene.lanes_m)
    _draw_prisms(
        axes, [(scene.styles[name], shape) for name, shape in scene.corridors.items()], scene.obstacles
    )
    for name, shape in scene.corridors.items():
        _draw_pivots(axes, shape, scene.styles[name], named=len(scene.corridors) <= NAMED)


def _meaning(scenes: Iterable[WindowScene]) -> list[tuple[str, dict[str, Any]]]:
    meaning: list[tuple[str, dict[str, Any]]] = [("pivotal points", {"marker": "o", "markersize": 4})]
    if any(len(scene.lanes_m) for scene in scenes):
        meaning.append(("lanes (on the floor)", {"color": GRID, "linewidth": 2.5}))
    if any(scene.obstacles for scene in scenes):
        meaning.append(("obstacles", {"color": MUTED, "linewidth": 5, "alpha": 0.6}))
    return meaning


def draw_own_corridors(scene: WindowScene, page: int = 0) -> Figure:
    """Draw vehicles' own corridors with the planned trajectory inside, as the paper's Fig. 6.

    One page holds `PANELS` vehicles.
    """
    names = list(scene.corridors)[page * PANELS : (page + 1) * PANELS]
    columns = 2 if len(names) == 4 else min(_COLUMNS, len(names))
    rows = ceil(len(names) / columns)
    height_in = 3.05 * rows + 0.4
    figure = new_figure(9.9, height_in)
    foot = 0.4 / height_in
    for index, name in enumerate(names):
        row, column = divmod(index, columns)
        width, height = 1.0 / columns, (1.0 - foot) / rows
        place = (column * width, foot + (rows - 1 - row) * height, width, height)
        _draw_own_corridor(figure, place, scene, name)
    line_legend(
        figure,
        [("planned", _PLANNED), ("recorded", _RECORDED), ("guidance", _GUIDANCE)],
        loc="lower center",
        ncols=3,
        bbox_to_anchor=(0.5, 0.0),
    )
    origin_note(figure, scene.origin_m, at_top=False)
    return figure


def _draw_own_corridor(figure: Figure, place: Place, scene: WindowScene, name: str) -> None:
    shape, style = scene.corridors[name], scene.styles[name]
    left, bottom, width, height = place
    figure.text(left + width / 2.0, bottom + 0.98 * height, style.label, ha="center", va="top", fontsize=9)
    lines = [
        (_cut(tracks[name], shape), look, colour)
        for tracks, look, colour in (
            (scene.guidance, _GUIDANCE, INK),
            (scene.recorded, _RECORDED, MUTED),
            (scene.planned, _PLANNED, INK),
        )
        if name in tracks
    ]
    inner = (left + 0.16 * width, bottom + 0.14 * height, 0.66 * width, 0.77 * height)
    span_s = (float(shape.knots_s[0]), float(shape.knots_s[-1]))
    axes = _space_time_axes(figure, inner, scene, [shape], [line[:, :2] for line, _, _ in lines], span_s)
    _draw_prisms(axes, [(style, shape)], ())
    for line, look, colour in lines:
        axes.plot(*line.T, color=colour, zorder=4, **look)
    if name in scene.planned:
        boxes = scene.planned[name].boxes(shape.knots_s)
        closed = np.concatenate([boxes, boxes[:, :1]], axis=1)
        times = np.broadcast_to(shape.knots_s[:, None, None], (*closed.shape[:2], 1))
        outlines = Line3DCollection(np.concatenate([closed, times], axis=2), colors=INK, linewidths=0.6)
        outlines.set_zorder(5)
        axes.add_collection3d(outlines, autolim=False)


def _cut(track: Track, shape: CorridorShape) -> FloatArray:
    """The part (S, 3) x, y, t of a track during its corridor."""
    inside = (track.times_s >= shape.knots_s[0] - 1e-6) & (track.times_s <= shape.knots_s[-1] + 1e-6)
    return np.column_stack([track.poses[inside, :2], track.times_s[inside]])


def _space_time_axes(
    figure: Figure,
    place: Place,
    scene: WindowScene,
    shapes: Iterable[CorridorShape],
    points: Iterable[FloatArray] = (),
    span_s: tuple[float, float] | None = None,
) -> Any:
    """Make (x, y, t) axes whose box fills a place of the figure, seen from where paths are longest.

    They hold the whole window if no span is given.
    """
    begin_s, end_s = span_s or (0.0, scene.duration_s)
    shapes = list(shapes)
    corners = np.concatenate([shape.outlines_m.reshape(-1, 2) for shape in shapes] + list(points))
    low, high = corners.min(axis=0), corners.max(axis=0)
    # Metres are equally long in x and y; a very long road is padded rather than squeezed.
    padding = np.maximum(0.35 * (high - low).max() - (high - low), 1.0) / 2.0
    low, high = low - padding, high + padding
    size = high - low
    scale = scene.config.view.metres_per_second or _METRES_PER_SECOND
    height_m = float(np.clip((end_s - begin_s) * scale, 0.7 * size.max(), size.max()))
    axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection=Axes3D.name, computed_zorder=False)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(begin_s, end_s))
    axes.set_box_aspect((*size, height_m))
    axes.view_init(elev=_ELEVATION_DEG, azim=_best_azimuth_deg(shapes, height_m / (end_s - begin_s)))
    for axis, name in ((axes.xaxis, "x [m]"), (axes.yaxis, "y [m]"), (axes.zaxis, "t [s]")):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_label_text(name)
        axis.labelpad = -4.0 if axis is axes.zaxis else -1.0
        short = axis is not axes.zaxis and size["xy".index(axis.axis_name)] < 0.45 * size.max()
        axis.set_major_locator(MaxNLocator(nbins=2 if short else 5, steps=[1, 2, 5, 10]))
    # Turned along its axis, it would stand on its head on the left.
    axes.zaxis.set_rotate_label(False)
    axes.zaxis.label.set_rotation(90.0)
    axes.tick_params(pad=0)
    _fill_place(axes, place)
    return axes


def _best_azimuth_deg(shapes: list[CorridorShape], metres_per_second: float) -> float:
    """The azimuth from which the most foreshortened path is longest on the page."""
    elevation = np.radians(_ELEVATION_DEG)
    # Views along an axis of the box are left out: its labels would fall onto each other.
    azimuths_deg = np.add.outer(np.arange(-90.0, 270.0, 90.0), (30.0, 45.0, 60.0)).ravel()
    cos, sin = np.cos(np.radians(azimuths_deg)), np.sin(np.radians(azimuths_deg))
    lengths = []
    for shape in shapes:
        dx, dy = np.diff(shape.pivots_m, axis=0).T[:, None]  # each (1, K)
        dz = np.diff(shape.knots_s) * metres_per_second
        right = -sin[:, None] * dx + cos[:, None] * dy
        up = -(cos[:, None] * dx + sin[:, None] * dy) * np.sin(elevation) + dz * np.cos(elevation)
        lengths.append(np.hypot(right, up).sum(axis=1))
    return float(azimuths_deg[np.argmax(np.round(np.min(lengths, axis=0), 6))])


def _fill_place(axes: Any, place: Place) -> None:
    """Scale and move the axes until the projected box fills the place (left, bottom, width, height)."""
    figure = axes.figure
    axes.apply_aspect()
    corners = np.array(list(product(axes.get_xlim(), axes.get_ylim(), axes.get_zlim())))
    x, y, _ = proj3d.proj_transform(*corners.T, axes.get_proj())
    seen = figure.transFigure.inverted().transform(axes.transData.transform(np.column_stack([x, y])))
    (left, bottom), (right, top) = seen.min(axis=0), seen.max(axis=0)
    now = axes.get_position()
    scale = min(place[2] / (right - left), place[3] / (top - bottom))
    # A point at fraction f of the axes moves with them: solve for where the box's middle belongs.
    middle_x = ((left + right) / 2.0 - now.x0) * scale
    middle_y = ((bottom + top) / 2.0 - now.y0) * scale
    axes.set_position(
        (
            place[0] + place[2] / 2.0 - middle_x,
            place[1] + place[3] / 2.0 - middle_y,
            now.width * scale,
            now.height * scale,
        )
    )


def _draw_floor(axes: Any, lanes_m: FloatArray) -> None:
    """Draw the lanes at t = 0, cut at the box: three-dimensional axes do not clip."""
    segments = clip_segments(lanes_m, axes.get_xlim(), axes.get_ylim())
    if len(segments):
        flat = np.concatenate([segments, np.zeros((*segments.shape[:2], 1))], axis=2)
        lanes = Line3DCollection(flat, colors=GRID, linewidths=2.5)
        lanes.set_zorder(0.5)
        axes.add_collection3d(lanes, autolim=False)


def clip_segments(points_m: FloatArray, x_m: tuple[float, float], y_m: tuple[float, float]) -> FloatArray:
    """Cut the segments between points (P, 2) to a rectangle; (S, 2, 2), without those outside.

    A NaN point ends a line. Each segment is kept where the four half planes leave some of it
    (Liang and Barsky's method).
    """
    starts, steps = points_m[:-1], np.diff(points_m, axis=0)
    enter, leave = np.zeros(len(starts)), np.ones(len(starts))
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis, (low, high) in enumerate((x_m, y_m)):
            to_low = (low - starts[:, axis]) / steps[:, axis]
            to_high = (high - starts[:, axis]) / steps[:, axis]
            parallel = steps[:, axis] == 0.0
            inside = (starts[:, axis] >= low) & (starts[:, axis] <= high)
            first = np.where(parallel, np.where(inside, 0.0, np.inf), np.minimum(to_low, to_high))
            last = np.where(parallel, np.where(inside, 1.0, -np.inf), np.maximum(to_low, to_high))
            enter, leave = np.maximum(enter, first), np.minimum(leave, last)
    kept = enter < leave  # false where a point is NaN
    ends = np.stack([enter[kept], leave[kept]], axis=1)[..., None]
    return np.asarray(starts[kept, None] + ends * steps[kept, None])


def _draw_prisms(
    axes: Any, corridors: list[tuple[VehicleStyle, CorridorShape]], obstacles: tuple[CorridorShape, ...]
) -> None:
    """Draw all cubes as one collection, so that near faces hide far ones across vehicles."""
    faces: list[FloatArray] = []
    fills: list[Any] = []
    edges: list[Any] = []
    painted = [(style.colour, 0.13, 0.8, shape) for style, shape in corridors]
    painted += [(MUTED, 0.3, 0.6, _standing(shape, axes)) for shape in obstacles]
    for colour, fill, edge, shape in painted:
        quads = _prism_faces(shape)
        faces.append(quads)
        fills += [to_rgba(colour, fill)] * len(quads)
        edges += [to_rgba(colour, edge)] * len(quads)
    if faces:
        prisms = Poly3DCollection(np.concatenate(faces), facecolors=fills, edgecolors=edges, linewidths=0.5)
        prisms.set_zorder(1)
        axes.add_collection3d(prisms, autolim=False)


def _prism_faces(shape: CorridorShape) -> FloatArray:
    """Faces (6K, 4, 3) of a corridor's cubes."""
    levels = np.repeat(shape.spans_s, 4, axis=1)[..., None]  # (K, 8, 1)
    corners = np.concatenate([np.tile(shape.outlines_m, (1, 2, 1)), levels], axis=2)  # (K, 8, 3)
    return corners[:, _FACES].reshape(-1, 4, 3)


def _standing(shape: CorridorShape, axes: Any) -> CorridorShape:
    """The part of an obstacle inside the box; one that stands still is one tall prism."""
    middles = shape.outlines_m.mean(axis=1)
    (x_min, x_max), (y_min, y_max) = axes.get_xlim(), axes.get_ylim()
    inside = ((middles > (x_min, y_min)) & (middles < (x_max, y_max))).all(axis=1)
    outlines, spans = shape.outlines_m[inside], shape.spans_s[inside]
    if len(outlines) and np.allclose(outlines, outlines[0]):
        outlines, spans = outlines[:1], np.array([[spans[:, 0].min(), spans[:, 1].max()]])
    return CorridorShape(shape.name, outlines, spans, shape.pivots_m, shape.references_m, shape.knots_s)


def _draw_pivots(axes: Any, shape: CorridorShape, style: VehicleStyle, *, named: bool) -> None:
    axes.plot(*shape.pivots_m.T, shape.knots_s, color=PAPER, linewidth=2.6, zorder=2)
    axes.plot(
        *shape.pivots_m.T,
        shape.knots_s,
        color=style.colour,
        marker=style.marker,
        markersize=4,
        markeredgecolor=INK,
        markeredgewidth=0.5,
        linewidth=1.4,
        zorder=3,
    )
    if named:
        above_s = 0.05 * float(axes.get_zlim()[1])
        axes.text(
            *shape.pivots_m[-1], shape.knots_s[-1] + above_s, style.label, fontsize=7.5, ha="center", zorder=6
        )
