"""The rows and bounds of layer 1, against brute force and against motions that must satisfy them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors.groups import search
from istc_replay.corridors.problem import CorridorProblem, Limits
from istc_replay.datatypes import read_only


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


def test_the_first_step_of_who_was_handed_over_follows_its_steering(crossing: Callable[..., Any]) -> None:
    case = crossing(0, vehicles=1)
    driver = case.scenario.participants[0]
    way, heading = driver.start.speed_mps * 1.0, driver.start.heading_rad

    def aside_m(steering_rad: float) -> tuple[float, float]:
        start = replace(driver.start, steering_rad=steering_rad, acceleration_mps2=0.0)
        handed = replace(driver, start=start, ahead=read_only([[0.0, start.x_m, start.y_m, heading]]))
        rows = replace(case, scenario=replace(case.scenario, participants=(handed,))).problem().rows
        before = case.problem().rows
        across = rows.weight[:, :2] @ [-np.sin(heading), np.cos(heading)]
        own = np.flatnonzero((across > 0.99) & (rows.index[:, 2] < 0))
        assert len(rows.lower) == len(before.lower) + 1
        offset = np.array([-np.sin(heading), np.cos(heading)]) @ [start.x_m, start.y_m]
        return float(rows.lower[own[-1]] - offset), float(rows.upper[own[-1]] - offset)

    low, high = aside_m(0.0)
    assert (low, high) == pytest.approx((-0.75, 0.75))
    low, high = aside_m(0.1)
    turned = way * np.tan(0.1) / driver.dimensions.wheelbase_m
    straight = way * turned / 2.0 + driver.dimensions.rear_axle_to_centre_m * np.sin(turned)
    assert (low + high) / 2.0 == pytest.approx(straight)
    assert high - low == pytest.approx(1.5 + straight)
