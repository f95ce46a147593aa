"""Instants about the conflict, seen from above."""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from istc_replay.datatypes import FloatArray
from istc_replay.export.figures.closest import ClosestPair
from istc_replay.export.figures.plan_view import CLOSE_M, WIDTH_IN, draw_boxes, draw_ground, set_view
from istc_replay.export.figures.style import (
    CONTACT,
    MUTED,
    foot_height_in,
    foot_legend,
    new_figure,
    origin_note,
)
from istc_replay.export.figures.tracks import Track, WindowScene

_FRAMES = 6
#: Half the side of a frame: at least this, else what is driven in this time up to that.
_NEAR_M, _NEAR_S, _FAR_M = 14.0, 1.2, 40.0


def draw_filmstrip(scene: WindowScene, conflict: ClosestPair) -> Figure:
    """Draw instants about the closest approach of the recording: cubes, planned and recorded boxes."""
    speed_mps = max(_speed(scene.recorded[name], conflict.time_s) for name in conflict.pair)
    reach = max(_NEAR_M, 3.0 * max(scene.recorded[name].length_m for name in conflict.pair))
    reach = max(reach, min(_NEAR_S * speed_mps, _FAR_M))
    # Fast vehicles cross the picture soon: more of it is shown, in shorter steps.
    step_s = min(max(scene.unit_s, scene.duration_s / 12.0), max(0.4 * reach / max(speed_mps, 0.1), 0.2))
    times_s = _instants(conflict.time_s, step_s, scene.duration_s)
    x, y = conflict.place_m
    columns, rows = 3, ceil(_FRAMES / 3)
    side = (WIDTH_IN - 0.9) / columns - 0.15
    styles = [scene.styles[name] for name in scene.recorded | scene.planned]
    foot_in = 0.5 + foot_height_in(styles)
    total_in = rows * (side + 0.35) + foot_in
    figure = new_figure(WIDTH_IN, total_in)
    for index, time_s in enumerate(times_s):
        row, column = divmod(index, columns)
        left_in = 0.6 + column * (side + 0.25)
        bottom_in = foot_in + (rows - 1 - row) * (side + 0.35)
        axes = figure.add_axes((left_in / WIDTH_IN, bottom_in / total_in, side / WIDTH_IN, side / total_in))
        set_view(axes, (x - reach, x + reach, y - reach, y + reach))
        if row < rows - 1:
            axes.set(xlabel="", xticklabels=[])
        if column:
            axes.set(ylabel="", yticklabels=[])
        draw_ground(axes, scene)
        _draw_cubes(axes, scene, float(time_s))
        draw_boxes(axes, scene, scene.recorded, float(time_s), filled=False)
        draw_boxes(axes, scene, scene.planned, float(time_s), filled=True)
        closest = time_s == conflict.time_s
        axes.set_title(f"t = {time_s:.2f} s" + (f", closest {_as(scene.names[0])}" if closest else ""))
        if closest and conflict.least_m < CLOSE_M:
            axes.plot(x, y, "o", markersize=30, mfc="none", markeredgecolor=CONTACT)
    first, second = (f"box {_as(name)}" for name in scene.names)
    meaning: list[tuple[str, dict[str, Any]]] = [(first, {"linestyle": (0, (2, 1.2)), "linewidth": 1.1})]
    if scene.has_plan:
        cubes = "corridor-cube" if scene.names[1] == "planned" else f"corridor-cube of {scene.names[1]}"
        meaning = [(second, {"linewidth": 5, "alpha": 0.6}), *meaning, (cubes, {"linewidth": 0.8})]
    foot_legend(figure, styles, meaning)
    origin_note(figure, scene.origin_m, at_top=True)
    return figure


def _as(name: str) -> str:
    return f"as {name}" if name in ("recorded", "planned") else f"in {name}"


def _instants(time_s: float, step_s: float, duration_s: float) -> FloatArray:
    """The frames' instants, `time_s` among them: two before it if the window has room."""
    step_s = min(step_s, duration_s / (_FRAMES - 1))
    most_before = time_s / step_s
    least_before = _FRAMES - 1 - (duration_s - time_s) / step_s
    before = int(np.clip(np.ceil(max(least_before - 1e-9, 2.0)), 0, np.floor(most_before + 1e-9)))
    times_s = time_s + step_s * (np.arange(_FRAMES) - before)
    return np.asarray(np.clip(times_s, 0.0, duration_s))


def _speed(track: Track, time_s: float) -> float:
    """Mean speed over the half seconds about a time, as far as the track reaches [m/s]."""
    times_s = np.clip([time_s - 0.5, time_s + 0.5], track.times_s[0], track.times_s[-1])
    before, after = track.at(times_s)[:, :2]
    moved_m = float(np.hypot(*(after - before)))
    return moved_m / float(times_s[1] - times_s[0]) if moved_m > 0.0 else 0.0


def _draw_cubes(axes: Axes, scene: WindowScene, time_s: float) -> None:
    outlines, colours = [], []
    shapes = [(scene.styles[name].colour, shape) for name, shape in scene.corridors.items()]
    for colour, shape in shapes + [(MUTED, shape) for shape in scene.obstacles]:
        # At the instant between two cubes the one that begins is shown.
        now = (shape.spans_s[:, 0] <= time_s + 1e-9) & (time_s + 1e-9 < shape.spans_s[:, 1])
        now |= (shape.spans_s[:, 1] == shape.spans_s[:, 1].max()) & (abs(time_s - shape.spans_s[:, 1]) < 1e-9)
        outlines += list(shape.outlines_m[now])
        colours += [colour] * int(now.sum())
    if outlines:
        fills = [to_rgba(colour, 0.1) for colour in colours]
        axes.add_collection(
            PolyCollection(outlines, facecolors=fills, edgecolors=colours, linewidths=0.8, zorder=2),
            autolim=False,
        )
