"""Two results side by side, as pictures and as a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import polars as pl
import pytest
from matplotlib.figure import Figure

from istc_replay.comparison.compare import compare_results
from istc_replay.datatypes import Result
from istc_replay.export.figures import figure_bytes
from istc_replay.export.figures.beside import draw_beside
from istc_replay.export.report import beside
from istc_replay.export.report.beside import comparison_html

KINDS = {"corridors", "priorities", "top_down", "filmstrip", "speed_acceleration", "separation"}


@pytest.fixture(scope="module")
def figures(synthetic_result: Result, moved_result: Callable[[Result], Result]) -> dict[str, Figure]:
    """The pictures of a result and of one whose plans moved."""
    return draw_beside(synthetic_result, moved_result(synthetic_result), 0)


@pytest.fixture
def unpictured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without pictures, for tests that read the words alone."""
    monkeypatch.setattr(beside, "draw_beside", lambda _a, _b, _window: {})


def words(figure: Figure) -> list[str]:
    """All that is written in a picture."""
    return [text.get_text() for text in figure.findobj(lambda artist: hasattr(artist, "get_text"))]


def test_both_results_are_in_every_picture(figures: dict[str, Figure]) -> None:
    assert set(figures) == KINDS
    for name, figure in figures.items():
        told = " ".join(words(figure))
        assert "A" in told, name
        assert "B" in told, name
        assert "recorded" not in told.replace("as recorded", ""), name


def test_the_pictures_show_how_far_the_plans_are_apart(
    figures: dict[str, Figure], synthetic_result: Result
) -> None:
    a, b = figures["top_down"].axes[:2]

    def ways(axes: Any) -> dict[str, Any]:
        return {line.get_color(): line.get_ydata() for line in axes.lines if len(line.get_ydata()) > 10}

    of_a, of_b = ways(a), ways(b)
    assert len(of_a) == len(of_b) > 1
    apart = [(of_b[colour] - of_a[colour]).max() for colour in of_a if len(of_a[colour]) == len(of_b[colour])]
    assert apart == pytest.approx([1.0] * len(apart))
    assert apart


def test_priorities_have_a_mark_of_each_side_for_every_vehicle(
    figures: dict[str, Figure], synthetic_result: Result
) -> None:
    vehicles = synthetic_result.summary["windows"][0]["vehicles"]
    (first, *_) = figures["priorities"].axes
    marks = [line for line in first.lines if line.get_marker() not in ("None", None)]
    areas = [vehicle["corridor_area_m2"] for vehicle in vehicles]
    assert sorted(line.get_xdata()[0] for line in marks) == pytest.approx(sorted(areas * 2))


def test_a_second_drawing_gives_the_same_bytes(
    figures: dict[str, Figure], synthetic_result: Result, moved_result: Callable[[Result], Result]
) -> None:
    again = draw_beside(synthetic_result, moved_result(synthetic_result), 0)
    for name in ("corridors", "priorities", "separation"):
        assert figure_bytes(figures[name], "svg") == figure_bytes(again[name], "svg")


def test_windows_without_a_plan_are_still_compared(synthetic_result: Result) -> None:
    first, *others = synthetic_result.summary["windows"]
    failed = {"windows": [first | {"status": "no_corridors"}, *others]}
    other = replace(synthetic_result, summary=synthetic_result.summary | failed)
    assert set(draw_beside(synthetic_result, other, 0)) == KINDS - {"corridors", "priorities"}


def test_the_page_of_a_result_beside_itself_is_the_verdict_alone(synthetic_result: Result) -> None:
    comparison = compare_results(synthetic_result, synthetic_result)
    text = comparison_html(comparison, synthetic_result, synthetic_result, ("a", "b"))
    assert "Nothing differs: the two results are the same." in text
    assert "<table" not in text
    assert "<svg" not in text


def test_a_window_in_which_nothing_moved_has_no_pictures(synthetic_result: Result) -> None:
    first, *others = synthetic_result.summary["windows"]
    proven = first | {"corridors": first["corridors"] | {"bound": -1.0}}
    other = replace(synthetic_result, summary=synthetic_result.summary | {"windows": [proven, *others]})
    text = comparison_html(compare_results(synthetic_result, other), synthetic_result, other, ("a", "b"))
    assert "corridors.bound" in text
    assert "<svg" not in text


def test_the_page_tells_what_moved_and_who_waits(
    synthetic_result: Result, moved_result: Callable[[Result], Result], unpictured: None
) -> None:
    other = moved_result(synthetic_result)
    only = replace(other, states=other.states.filter(pl.col("vehicle_id") != "car 3"))
    text = comparison_html(compare_results(synthetic_result, only), synthetic_result, only, ("a", "b"))
    for told in ("What moved", "car 1", ">1.00<", "corridors.gap_max", "In one alone"):
        assert told in text, told


def test_hostile_names_stay_text(
    hostile_result: Result, moved_result: Callable[[Result], Result], unpictured: None
) -> None:
    other = moved_result(hostile_result)
    title = "</title><script>alert(1)</script>\u202e"
    text = comparison_html(compare_results(hostile_result, other), hostile_result, other, (title, title))
    assert "<script" not in text
    assert "<img" not in text
    assert "<b>" not in text
    assert "<i>" not in text
    assert "\u202e" not in text
    assert "X" * 300 not in text
