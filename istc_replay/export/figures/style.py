"""How all pictures look: one set of settings, free of the user's own matplotlib settings."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from math import ceil
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.lines import Line2D

from istc_replay.export.colours import Colour, vehicle_colours

#: The four colours that belong to no vehicle; the report swaps them for its theme's own.
INK, MUTED, GRID, PAPER = "#1e2329", "#69707a", "#d3d7dc", "#fefefe"
CONTACT = "#c8321f"

#: Relative luminance of lines: three to one against white, and against a dark page as well.
_LUMINANCE = (0.175, 0.25)
MARKERS = "os^Dvp<>Ph"
LABEL_CHARACTERS = 20
LEGEND_ENTRIES = 12
#: Entries of a legend that has a side of the picture to itself.
SIDE_ENTRIES = 26
#: Up to this many vehicles are named beside their paths, more in the legend alone.
NAMED = 8

#: Settings that change a picture; all others stay the caller's.
_DRAWN = (
    *("axes", "figure", "font", "grid", "hatch", "legend", "lines", "markers", "mathtext", "patch"),
    *("path", "pdf", "savefig", "scatter", "svg", "text", "xaxis", "xtick", "yaxis", "ytick"),
)
_STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": MUTED,
    "axes.facecolor": "none",
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 9,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 9.5,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "figure.dpi": 100,
    "figure.facecolor": PAPER,
    "font.family": ["DejaVu Sans"],
    "font.size": 8.5,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "hatch.linewidth": 0.5,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.labelcolor": INK,
    "lines.dash_capstyle": "butt",
    "pdf.fonttype": 42,
    "savefig.dpi": 150,
    "svg.fonttype": "none",
    "svg.hashsalt": "istc-replay",
    "text.color": INK,
    "text.parse_math": False,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
    "ytick.labelsize": 8,
}


@dataclass(frozen=True, slots=True)
class VehicleStyle:
    """How one vehicle is drawn in every picture: colour and marker say the same."""

    colour: str
    marker: str
    label: str


@contextmanager
def drawing_style() -> Iterator[None]:
    """Draw with these settings and restore the caller's afterwards."""
    with mpl.rc_context(_settings()):
        yield


@cache
def _settings() -> Any:
    defaults = {key: value for key, value in mpl.rcParamsDefault.items() if key.startswith(_DRAWN)}
    return defaults | _STYLE


def vehicle_styles(vehicle_ids: Iterable[str], excluded: Collection[str] = ()) -> dict[str, VehicleStyle]:
    """Give each vehicle of a result its colour, marker and drawable label."""
    styles = {}
    for index, (vehicle_id, colour) in enumerate(vehicle_colours(vehicle_ids).items()):
        # A bare number could be read as a second or a coordinate; what is left out may be no vehicle.
        kind = "" if not vehicle_id.isdigit() else "no. " if vehicle_id in excluded else "vehicle "
        marker = MARKERS[index % len(MARKERS)]
        styles[vehicle_id] = VehicleStyle(line_colour(colour), marker, drawable(kind + vehicle_id))
    return styles


def line_colour(colour: Colour) -> str:
    """Return a colour as #rrggbb, darker or lighter where thin lines of it would be lost on a page."""
    luminance = max(relative_luminance(colour), 1e-6)
    factor = min(max(luminance, _LUMINANCE[0]), _LUMINANCE[1]) / luminance
    channels = (round(255.0 * _encoded(min(factor * _linear(value), 1.0))) for value in colour)
    return "#" + "".join(f"{channel:02x}" for channel in channels)


def relative_luminance(colour: Colour) -> float:
    """Relative luminance of an sRGB colour, 0 black to 1 white (WCAG 2.2)."""
    red, green, blue = (_linear(value) for value in colour)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def _linear(value: int) -> float:
    share = value / 255.0
    return share / 12.92 if share <= 0.04045 else float(((share + 0.055) / 1.055) ** 2.4)


def _encoded(share: float) -> float:
    return 12.92 * share if share <= 0.0031308 else float(1.055 * share ** (1.0 / 2.4) - 0.055)


def drawable(text: str) -> str:
    """Return text that every backend can draw: short, printable, with glyphs for all characters."""
    if len(text) > LABEL_CHARACTERS:
        text = f"{text[: LABEL_CHARACTERS - 9]}…{text[-8:]}"
    glyphs = _glyphs()
    return "".join(c if c.isprintable() and ord(c) in glyphs else "\ufffd" for c in text) or "\ufffd"


@cache
def _glyphs() -> frozenset[int]:
    return frozenset(get_font(findfont(FontProperties(family="DejaVu Sans"))).get_charmap())


def new_figure(width_in: float, height_in: float) -> Figure:
    """Make a figure that belongs to no window and no pyplot state."""
    return Figure(figsize=(round(width_in, 2), round(height_in, 2)))


def origin_note(figure: Figure, origin_m: tuple[float, float], *, at_top: bool) -> None:
    """Say where the axes' origin lies where the map's own is far away."""
    if origin_m != (0.0, 0.0):
        note = f"origin of the axes: x {origin_m[0]:.0f} m, y {origin_m[1]:.0f} m"
        x, y = (0.995, 0.99) if at_top else (0.008, 0.012)
        align: dict[str, Any] = {"ha": "right", "va": "top"} if at_top else {}
        figure.text(x, y, note, fontsize=6.5, color=MUTED, **align)


def vehicle_legend(
    target: Axes | Figure, styles: Iterable[VehicleStyle], most: int = LEGEND_ENTRIES, **where: Any
) -> None:
    """Name the vehicles by colour and marker; past `most` the rest is counted."""
    styles = list(styles)
    shown = styles[:most]
    handles: list[Artist] = [
        Line2D([], [], color=style.colour, marker=style.marker, markersize=4.5, linewidth=2)
        for style in shown
    ]
    labels = [style.label for style in shown]
    if len(styles) > len(shown):
        handles.append(Line2D([], [], linestyle="none"))
        labels.append(f"and {len(styles) - len(shown)} more")
    _add_legend(target, handles, labels, **where)


def line_legend(target: Axes | Figure, lines: Iterable[tuple[str, dict[str, Any]]], **where: Any) -> None:
    """Name what the line styles mean, in the ink's colour."""
    pairs = list(lines)
    handles = [Line2D([], [], **({"color": INK} | look)) for _, look in pairs]
    _add_legend(target, handles, [name for name, _ in pairs], **where)


def foot_height_in(styles: list[VehicleStyle]) -> float:
    """Height that `foot_legend` needs."""
    entries = min(len(styles), LEGEND_ENTRIES + 1)
    return 0.12 + 0.2 * ceil(entries / _foot_columns(styles))


def foot_legend(figure: Figure, styles: list[VehicleStyle], lines: list[tuple[str, dict[str, Any]]]) -> None:
    """Name the vehicles at the lower left and the line styles at the lower right."""
    vehicle_legend(figure, styles, loc="lower left", bbox_to_anchor=(0.03, 0.0), ncols=_foot_columns(styles))
    line_legend(figure, lines, loc="lower right", bbox_to_anchor=(1.0, 0.0), ncols=len(lines))


def _foot_columns(styles: list[VehicleStyle]) -> int:
    # About 5.8 of the page's 9.9 inches, 0.55 an entry and 0.08 a character.
    longest = max((len(style.label) for style in styles), default=1)
    return max(int(5.8 / (0.55 + 0.08 * longest)), 1)


def _add_legend(
    target: Axes | Figure, handles: Iterable[Artist], labels: Iterable[str], **where: Any
) -> None:
    # Names that start with an underscore are left out of a legend that finds its own labels, so
    # the texts are set afterwards.
    names = list(labels)
    legend = target.legend(list(handles), [str(n) for n in range(len(names))], **where)
    for text, name in zip(legend.get_texts(), names, strict=True):
        text.set_text(name)
