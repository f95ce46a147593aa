"""The pictures of a window, inlined so that they follow the page's theme and never clash."""

from __future__ import annotations

import re

from istc_replay.export.figures import KINDS, WindowScene, draw_scene, figure_bytes
from istc_replay.export.figures.profiles import speed_pages
from istc_replay.export.figures.space_time import PANELS
from istc_replay.export.report.markup import Html, captioned, element, join, names, number
from istc_replay.export.report.page import THEME
from istc_replay.export.text import visible

_TAG = re.compile(r"<[^>]*>")
_IDENTIFIER = re.compile(r' id="([^"]*)"')
_REFERENCE = re.compile(r'(?:xlink:)?href="#([^"]*)"')
_ADDRESS = re.compile(r"url\(#([^)]*)\)")
_DECIMALS = re.compile(r"(\d\.\d\d)\d+")
_COLOUR = re.compile("|".join(map(re.escape, THEME)))
_FONT = re.compile(r"font-family: [^;\"]*;? ?")
_SIZE = re.compile(r'viewBox="([\d. ]+)"')

_CAPTIONS = {
    "corridors": "Corridors of all vehicles in space-time. A prism is one corridor-cube: the area that one "
    "vehicle has to itself for one time unit. Markers are the pivotal points.",
    "own_corridors": "Each vehicle's own corridor with its planned trajectory inside, and its box at the "
    "boundaries of the time units. Each panel has its own span, turned so that its path is seen best.",
    "top_down": "Trajectories from above as recorded, and beside or below that as planned; what has no plan "
    "stays dashed. Ticks mark whole seconds from the window's start. Boxes stand at the instant at which the "
    "recording brings two of them closest; a ring marks the place if they are less than 4 m apart.",
    "filmstrip": "Instants about the closest approach of the recording. Dashed boxes are recorded, filled "
    "ones planned, with the corridor-cubes of that instant around them.",
    "speed_acceleration": "Speed and acceleration, recorded and planned. Limits far from all lines are not "
    "drawn.",
    "separation": "Gap between the two closest boxes, of the planned vehicles where there are several, else "
    "of all: recorded at the instants of the recording, planned every 0.02 s. Below zero they overlap; gaps "
    "far above the least are cut off.",
}
_RECORDED_CAPTIONS = {
    "top_down": "Trajectories from above as recorded. Ticks mark whole seconds from the window's start. "
    "Boxes stand at the instant at which two are closest; a ring marks the place if they are less than 4 m "
    "apart.",
    "filmstrip": "Instants about the closest approach of the recording.",
    "speed_acceleration": "Speed and acceleration as recorded.",
    "separation": "Gap between the two closest boxes of all that was recorded, at the instants of the "
    "recording. Below zero they overlap; gaps far above the least are cut off.",
}


def window_pictures(scene: WindowScene) -> Html:
    """Draw a window's pictures with their captions."""
    figures = draw_scene(scene, most_pages=1)
    index = scene.window["index"]
    shown = []
    for picture in KINDS:
        if picture in figures:
            caption = _caption(picture, scene)
            svg = inline_svg(
                figure_bytes(figures[picture], "svg"), f"w{index}-{picture}", _alternative(picture, scene)
            )
            shown.append(captioned(svg, caption))
    return join([element("h3", "Pictures"), shown]) if shown else join(())


def inline_svg(svg: bytes, prefix: str, alternative: str) -> Html:
    """Turn a figure's SVG into an element of the page.

    Identifiers get a prefix of their own, so that two pictures never share one; colours become
    the theme's, fonts the page's, and coordinates keep two decimals.
    """
    text = svg.decode("utf-8")
    text = text[text.index("<svg") :]
    # The page has its own rule for line joins, and a rule in a picture would hold for all of it.
    text = re.sub(r"<style.*?</style>|<!--.*?-->|<metadata.*?</metadata>", "", text, flags=re.DOTALL)
    root = text[: text.index(">") + 1]
    size = _SIZE.search(root)
    opening = element("svg", role="img", aria_label=alternative, viewBox=size[1] if size else None)
    body = _TAG.sub(lambda match: _adopted(match[0], prefix), text[len(root) :].strip())
    return Html(str(opening).removesuffix("</svg>") + re.sub(r"\n\s*", "\n", body))


def _adopted(tag: str, prefix: str) -> str:
    # Only what is referred to needs its identifier: clip paths, markers and hatches.
    tag = _IDENTIFIER.sub("" if tag.startswith("<g") else rf' id="{prefix}-\1"', tag)
    tag = _REFERENCE.sub(rf'href="#{prefix}-\1"', tag)
    tag = _ADDRESS.sub(rf"url(#{prefix}-\1)", tag)
    tag = _COLOUR.sub(lambda match: THEME[match[0]], tag)
    return _DECIMALS.sub(r"\1", _FONT.sub("", tag))


def _alternative(picture: str, scene: WindowScene) -> str:
    who = _spoken(scene)
    span = f"over {scene.duration_s:.1f} seconds"
    both = "as recorded and as planned" if scene.has_plan else "as recorded"
    return {
        "corridors": f"Corridors of {who} in space and time {span}.",
        "own_corridors": f"Each vehicle's own corridor with its trajectories inside: {who}.",
        "top_down": f"Trajectories of {who} from above, {both}, with a tick each second.",
        "filmstrip": f"Six instants about the closest approach, from above, {both}: {who}.",
        "speed_acceleration": f"Speed and acceleration of {who} {span}, {both}.",
        "separation": f"Gap of the closest pair of vehicles {span}, {both}.",
    }[picture]


def _spoken(scene: WindowScene) -> str:
    labels = [visible(scene.styles[vehicle].label) for vehicle in scene.recorded | scene.planned]
    more = f" and {len(labels) - 8} more" if len(labels) > 8 else ""
    return ", ".join(labels[:8]) + more


def _caption(picture: str, scene: WindowScene) -> Html:
    text = (_CAPTIONS if scene.has_plan else _RECORDED_CAPTIONS)[picture]
    if picture == "speed_acceleration" and scene.has_plan:
        limits = scene.config.trajectories
        low, high = number(-limits.deceleration_max_mps2, 1), number(limits.acceleration_max_mps2, 1)
        text = f"{text} The plan's acceleration is limited to {low} to {high} m/s²."
    if picture == "speed_acceleration" and speed_pages(scene) > 1:
        text += " Some vehicles are shown; istc-replay figures draws all."
    left_out = list(scene.corridors)[PANELS:]
    if picture == "own_corridors" and left_out:
        return join([text, " Not shown here: ", names(left_out), "; istc-replay figures draws all."])
    return join([text])
