"""Dubins words against known cases, exact driving and a search over all words."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from istc_replay.guidance.curves import Pose
from istc_replay.guidance.dubins import WORD_NAMES, word_lengths

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


def words(start: Pose, goal: Pose, radius: float) -> dict[str, Any]:
    """Lengths of the arcs of each word that exists."""
    lengths = word_lengths(start.as_array(), goal.as_array(), radius)
    return {name: arcs for name, arcs in zip(WORD_NAMES, lengths, strict=True) if np.isfinite(arcs).all()}


def shortest(start: Pose, goal: Pose, radius: float) -> tuple[float, str]:
    return min((float(arcs.sum()), name) for name, arcs in words(start, goal, radius).items())


@given(start=poses, goal=poses, radius=st.floats(2.0, 8.0))
def test_every_word_ends_at_the_goal(start: Pose, goal: Pose, radius: float) -> None:
    found = words(start, goal, radius)
    assert {"LSL", "RSR"} <= set(found)
    for name, lengths in found.items():
        end, heading = driven(start, name, lengths, radius)
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
    length, best = shortest(Pose(0.0, 0.0, 0.0), goal, 2.0)
    assert length == pytest.approx(length_m, abs=1e-9)
    if name:
        assert best == name


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
    assert shortest(start, goal, 1.0)[0] == pytest.approx(found, abs=6 * step)
