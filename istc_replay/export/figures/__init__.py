"""Static pictures of a result, the paper's Figs. 5 to 8 in kind.

Drawn with matplotlib's object-oriented interface alone: no window, no pyplot state, and the same
bytes every time.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Collection
from functools import partial
from math import ceil
from typing import Any, Literal

from matplotlib.figure import Figure

from istc_replay.datatypes import Result
from istc_replay.export.figures.closest import closest_pair
from istc_replay.export.figures.filmstrip import draw_filmstrip
from istc_replay.export.figures.plan_view import draw_top_down
from istc_replay.export.figures.profiles import draw_separation, draw_speed_acceleration, speed_pages
from istc_replay.export.figures.space_time import PANELS, draw_all_corridors, draw_own_corridors
from istc_replay.export.figures.style import drawing_style
from istc_replay.export.figures.tracks import WindowScene, window_scene

__all__ = ["KINDS", "Format", "WindowScene", "draw_figures", "draw_scene", "figure_bytes", "window_scene"]

Format = Literal["svg", "png", "pdf"]
#: The kinds of pictures, in the order in which a report shows them.
KINDS = ("corridors", "own_corridors", "top_down", "filmstrip", "speed_acceleration", "separation")

#: Planned boxes are measured this often: their knots are too far apart.
_PLANNED_STEP_S = 0.02

#: Without dates and versions, so that the same picture is the same bytes.
_METADATA: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


def draw_figures(result: Result, window: int, only: Collection[str] = KINDS) -> dict[str, Figure]:
    """Draw pictures of one window.

    Parameters
    ----------
    result : Result
        A result as read back.
    window : int
        Index of the window.
    only : collection of str
        The kinds to draw; all of them otherwise.

    Returns
    -------
    dict
        Figures by name: the kinds `KINDS`; of many vehicles also own_corridors_2,
        speed_acceleration_2 and so on. A window without a plan has only those that show the
        recording; one without recorded vehicles none.

    Raises
    ------
    UsageError
        If the result has no such window.
    """
    return draw_scene(window_scene(result, window), only)


def draw_scene(
    scene: WindowScene, only: Collection[str] = KINDS, most_pages: int | None = None
) -> dict[str, Figure]:
    """Draw pictures of a gathered window, with at most `most_pages` pages of each kind."""
    as_recorded, as_planned = scene.compared
    recorded, planned = closest_pair(as_recorded), None
    if "separation" in only:
        planned = closest_pair(as_planned, _PLANNED_STEP_S)
    drawn: dict[str, list[Callable[[], Figure]]] = {}
    if scene.corridors:
        drawn["corridors"] = [lambda: draw_all_corridors(scene)]
        pages = ceil(len(scene.corridors) / PANELS)
        drawn["own_corridors"] = [partial(draw_own_corridors, scene, page) for page in range(pages)]
    if scene.recorded or scene.planned:
        drawn["top_down"] = [lambda: draw_top_down(scene, recorded)]
        pages = speed_pages(scene)
        drawn["speed_acceleration"] = [partial(draw_speed_acceleration, scene, page) for page in range(pages)]
    if recorded is not None:
        drawn["filmstrip"] = [partial(draw_filmstrip, scene, recorded)]
    if recorded is not None or planned is not None:
        drawn["separation"] = [lambda: draw_separation(scene, recorded, planned)]
    with drawing_style():
        return {
            _page(kind, page): draw()
            for kind, draws in drawn.items()
            if kind in only
            for page, draw in enumerate(draws[:most_pages])
        }


def _page(name: str, page: int) -> str:
    return name if page == 0 else f"{name}_{page + 1}"


def figure_bytes(figure: Figure, format: Format) -> bytes:  # noqa: A002
    """Return a figure as a file's bytes, the same on every call.

    Parameters
    ----------
    figure : Figure
        A figure of `draw_figures`.
    format : {'svg', 'png', 'pdf'}
        The file format; svg keeps its text as text.

    Returns
    -------
    bytes
        The file.
    """
    buffer = io.BytesIO()
    with drawing_style():
        figure.savefig(buffer, format=format, metadata=_METADATA[format])
    return buffer.getvalue()
