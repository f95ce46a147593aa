"""Static pictures of a result, the paper's Figs. 5 to 8 in kind.

Drawn with matplotlib's object-oriented interface alone: no window, no pyplot state, and the same
bytes every time.
"""

from __future__ import annotations

import io
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

__all__ = ["Format", "WindowScene", "draw_figures", "draw_scene", "figure_bytes", "window_scene"]

Format = Literal["svg", "png", "pdf"]

#: Planned boxes are measured this often: their knots are too far apart.
_PLANNED_STEP_S = 0.02

#: Without dates and versions, so that the same picture is the same bytes.
_METADATA: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


def draw_figures(result: Result, window: int) -> dict[str, Figure]:
    """Draw all pictures of one window.

    Parameters
    ----------
    result : Result
        A result as read back.
    window : int
        Index of the window.

    Returns
    -------
    dict
        Figures by name: corridors, own_corridors, top_down, filmstrip, speed_acceleration,
        separation; of many vehicles own_corridors_2, speed_acceleration_2 and so on. A window
        without a plan has only those that show the recording; one without recorded vehicles none.

    Raises
    ------
    UsageError
        If the result has no such window.
    """
    return draw_scene(window_scene(result, window))


def draw_scene(scene: WindowScene, most_pages: int | None = None) -> dict[str, Figure]:
    """Draw the pictures of a gathered window, with at most `most_pages` pages of each kind."""
    figures: dict[str, Figure] = {}
    as_recorded, as_planned = scene.compared
    recorded, planned = closest_pair(as_recorded), closest_pair(as_planned, _PLANNED_STEP_S)
    with drawing_style():
        if scene.corridors:
            figures["corridors"] = draw_all_corridors(scene)
            pages = ceil(len(scene.corridors) / PANELS)
            for page in range(pages if most_pages is None else min(pages, most_pages)):
                figures[_page("own_corridors", page)] = draw_own_corridors(scene, page)
        if scene.recorded or scene.planned:
            figures["top_down"] = draw_top_down(scene, recorded)
            pages = speed_pages(scene)
            for page in range(pages if most_pages is None else min(pages, most_pages)):
                figures[_page("speed_acceleration", page)] = draw_speed_acceleration(scene, page)
        if recorded is not None:
            figures["filmstrip"] = draw_filmstrip(scene, recorded)
        if recorded is not None or planned is not None:
            figures["separation"] = draw_separation(scene, recorded, planned)
    return figures


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
