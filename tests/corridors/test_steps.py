"""Limits of the pivotal steps, widened one-sidedly to what the guidance itself does."""

from __future__ import annotations

import numpy as np
import pytest

from istc_replay.corridors.problem import Limits
from istc_replay.corridors.steps import make_steps
from istc_replay.datatypes import Guidance, read_only

LIMITS = Limits(cone=0.4, acceleration_mps2=1.5, deceleration_mps2=3.0, lateral_acceleration_mps2=1.5)
REACH_M, UNIT_S = 5.0, 0.5


def guided(ways_m: list[float], turn_rad: float = 0.0) -> Guidance:
    """A guidance of such steps, each turned from the one before."""
    headings = np.arange(len(ways_m)) * turn_rad
    steps = np.array(ways_m)[:, None] * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    points = np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])
    ends = np.append(headings, headings[-1])
    poses = np.column_stack([points, ends])
    times = np.arange(len(points)) * UNIT_S
    return Guidance(
        "1", "recorded", read_only(points, 2), read_only(ends), 5.0, read_only(times), read_only(poses, 3)
    )


def test_a_calm_guidance_has_the_limits_themselves() -> None:
    steps = make_steps(guided([2.5] * 4), LIMITS, REACH_M, UNIT_S, 5.0)
    square = UNIT_S**2
    np.testing.assert_allclose(
        steps.second_m[1:-1], [[-3.0 * square, 1.5 * square, -1.5 * square, 1.5 * square]] * 3
    )
    np.testing.assert_allclose(steps.step_m[1:], [[0.0, REACH_M]] * 3)
    # From 5 m/s: half a second of braking, and of speeding up.
    np.testing.assert_allclose(steps.step_m[0], [2.5 - 3.0 * square / 2.0, 2.5 + 1.5 * square / 2.0])
    np.testing.assert_allclose(steps.along, [[1.0, 0.0]] * 4)


@pytest.mark.parametrize("turn_rad", [0.5, -0.5])
def test_a_bend_tighter_than_the_limit_is_allowed_to_its_own_side_alone(turn_rad: float) -> None:
    steps = make_steps(guided([2.5] * 4, turn_rad), LIMITS, REACH_M, UNIT_S, 5.0)
    bend = 2.5 * np.sin(turn_rad)  # across the heading of the step that follows
    assert abs(bend) > 1.5 * UNIT_S**2
    right, left = steps.second_m[1:-1, 2], steps.second_m[1:-1, 3]
    limit = 1.5 * UNIT_S**2
    np.testing.assert_allclose(left, bend if turn_rad > 0.0 else limit, atol=1e-12)
    np.testing.assert_allclose(right, bend if turn_rad < 0.0 else -limit, atol=1e-12)


@pytest.mark.parametrize(("ways_m", "column"), [([4.0, 2.0, 2.0], 0), ([1.0, 3.0, 3.0], 1)])
def test_a_change_of_speed_beyond_the_limit_is_allowed_where_the_guidance_makes_it(
    ways_m: list[float], column: int
) -> None:
    steps = make_steps(guided(ways_m), LIMITS, REACH_M, UNIT_S, ways_m[0] / UNIT_S)
    change = ways_m[1] - ways_m[0]
    assert steps.second_m[1, column] == pytest.approx(change)
    assert steps.second_m[1, 1 - column] == pytest.approx((1.5, -3.0)[column] * UNIT_S**2)
    np.testing.assert_allclose(steps.second_m[2, :2], [-3.0 * UNIT_S**2, 1.5 * UNIT_S**2])


def test_who_stands_heads_as_its_guidance_does_and_a_long_step_is_its_own_reach() -> None:
    steps = make_steps(guided([0.0, 6.0, 2.0], 0.3), LIMITS, REACH_M, UNIT_S, 0.0)
    np.testing.assert_allclose(steps.along[0], [1.0, 0.0])
    assert steps.step_m[0].tolist() == [0.0, pytest.approx(1.5 * UNIT_S**2 / 2.0)]
    assert steps.step_m[1].tolist() == [0.0, 6.0]
