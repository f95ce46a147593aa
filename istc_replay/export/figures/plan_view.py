"""Seen from above: trajectories, recorded beside planned."""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from istc_replay.datatypes import FloatArray
from istc_replay.export.figures.closest import ClosestPair
from istc_replay.export.figures.style import (
    CONTACT,
    GRID,
    INK,
    MUTED,
    NAMED,
    PAPER,
    VehicleStyle,
    foot_height_in,
    foot_legend,
    new_figure,
    origin_note,
)
from istc_replay.export.figures.tracks import Track, WindowScene

#: View: x from, x to, y from, y to [m].
View = tuple[float, float, float, float]

WIDTH_IN = 9.9
_TICK_M = 0.9
_LABELS = 60
_SCALES_M = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
#: Vehicles nearer than this are ringed [m].
CLOSE_M = 4.0
_PLANNED: dict[str, Any] = {"linestyle": "-", "linewidth": 1.8}
_RECORDED: dict[str, Any] = {"linestyle": (0, (4, 1.8)), "linewidth": 1.3}


def draw_top_down(scene: WindowScene, recorded: ClosestPair | None) -> Figure:
    """Draw trajectories with a tick each second, recorded beside planned, as the paper's Fig. 7.

    The boxes stand where the vehicles are when the recording brings two of them closest.
    """
    panels = [(scene.names[0], scene.recorded, _RECORDED)]
    if scene.has_plan:
        panels.append((scene.names[1], scene.planned, _PLANNED))
    view = _view(scene)
    styles = [scene.styles[name] for name in scene.recorded | scene.planned]
    figure, all_axes = _top_down_axes(len(panels), (view[3] - view[2]) / (view[1] - view[0]), styles)
    for axes, (title, tracks, look) in zip(all_axes, panels, strict=True):
        set_view(axes, view)
        draw_ground(axes, scene)
        for name, track in tracks.items():
            _draw_path(axes, scene, name, track, look)
        # What has no plan moves as it was recorded, and the plan keeps clear of it.
        others = {name: track for name, track in scene.recorded.items() if name not in tracks}
        for name, track in others.items():
            _draw_path(axes, scene, name, track, _RECORDED)
        _label_seconds(axes, scene, tracks | others)
        axes.set_title(title)
        if recorded is not None:
            draw_boxes(axes, scene, tracks | others, recorded.time_s, filled=True)
            axes.set_title(f"{title}; boxes at {recorded.time_s:.2f} s")
            if recorded.least_m < CLOSE_M:
                axes.plot(*recorded.place_m, "o", markersize=30, mfc="none", markeredgecolor=CONTACT)
        _draw_scale(axes)
    foot_legend(figure, styles, [(title, look) for title, _, look in panels])
    origin_note(figure, scene.origin_m, at_top=True)
    return figure


def _top_down_axes(panels: int, ratio: float, styles: list[VehicleStyle]) -> tuple[Figure, list[Axes]]:
    """Lay panels of a height to width ratio side by side, or below each other where they are flat."""
    columns = 2 if panels == 2 and ratio > 0.55 else 1
    rows = panels // columns
    width_in = min(WIDTH_IN * (0.97 / columns) - 0.62, 6.2 / ratio)
    height_in = width_in * ratio
    foot_in, head_in, between_in = 0.5 + foot_height_in(styles), 0.3, 0.65
    total_in = foot_in + rows * (height_in + head_in) + (rows - 1) * between_in
    figure = new_figure(WIDTH_IN, total_in)
    all_axes = []
    for index in range(panels):
        row, column = divmod(index, columns)
        left_in = 0.6 + column * (width_in + 0.62)
        bottom_in = foot_in + (rows - 1 - row) * (height_in + head_in + between_in)
        place = (left_in / WIDTH_IN, bottom_in / total_in, width_in / WIDTH_IN, height_in / total_in)
        all_axes.append(figure.add_axes(place))
    return figure, all_axes


def _view(scene: WindowScene) -> View:
    """What all paths need, with a margin; never flatter than 1:5, so that the lanes can be told apart."""
    tracks = [*scene.recorded.values(), *scene.planned.values()]
    points = [track.poses[:, :2] for track in tracks]
    if not points:
        return -10.0, 10.0, -10.0, 10.0
    margin = 1.5 * max(track.length_m for track in tracks)
    stacked = np.concatenate(points)
    low, high = stacked.min(axis=0) - margin, stacked.max(axis=0) + margin
    size = high - low
    extra = np.maximum(size.max() / np.array([2.0, 5.0]) - size, 0.0) / 2.0
    low, high = low - extra, high + extra
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def set_view(axes: Axes, view: View) -> None:
    """Show a rectangle of the plane at one scale both ways."""
    axes.set(xlim=view[:2], ylim=view[2:], xlabel="x [m]", ylabel="y [m]", aspect="equal")


def draw_ground(axes: Axes, scene: WindowScene) -> None:
    """Draw what stands: lane lines, the road's edges, standing obstacles."""
    if len(scene.lanes_m):
        axes.plot(*scene.lanes_m.T, color=GRID, linewidth=3.0, zorder=0.6)
    if len(scene.edges_m):
        axes.plot(*scene.edges_m.T, color=MUTED, linewidth=0.7, zorder=0.65)
    if len(scene.standing_m):
        axes.add_collection(
            PolyCollection(
                list(scene.standing_m),
                facecolors=GRID,
                edgecolors=MUTED,
                linewidths=0.8,
                hatch="xxx",
            ),
            autolim=False,
        )


def _draw_path(axes: Axes, scene: WindowScene, name: str, track: Track, look: dict[str, Any]) -> None:
    style = scene.styles[name]
    _, points = track.with_gaps(track.poses[:, :2])
    axes.plot(*points.T, color=style.colour, **look)
    poses = track.at(_seconds(track))
    poses = poses[np.isfinite(poses[:, 0])]
    if len(poses):
        across = _TICK_M * np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])])
        ticks = np.stack([poses[:, :2] - across, poses[:, :2] + across], axis=1)
        axes.add_collection(LineCollection(list(ticks), colors=style.colour, linewidths=0.9), autolim=False)
    start, end = track.poses[0], track.poses[-1]
    marked: dict[str, Any] = {"color": style.colour, "markersize": 5, "markeredgewidth": 0.5}
    axes.plot(*start[:2], style.marker, markeredgecolor=INK, **marked)
    axes.plot(*end[:2], style.marker, markeredgecolor=style.colour, **marked | {"mfc": PAPER})
    if len(scene.recorded) <= NAMED:
        _name_start(axes, start, style.label)


def _name_start(axes: Axes, start: FloatArray, label: str) -> None:
    """Write a name behind a start or above it, towards the middle of the picture."""
    behind = -np.sign(np.sin(start[2])) if abs(np.sin(start[2])) > 0.5 else 1.0
    inward = start[0] < sum(axes.get_xlim()) / 2.0
    axes.annotate(
        label,
        (start[0], start[1]),
        xytext=(-4.0 if inward else 4.0, 10.0 * behind),
        textcoords="offset points",
        fontsize=7,
        ha="left" if inward else "right",
        va="center",
        annotation_clip=True,
    )


def _seconds(track: Track) -> FloatArray:
    return np.arange(ceil(track.times_s[0] - 1e-9), np.floor(track.times_s[-1] + 1e-9) + 1.0)


def _label_seconds(axes: Axes, scene: WindowScene, tracks: dict[str, Track]) -> None:
    """Write the seconds beside their ticks, as many as stay legible."""
    step = next((s for s in (1, 2, 5, 10, 20, 50) if len(tracks) * scene.duration_s / s <= _LABELS), 100)
    for track in tracks.values():
        seconds = _seconds(track)
        seconds = seconds[(seconds % step == 0) & (seconds > 0)]
        last = track.poses[0, :2]
        for second, (x, y, heading) in zip(seconds, track.at(seconds), strict=True):
            # Where a vehicle stands, one label is enough.
            if np.hypot(x - last[0], y - last[1]) >= _TICK_M:
                last = np.array([x, y])
                aside = 1.9 * _TICK_M
                axes.text(
                    x - aside * np.sin(heading),
                    y + aside * np.cos(heading),
                    f"{second:.0f}",
                    fontsize=6,
                    color=MUTED,
                    ha="center",
                    va="center",
                    clip_on=True,
                )


def draw_boxes(
    axes: Axes, scene: WindowScene, tracks: dict[str, Track], time_s: float, *, filled: bool
) -> None:
    """Draw all vehicles' boxes at one instant with their noses marked."""
    boxes, colours = [], []
    for name, track in tracks.items():
        box = track.boxes(np.array([time_s]))[0]
        if np.isfinite(box).all():
            style = scene.styles[name]
            boxes.append(box)
            colours.append(style.colour)
            marked: dict[str, Any] = (
                {"color": INK} if filled or not scene.has_plan else {"color": style.colour, "mfc": "none"}
            )
            axes.plot(*box.mean(axis=0), style.marker, markersize=3, zorder=4, clip_on=True, **marked)
    if not boxes:
        return
    fills = [to_rgba(colour, 0.55 if filled else 0.0) for colour in colours]
    axes.add_collection(
        PolyCollection(
            boxes,
            facecolors=fills,
            edgecolors=INK if filled else colours,
            linewidths=0.9 if filled else 1.1,
            linestyles="-" if filled else [(0, (2, 1.2))],
            zorder=3,
        ),
        autolim=False,
    )
    corners = np.array(boxes)
    centres = corners.mean(axis=1)
    noses = np.stack([centres, corners[:, :2].mean(axis=1)], axis=1)
    axes.add_collection(
        LineCollection(list(noses), colors=INK if filled else colours, linewidths=0.8, zorder=3),
        autolim=False,
    )


def _draw_scale(axes: Axes) -> None:
    """Draw a bar of a round length above the upper right corner."""
    left, right = axes.get_xlim()
    length = max((r for r in _SCALES_M if r <= 0.2 * (right - left)), default=_SCALES_M[0])
    across = axes.get_xaxis_transform()
    axes.plot(
        [right - length, right],
        [1.02, 1.02],
        color=INK,
        linewidth=2.0,
        solid_capstyle="butt",
        transform=across,
        clip_on=False,
    )
    axes.annotate(
        f"{length} m",
        (right - length, 1.02),
        xycoords=across,
        xytext=(-4.0, 0.0),
        textcoords="offset points",
        ha="right",
        va="center",
        fontsize=7,
    )
    axes.set_xlim(left, right)
