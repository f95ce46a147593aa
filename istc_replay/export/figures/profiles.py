"""Quantities over time: speed and acceleration, and the gap of the closest pair."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from istc_replay.export.figures.closest import ClosestPair
from istc_replay.export.figures.style import (
    CONTACT,
    INK,
    MUTED,
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


def draw_speed_acceleration(scene: WindowScene) -> Figure:
    """Draw speed and acceleration over time, recorded and planned, as the paper's Fig. 8."""
    figure = new_figure(9.9, 5.4)
    axes = [figure.add_axes((0.065, bottom, 0.725, 0.415)) for bottom in (0.555, 0.085)]
    for target, quantity in zip(axes, ("speeds_mps", "accelerations_mps2"), strict=True):
        for name, track in scene.recorded.items():
            _draw_line(target, scene, name, track, quantity, _RECORDED, planned=False)
        for name, track in scene.planned.items():
            _draw_line(target, scene, name, track, quantity, _PLANNED, planned=True)
        target.set(xlim=(0.0, scene.duration_s))
        target.margins(y=0.08)
    axes[0].set(ylabel="speed [m/s]", xticklabels=[])
    axes[1].set(ylabel="acceleration [m/s²]", xlabel="time from the window's start [s]")
    if scene.planned:
        limits = scene.config.trajectories
        _draw_limits(axes[0], (0.0, _speed_limit_mps(scene)))
        _draw_limits(axes[1], (-limits.deceleration_max_mps2, limits.acceleration_max_mps2))
    names = list(scene.recorded | scene.planned)
    vehicle_legend(
        figure, [scene.styles[name] for name in names], loc="upper left", bbox_to_anchor=(0.795, 0.99)
    )
    meaning = [("recorded", _RECORDED)]
    if scene.planned:
        meaning = [("planned", _PLANNED), ("recorded", _RECORDED), ("limit of the plan", _LIMIT)]
    line_legend(figure, meaning, loc="lower left", bbox_to_anchor=(0.795, 0.06))
    return figure


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
        count = max(int(scene.duration_s), 1)
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


def _draw_limits(axes: Axes, limits: Iterable[float]) -> None:
    """Draw limits, but do not squeeze the lines for one that is far away."""
    bottom, top = axes.get_ylim()
    reach = 0.6 * (top - bottom)
    for limit in limits:
        if bottom - reach <= limit <= top + reach:
            axes.axhline(limit, **_LIMIT)


def draw_separation(scene: WindowScene, recorded: ClosestPair | None, planned: ClosestPair | None) -> Figure:
    """Draw the gap of the closest pair over time, recorded against planned."""
    figure = new_figure(9.9, 3.6)
    axes = figure.add_axes((0.065, 0.13, 0.915, 0.74))
    looks = (
        ("recorded", recorded, {**_RECORDED, "linewidth": 1.4, "color": MUTED, "marker": "v"}),
        ("planned", planned, {"linewidth": 2.0, "color": INK, "marker": "^"}),
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
