"""Two results side by side: group I beside group II, two settings, two versions."""

from __future__ import annotations

from dataclasses import replace
from math import nan
from typing import Any

from matplotlib.figure import Figure

from istc_replay.datatypes import Result
from istc_replay.export.figures.closest import closest_pair
from istc_replay.export.figures.filmstrip import draw_filmstrip
from istc_replay.export.figures.plan_view import draw_top_down
from istc_replay.export.figures.profiles import draw_separation, draw_speed_acceleration
from istc_replay.export.figures.space_time import draw_corridors_beside
from istc_replay.export.figures.style import (
    GRID,
    INK,
    PAPER,
    VehicleStyle,
    drawing_style,
    line_legend,
    new_figure,
    vehicle_styles,
)
from istc_replay.export.figures.tracks import WindowScene, window_scene

NAMES = ("A", "B")
#: Vehicles in the picture of priorities.
_ROWS = 24
_QUANTITIES = (
    ("corridor_area_m2", "area of all corridor-cubes [m²]"),
    ("pivot_deviation_m", "pivotal points off references [m]"),
    ("speed_std_mps", "standard deviation of speed [m/s]"),
)
#: Both motions are measured this often, since either may be a plan of few knots [s].
_STEP_S = 0.02


def draw_beside(a: Result, b: Result, window: int) -> dict[str, Figure]:
    """Draw one window of two results.

    Parameters
    ----------
    a, b : Result
        Results as read back.
    window : int
        Index of a window that both have.

    Returns
    -------
    dict
        Figures by name: corridors, priorities, top_down, filmstrip, speed_acceleration, separation.
        A is drawn as recordings are elsewhere, dashed; B as plans are. What has no plan moves as
        recorded. Pictures that would be empty are left out.

    Raises
    ------
    UsageError
        If a result has no such window.
    """
    of_a = window_scene(a, window)
    of_b = window_scene(b, window, of_a.origin_m)
    styles = vehicle_styles(of_a.styles.keys() | of_b.styles.keys())
    of_a, of_b = replace(of_a, styles=styles), replace(of_b, styles=styles)
    both = replace(
        of_b,
        names=NAMES,
        has_plan=True,
        duration_s=max(of_a.duration_s, of_b.duration_s),
        recorded=of_a.recorded | of_a.planned,
        planned=of_b.recorded | of_b.planned,
    )
    first, second = (closest_pair(tracks, _STEP_S) for tracks in (both.recorded, both.planned))
    figures: dict[str, Figure] = {}
    with drawing_style():
        if of_a.corridors and of_b.corridors:
            figures["corridors"] = draw_corridors_beside((of_a, of_b), NAMES)
        rows = _rows(of_a, of_b)
        if rows:
            figures["priorities"] = _draw_priorities(rows, styles)
        if both.recorded or both.planned:
            figures["top_down"] = draw_top_down(both, first)
            figures["speed_acceleration"] = draw_speed_acceleration(both)
        if first is not None:
            figures["filmstrip"] = draw_filmstrip(both, first)
        if first is not None or second is not None:
            figures["separation"] = draw_separation(both, first, second)
    return figures


def _rows(a: WindowScene, b: WindowScene) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Vehicles that have corridors in both, with what the summaries tell of them."""
    told = [{str(v["id"]): v for v in scene.window.get("vehicles") or []} for scene in (a, b)]
    names = [name for name in told[0] if name in a.corridors and name in b.corridors and name in told[1]]
    return [(name, told[0][name], told[1][name]) for name in names[:_ROWS]]


def _draw_priorities(
    rows: list[tuple[str, dict[str, Any], dict[str, Any]]], styles: dict[str, VehicleStyle]
) -> Figure:
    """What each vehicle's priority buys it: a row a vehicle, from A (hollow) to B (filled)."""
    height_in = 0.34 * len(rows) + 1.15
    figure = new_figure(9.9, height_in)
    levels = [-float(index) for index in range(len(rows))]
    for column, (quantity, label) in enumerate(_QUANTITIES):
        place = (0.21 + 0.265 * column, 0.52 / height_in, 0.24, (height_in - 1.0) / height_in)
        axes = figure.add_axes(place)
        for level, (name, of_a, of_b) in zip(levels, rows, strict=True):
            known = [told.get(quantity) for told in (of_a, of_b)]
            values = [nan if value is None else float(value) for value in known]
            style = styles[name]
            axes.plot(values, [level, level], color=style.colour, linewidth=1.2)
            axes.plot(values[0], level, style.marker, color=style.colour, mfc=PAPER, markersize=7)
            axes.plot(values[1], level, style.marker, color=style.colour, mec=INK, markersize=7, mew=0.6)
        axes.set(xlabel=label, ylim=(levels[-1] - 0.6, 0.6), yticks=levels)
        axes.set_yticklabels([_row_label(styles[name], a, b) for name, a, b in rows] if not column else [])
        axes.margins(x=0.12)
        axes.grid(visible=True, axis="y", color=GRID)
    look: dict[str, Any] = {"marker": "o", "linestyle": "none", "markersize": 6}
    meaning = [("A", {**look, "mfc": PAPER}), ("B", look)]
    line_legend(figure, meaning, loc="upper right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    figure.text(0.01, 1.0 - 0.1 / height_in, "vehicle: priority η in A and B", va="top", fontsize=8.5)
    return figure


def _row_label(style: VehicleStyle, a: dict[str, Any], b: dict[str, Any]) -> str:
    told = [side.get("priority") for side in (a, b)]
    one, two = ("none" if value is None else f"{value:.3g}" for value in told)
    return f"{style.label}: {one}" + ("" if one == two else f", {two}")
