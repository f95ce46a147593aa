"""What the report says of a window is what its checks say."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from istc_replay.datatypes import Result
from istc_replay.export.report import report_html

from ..support.pages import Page
from ..support.results import proven, with_window


def test_a_certified_window_says_what_is_proven_and_both_least_gaps(
    synthetic_result: Result, unpictured: None
) -> None:
    words = Page(report_html(proven(synthetic_result), "x")).words
    assert "✓ Certified: 3 of 3 plannable vehicles have plans that pass every check; 3 are present." in words
    assert "no two planned boxes touch at any instant" in words
    assert "as recorded: 4.20 m, vehicles car 1 and car 2 at 5.00 s." in words
    assert "as planned: 0.40 m, vehicles car 3 at 5.40 s." in words
    assert "Not certified" not in words


def test_the_planned_gap_counts_from_the_distance_asked_for(
    synthetic_result: Result, unpictured: None
) -> None:
    asked = replace(proven(synthetic_result), config_toml="[certificate]\nseparation_m = 0.5\n")
    assert "as planned: 0.90 m" in Page(report_html(asked, "x")).words


def test_a_failing_check_outweighs_the_status(document: str) -> None:
    words = Page(document).words
    assert "✗ Not certified, although its status says so" in words
    assert "checks that fail: dynamics." in words
    assert "✓ Certified" not in words


def test_a_status_without_any_check_is_not_believed(synthetic_result: Result, unpictured: None) -> None:
    unchecked = replace(synthetic_result, certificates=synthetic_result.certificates.clear())
    words = Page(report_html(unchecked, "x")).words
    assert "no check was made" in words
    assert "✓ Certified" not in words


def test_a_window_that_ends_away_from_a_goal_shows_its_plan_and_says_so(synthetic_result: Result) -> None:
    late = with_window(
        proven(synthetic_result), status="goal_not_reached", reason="goal not reached: a by 1.2 m"
    )
    words = Page(report_html(late, "x")).words
    assert "Not everybody reaches its goal" in words
    assert "Reason: goal not reached: a by 1.2 m" in words
    assert "as planned" in words


@pytest.mark.parametrize(
    "status", ["conflict_left", "no_corridors", "not_drivable", "nothing_to_plan", "unheard_of"]
)
def test_a_window_without_a_plan_gives_its_reason_and_shows_none(
    synthetic_result: Result, status: str
) -> None:
    unsolved = with_window(synthetic_result, status=status, reason="car 1 and car 2 start in each other")
    text = report_html(unsolved, "x")
    words = Page(text).words
    assert "No plan" in words
    assert "Reason: car 1 and car 2 start in each other" in words
    assert "as planned" not in words
    assert "Proven" not in words
    pictures = "".join(re.findall(r"<svg.*?</svg>", text, re.DOTALL))
    assert "planned" not in pictures
    assert "-corridors-" not in pictures
