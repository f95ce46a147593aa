"""Dubins words against known cases, exact driving and a search over all words."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from istc_replay.guidance.curves import Curve, Pose, smooth_to_goal
from istc_replay.guidance.dubins import Word, dubins_words

poses = st.builds(Pose, st.floats(-15, 15), st.floats(-15, 15), st.floats(-math.pi, math.pi))


def driven(start: Pose, name: str, lengths: Any, radius: float) -> tuple[Any, Any]:
    """End points, as x + iy, and headings after three exact arcs whose lengths may be arrays."""
    z, heading = complex(start.x_m, start.y_m), start.heading_rad
    for letter, length in zip(name, lengths, strict=True):
        before, kappa = heading, {"L": 1.0, "R": -1.0, "S": 0.0}[letter] / radius
        heading = before + kappa * length
        if kappa == 0.0:
            z = z + length * np.exp(1j * before)
        else:
            z = z + (np.exp(1j * heading) - np.exp(1j * before)) / (1j * kappa)
    return z, heading


def smoothed(word: Word, start: Pose, goal: Pose) -> Curve | None:
    return smooth_to_goal(start, goal, word.lengths_m, word.curvatures_1pm, 4.0)


@given(start=poses, goal=poses, radius=st.floats(2.0, 8.0))
def test_every_word_ends_at_the_goal(start: Pose, goal: Pose, radius: float) -> None:
    words = dubins_words(start, goal, radius)
    assert {"LSL", "RSR"} <= {word.name for word in words}
    assert [word.length_m for word in words] == sorted(word.length_m for word in words)
    for word in words:
        end, heading = driven(start, word.name, word.lengths_m, radius)
        assert abs(end - complex(goal.x_m, goal.y_m)) < 1e-6
        assert math.remainder(heading - goal.heading_rad, 2 * math.pi) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("goal", "length_m", "name"),
    [
        (Pose(10.0, 0.0, 0.0), 10.0, None),
        (Pose(0.0, 4.0, math.pi), 2.0 * math.pi, "LSL"),
        (Pose(2.0, 2.0, math.pi / 2), math.pi, "LSL"),
        (Pose(4.0, 4.0, 0.0), 2.0 * math.pi, None),
        (Pose(0.0, -14.0, math.pi), 2.0 * math.pi + 10.0, "RSR"),
    ],
)
def test_known_shortest_paths_of_radius_2(goal: Pose, length_m: float, name: str | None) -> None:
    best = dubins_words(Pose(0.0, 0.0, 0.0), goal, 2.0)[0]
    assert best.length_m == pytest.approx(length_m, abs=1e-9)
    if name:
        assert best.name == name


@pytest.mark.parametrize(
    ("start", "goal"),
    [
        (Pose(0.0, 0.0, 0.3), Pose(3.0, 1.0, 2.9)),
        (Pose(0.0, 0.0, -1.0), Pose(-2.0, 2.0, 1.5)),
        (Pose(0.0, 0.0, 0.0), Pose(0.0, -1.2, -2.8)),
    ],
)
def test_no_path_of_three_arcs_is_shorter(start: Pose, goal: Pose) -> None:
    step = 0.08
    turns, straights = np.arange(0.0, 2 * math.pi, step), np.arange(0.0, 6.0, step)
    found = math.inf
    for name in ("LSL", "LSR", "RSL", "RSR", "LRL", "RLR"):
        t, p, q = np.meshgrid(turns, straights if "S" in name else turns, turns, indexing="ij")
        ends, headings = driven(start, name, (t, p, q), 1.0)
        near = np.abs(ends - complex(goal.x_m, goal.y_m)) < 1.5 * step
        near &= np.abs(np.angle(np.exp(1j * (headings - goal.heading_rad)))) < 1.5 * step
        found = min(found, float((t + p + q)[near].min(initial=math.inf)))
    assert dubins_words(start, goal, 1.0)[0].length_m == pytest.approx(found, abs=6 * step)


@settings(max_examples=40, deadline=None)
@given(start=poses, goal=poses)
def test_a_smoothed_word_still_ends_at_the_goal_and_never_turns_tighter(start: Pose, goal: Pose) -> None:
    for word in dubins_words(start, goal, 6.0):
        curve = smoothed(word, start, goal)
        if curve is None:
            continue
        end = curve.poses([curve.length_m])[0]
        assert end[:2] == pytest.approx([goal.x_m, goal.y_m], abs=1e-8)
        assert math.remainder(end[2] - goal.heading_rad, 2 * math.pi) == pytest.approx(0.0, abs=1e-8)
        assert np.abs(curve.curvatures_1pm).max() <= 1.0 / 6.0 + 1e-9


def test_most_words_can_be_smoothed() -> None:
    random = np.random.default_rng(5)
    drawn = [[Pose(*values) for values in random.uniform(-20.0, 20.0, (2, 3))] for _ in range(30)]
    found = [smoothed(dubins_words(start, goal, 6.0)[0], start, goal) for start, goal in drawn]
    assert sum(curve is not None for curve in found) >= 25
