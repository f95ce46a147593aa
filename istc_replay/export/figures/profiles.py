"""Quantities over time: speed and acceleration, and the gap of the closest pair."""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from istc_replay.datatypes import FloatArray
from istc_replay.export.figures.closest import ClosestPair
from istc_replay.export.figures.style import (
    CONTACT,
    GRID,
    INK,
    MUTED,
    NAMED,
    PAPER,
    line_legend,
    new_figure,
    vehicle_legend,
)
from istc_replay.export.figures.tracks import Track, WindowScene

_PLANNED: dict[str, Any] = {"linestyle": "-", "linewidth": 2.0}
#: The rim parts a dash from a planned line of the same colour below it.
_RIM = [withStroke(linewidth=2.2, foreground=PAPER)]
_RECORDED: dict[str, Any] = {"linestyle": (0, (4, 2.4)), "linewidth": 1.0, "path_effects": _RIM}
#: Gaps up to here are always on the scale [m].
_INTERESTING_M = 8.0
_LIMIT: dict[str, Any] = {"linestyle": (0, (7, 2, 1.5, 2)), "linewidth": 0.9, "color": INK}
_OTHERS: dict[str, Any] = {"linestyle": "-", "linewidth": 0.7, "color": GRID, "zorder": 1.0}
_QUANTITIES = (("speeds_mps", "speed [m/s]"), ("accelerations_mps2", "acceleration [m/s²]"))
_PANELS, _COLUMNS = 12, 4
#: Points of a vehicle's line in the background of other vehicles' panels.
_BACKGROUND_POINTS = 25


def speed_pages(scene: WindowScene) -> int:
    """Pages that `draw_speed_acceleration` needs: one for a few vehicles, else one a dozen."""
    names = scene.recorded | scene.planned
    return 1 if len(names) <= NAMED else ceil(len(names) / _PANELS)


def draw_speed_acceleration(scene: WindowScene, page: int = 0) -> Figure:
    """Draw speed and acceleration over time, recorded and planned, as the paper's Fig. 8.

    Many vehicles get a panel each, with all others in the background.
    """
    if speed_pages(scene) > 1 or len(scene.recorded | scene.planned) > NAMED:
        return _draw_panels(scene, page)
    figure = new_figure(9.9, 5.4)
    axes = [figure.add_axes((0.065, bottom, 0.725, 0.415)) for bottom in (0.555, 0.085)]
    limited = False
    for target, (quantity, label) in zip(axes, _QUANTITIES, strict=True):
        for tracks, look in ((scene.recorded, _RECORDED), (scene.planned, _PLANNED)):
            for name, track in tracks.items():
                _draw_line(target, scene, name, track, quantity, look, planned=tracks is scene.planned)
        target.set(xlim=(0.0, scene.duration_s), ylabel=label)
        target.margins(y=0.08)
        limited |= _draw_limits(target, scene, quantity)
    axes[0].set(xticklabels=[])
    axes[1].set(xlabel="time from the window's start [s]")
    names = list(scene.recorded | scene.planned)
    vehicle_legend(
        figure, [scene.styles[name] for name in names], loc="upper left", bbox_to_anchor=(0.795, 0.99)
    )
    line_legend(figure, _meaning(scene, limited), loc="lower left", bbox_to_anchor=(0.795, 0.06))
    return figure


def _meaning(scene: WindowScene, limited: bool) -> list[tuple[str, dict[str, Any]]]:
    planned = [(scene.names[1], _PLANNED)] if scene.planned else []
    return [*planned, (scene.names[0], _RECORDED), *([("limit of the plan", _LIMIT)] if limited else [])]


def _draw_panels(scene: WindowScene, page: int) -> Figure:
    """One pair of panels a vehicle: its own lines in its colour, those of all others in grey."""
    names = list(scene.recorded | scene.planned)
    shown = names[page * _PANELS : (page + 1) * _PANELS]
    rows = ceil(len(shown) / _COLUMNS)
    height_in = 2.55 * rows + 0.55
    figure = new_figure(9.9, height_in)
    backgrounds = {quantity: _background(scene, quantity) for quantity, _ in _QUANTITIES}
    limits = {quantity: _common_range(scene, quantity) for quantity, _ in _QUANTITIES}
    limited = False
    for place, name in enumerate(shown):
        row, column = divmod(place, _COLUMNS)
        top_in = height_in - 0.28 - 2.55 * row
        for part, (quantity, label) in enumerate(_QUANTITIES):
            left, bottom_in = 0.06 + 0.24 * column, top_in - 0.98 - 1.08 * part
            axes = figure.add_axes((left, bottom_in / height_in, 0.205, 0.98 / height_in))
            _draw_panel(axes, scene, name, quantity, backgrounds[quantity])
            axes.set(xlim=(0.0, scene.duration_s), ylim=limits[quantity])
            limited |= _draw_limits(axes, scene, quantity)
            lowest = place + _COLUMNS >= len(shown)
            axes.set(
                ylabel="" if column else label.replace(" ", "\n"),
                xlabel="time [s]" if part and lowest else "",
            )
            axes.tick_params(labelleft=not column, labelbottom=bool(part))
        figure.text(left, (top_in + 0.06) / height_in, scene.styles[name].label, fontsize=8.5)
    meaning = [*_meaning(scene, limited), ("all others", _OTHERS)]
    line_legend(figure, meaning, loc="lower right", bbox_to_anchor=(1.0, 0.0), ncols=len(meaning))
    return figure


def _common_range(scene: WindowScene, quantity: str) -> tuple[float, float]:
    tracks = [*scene.recorded.values(), *scene.planned.values()]
    values = np.concatenate([getattr(track, quantity) for track in tracks])
    low, high = float(np.nanmin(values, initial=0.0)), float(np.nanmax(values, initial=0.0))
    margin = 0.08 * (high - low) or 1.0
    return low - margin, high + margin


def _background(scene: WindowScene, quantity: str) -> FloatArray:
    """All vehicles' lines as one (P, 2) line with gaps, coarse enough to be drawn in every panel."""
    parts = []
    for track in (scene.planned or scene.recorded).values():
        line = np.column_stack(track.with_gaps(getattr(track, quantity)))
        thin = np.unique(np.linspace(0, len(line) - 1, _BACKGROUND_POINTS).round().astype(int))
        parts += [line[thin], np.full((1, 2), np.nan)]
    return np.concatenate(parts)


def _draw_panel(axes: Axes, scene: WindowScene, name: str, quantity: str, background: FloatArray) -> None:
    axes.plot(*background.T, **_OTHERS)
    if name in scene.recorded:
        _draw_line(axes, scene, name, scene.recorded[name], quantity, _RECORDED, planned=False)
    if name in scene.planned:
        _draw_line(axes, scene, name, scene.planned[name], quantity, _PLANNED, planned=True)


def _draw_line(
    axes: Axes,
    scene: WindowScene,
    name: str,
    track: Track,
    quantity: str,
    look: dict[str, Any],
    *,
    planned: bool,
) -> None:
    times, values = track.with_gaps(getattr(track, quantity))
    style = scene.styles[name]
    axes.plot(times, values, color=style.colour, zorder=2.0 if planned else 2.1, **look)
    if planned or not scene.planned:
        # Markers once a second or so, shifted a little from vehicle to vehicle.
        count = max(int(times[-1] - times[0]), 1)
        every = max(len(times) // count, 1)
        first = list(scene.styles).index(name) * max(every // 4, 1) % every
        axes.plot(
            times[first::every],
            values[first::every],
            style.marker,
            color=style.colour,
            markersize=4,
            alpha=0.95,
        )


def _speed_limit_mps(scene: WindowScene) -> float:
    """The largest speed of the plan: as configured, or more where traffic was faster."""
    fastest = [float(np.nanmax(abs(track.speeds_mps), initial=0.0)) for track in scene.recorded.values()]
    return max(scene.config.trajectories.speed_max_mps, 1.15 * max(fastest, default=0.0) + 1.0)


def _draw_limits(axes: Axes, scene: WindowScene, quantity: str) -> bool:
    """Draw the plan's limits, but do not squeeze the lines for one that is far away."""
    limits = scene.config.trajectories
    both = (-limits.deceleration_max_mps2, limits.acceleration_max_mps2)
    if quantity == "speeds_mps":
        both = (0.0, _speed_limit_mps(scene))
    bottom, top = axes.get_ylim()
    reach = 0.6 * (top - bottom)
    near = [limit for limit in both if scene.planned and bottom - reach <= limit <= top + reach]
    for limit in near:
        axes.axhline(limit, **_LIMIT)
    return bool(near)


def draw_separation(scene: WindowScene, recorded: ClosestPair | None, planned: ClosestPair | None) -> Figure:
    """Draw the gap of the closest pair over time, recorded against planned."""
    figure = new_figure(9.9, 3.6)
    axes = figure.add_axes((0.065, 0.13, 0.915, 0.74))
    looks = (
        (scene.names[0], recorded, {**_RECORDED, "linewidth": 1.4, "color": MUTED, "marker": "v"}),
        (scene.names[1], planned, {"linewidth": 2.0, "color": INK, "marker": "^"}),
    )
    shown = [(name, pair, look) for name, pair, look in looks if pair is not None]
    for _, pair, look in shown:
        axes.plot(pair.times_s, pair.gaps_m, markevery=[int(np.nanargmin(pair.gaps_m))], markersize=7, **look)
    gaps = np.concatenate([pair.gaps_m for _, pair, _ in shown])
    # What is far apart needs no scale of its own.
    least = float(np.nanmin(gaps))
    top = min(float(np.nanmax(gaps)), max(2.5 * least, _INTERESTING_M)) * 1.1
    bottom = min(1.4 * least, -0.12 * top)
    axes.set(xlim=(0.0, scene.duration_s), ylim=(bottom, max(top, 1.0)))
    axes.axhspan(bottom, 0.0, facecolor=CONTACT, alpha=0.12, linewidth=0.0)
    axes.axhline(0.0, color=CONTACT, linewidth=0.9)
    axes.annotate(
        "boxes overlap", (0.0, bottom), xytext=(4, 4), textcoords="offset points", fontsize=7.5, color=INK
    )
    axes.set(xlabel="time from the window's start [s]", ylabel="gap of the closest pair [m]")
    lines = [(_least_text(scene, name, pair), look) for name, pair, look in shown]
    line_legend(axes, lines, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
    return figure


def _least_text(scene: WindowScene, name: str, pair: ClosestPair) -> str:
    first, second = (scene.styles[vehicle].label for vehicle in pair.pair)
    gap = f"{pair.least_m:.2f}".replace("-", "\u2212")
    return f"{name}: least {gap} m at {pair.time_s:.2f} s, {first} and {second}"
