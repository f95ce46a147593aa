"""The rows and bounds of layer 1, against brute force and against motions that must satisfy them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors.groups import search
from istc_replay.corridors.problem import CorridorProblem, Limits


def violation(problem: CorridorProblem, z: np.ndarray) -> float:
    """Largest violation of bounds and rows at z."""
    worst = max(float((problem.lower - z).max()), float((z - problem.upper).max()))
    value = problem.rows.value(z)
    return max(worst, float((problem.rows.lower - value).max()), float((value - problem.rows.upper).max()))


def test_the_guidance_itself_meets_every_row_that_always_holds(intersection: Callable[..., Any]) -> None:
    problem = intersection("intersection_turn_first").problem()
    z = np.array(problem.reference)
    assert violation(problem, problem.least_cubes(z)) <= 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_the_trees_corridors_meet_every_row_and_disjunction(seed: int, crossing: Callable[..., Any]) -> None:
    problem = crossing(seed, vehicles=3).problem()
    found = search(problem, 4000)
    if found.z is None:
        assert found.exhausted
        return
    assert violation(problem, found.z) <= 1e-6
    if len(problem.separations):
        assert problem.separations.slack(found.z).max(axis=1).min() >= -1e-5


def test_random_walks_within_the_limits_stay_within_the_reachable_bounds(
    crossing: Callable[..., Any],
) -> None:
    problem = crossing(3, vehicles=2).problem()
    random = np.random.default_rng(0)
    rows = problem.rows
    names, counts = zip(*rows.families, strict=True)
    steps = np.repeat(names, counts) == "eq. (12)"
    found = 0
    for _ in range(4000):
        z = problem.least_cubes(
            problem.reference + random.normal(0.0, 0.4, problem.size) * (problem.quadratic > 0)
        )
        value = rows.value(z)
        kept = np.all(((rows.lower <= value) & (value <= rows.upper))[steps])
        if kept:
            found += 1
            pivots = problem.pivot_indices
            assert np.all(z[pivots] >= problem.lower[pivots] - 1e-9)
            assert np.all(z[pivots] <= problem.upper[pivots] + 1e-9)
    assert found > 20


def test_tightened_limits_are_smaller() -> None:
    limits = Limits(0.4, 1.5, 3.0, 1.5)
    tight = limits.tightened()
    assert tight.cone < limits.cone
    assert tight.deceleration_mps2 < limits.deceleration_mps2
