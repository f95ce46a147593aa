"""Pictures for eyes and printers without colour: what tells vehicles and sources apart."""

from __future__ import annotations

import io
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread

from istc_replay.datatypes import Result
from istc_replay.export.colours import vehicle_colours
from istc_replay.export.figures import draw_figures, figure_bytes, window_scene
from istc_replay.export.figures.style import CONTACT, INK, MUTED, line_colour, vehicle_styles

#: Linear RGB as the colour-blind see it (Machado, Oliveira and Fernandes 2009, severity 1), and as
#: a printer without colour does.
EYES = {
    "all": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
    "grey": [[0.2126, 0.7152, 0.0722]] * 3,
}
PAGES = {"light": "#ffffff", "dark": "#14171b"}


def linear(colour: Any) -> np.ndarray:
    """Linear RGB of a colour."""
    rgb = np.array(to_rgb(colour))
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def seen(colour: Any, eye: str) -> np.ndarray:
    """Linear RGB as an eye sees it."""
    return np.clip(np.array(EYES[eye]) @ linear(colour), 0.0, 1.0)


def contrast(one: np.ndarray, two: np.ndarray) -> float:
    """WCAG's contrast of two linear colours."""
    low, high = sorted(float(np.array([0.2126, 0.7152, 0.0722]) @ colour) for colour in (one, two))
    return (high + 0.05) / (low + 0.05)


def lab(rgb: np.ndarray) -> np.ndarray:
    """CIE L*a*b* of linear RGB."""
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ rgb
    share = xyz / [0.9505, 1.0, 1.089]
    f = np.where(share > 0.008856, np.cbrt(share), 7.787 * share + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.fixture(scope="module")
def figures(synthetic_result: Result) -> dict[str, Figure]:
    """The pictures of the synthetic window."""
    return draw_figures(synthetic_result, 0)


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("page", PAGES)
def test_every_vehicles_line_stands_out_from_the_page(eye: str, page: str) -> None:
    for colour in vehicle_colours(str(index) for index in range(30)).values():
        assert contrast(seen(line_colour(colour), eye), seen(PAGES[page], eye)) >= 3.0, (colour, eye, page)


def test_words_are_as_dark_as_small_print_asks_for() -> None:
    for colour in (INK, MUTED, CONTACT):
        assert contrast(linear(colour), linear("#ffffff")) >= 4.5


def test_thirty_vehicles_differ_in_colour_or_marker_and_neighbours_in_both() -> None:
    styles = list(vehicle_styles(str(index) for index in range(30)).values())
    assert len({(style.colour, style.marker) for style in styles}) == 30
    assert all(a.marker != b.marker and a.colour != b.colour for a, b in pairwise(styles))


@pytest.mark.parametrize("eye", EYES)
def test_vehicles_whose_colours_look_alike_have_other_markers(eye: str) -> None:
    styles = list(vehicle_styles(str(index) for index in range(10)).values())
    alike = [
        (a, b)
        for a, b in combinations(styles, 2)
        if np.linalg.norm(lab(seen(a.colour, eye)) - lab(seen(b.colour, eye))) < 20.0
    ]
    assert alike or eye == "all"
    assert all(a.marker != b.marker for a, b in alike)


def test_every_vehicle_carries_its_marker_wherever_it_has_a_line(
    figures: dict[str, Figure], synthetic_result: Result
) -> None:
    scene = window_scene(synthetic_result, 0)
    for name in ("corridors", "top_down", "speed_acceleration"):
        lines = [line for axes in figures[name].axes for line in axes.lines]
        for vehicle in scene.planned:
            style = scene.styles[vehicle]
            own = {line.get_marker() for line in lines if line.get_color() == style.colour}
            assert style.marker in own, (name, vehicle)
    boxes = [line.get_marker() for axes in figures["filmstrip"].axes for line in axes.lines]
    assert {scene.styles[vehicle].marker for vehicle in scene.planned} <= set(boxes)


def test_recorded_and_planned_differ_in_more_than_colour(figures: dict[str, Figure]) -> None:
    for name in ("own_corridors", "top_down", "speed_acceleration", "separation"):
        dashes = {line.is_dashed() for axes in figures[name].axes for line in axes.lines}
        assert dashes == {True, False}, name


def test_a_picture_in_grey_keeps_its_lines(figures: dict[str, Figure]) -> None:
    pixels = imread(io.BytesIO(figure_bytes(figures["speed_acceleration"], "png")))[..., :3]
    coloured = np.ptp(pixels, axis=2) > 0.25  # lines of the vehicles
    grey = pixels @ [0.2126, 0.7152, 0.0722]
    assert coloured.sum() > 1000
    assert np.quantile(grey[coloured], 0.9) < 0.75
