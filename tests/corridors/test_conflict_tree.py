"""Stage A: the conflict trees against brute force, their groups, and their budget."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors.groups import search
from istc_replay.corridors.polish import polish
from istc_replay.corridors.problem import CorridorProblem


def brute_force(problem: CorridorProblem) -> float:
    """Least eq. (3) over every combination of options, one QP each, by another solver (PIQP)."""
    pivots_only = replace(problem, linear=np.zeros(problem.size))
    best = np.inf
    for choice in product(*(np.flatnonzero(row) for row in problem.separations.possible)):
        z = polish(pivots_only, choice)
        if z is not None:
            best = min(best, pivots_only.objective(z))
    return best


def cost(problem: CorridorProblem, z: np.ndarray) -> float:
    """Eq. (3) at z."""
    return float(problem.quadratic @ (z - problem.reference) ** 2)


@pytest.mark.parametrize("seed", [1, 4, 6])
def test_the_tree_finds_what_brute_force_finds(seed: int, crossing: Callable[..., Any]) -> None:
    problem = crossing(seed, vehicles=2, units=3).problem()
    assert 0 < len(problem.separations) <= 4
    found = search(problem, 4000)
    exact = brute_force(problem)
    assert found.exhausted
    if found.z is None:
        assert exact == np.inf
    else:
        assert cost(problem, found.z) == pytest.approx(exact, abs=1e-5, rel=2e-4)


def test_vehicles_that_never_meet_are_planned_apart(
    crossing: Callable[..., Any], transformed: Callable[..., Any]
) -> None:
    near = crossing(2, vehicles=2)
    far = transformed(near, 1, (60.0, 20.0), {"1": "3", "2": "4"})
    participants = (*near.scenario.participants, *far.scenario.participants)
    both = replace(
        near,
        scenario=replace(near.scenario, participants=participants),
        guidance=(*near.guidance, *far.guidance),
    )
    apart = [search(case.problem(), 1000) for case in (near, far)]
    together = search(both.problem(), 1000)
    assert all(len(group) <= 2 for group in together.groups)
    assert together.exhausted
    assert together.z is not None
    alone = sum(
        cost(case.problem(), o.z) for case, o in zip((near, far), apart, strict=True) if o.z is not None
    )
    assert cost(both.problem(), together.z) == pytest.approx(alone, rel=1e-6)


def test_a_guidance_without_conflict_takes_a_node_a_vehicle(crossing: Callable[..., Any]) -> None:
    case = crossing(0, vehicles=1)
    found = search(case.problem(), 10)
    assert (found.nodes, found.exhausted, found.groups) == (1, True, (("1",),))


@pytest.mark.parametrize("budget", [1, 5, 20, 60, 200])
def test_the_budget_holds_and_a_larger_one_is_never_worse(budget: int, crossing: Callable[..., Any]) -> None:
    problem = crossing(5, vehicles=4, units=5).problem()
    small, large = search(problem, budget), search(problem, 1500)
    # A node in work opens at most four children before the budget is looked at again; vehicles that join
    # in turn have nodes of their own.
    assert bool(small.in_turn) == (budget < 200)
    assert small.nodes <= budget + 4 + len(problem.blocks) + 200 * len(small.in_turn)
    assert large.z is not None
    if small.z is not None:
        assert cost(problem, large.z) <= cost(problem, small.z) * (1.0 + 1e-3)


@pytest.mark.parametrize("seed", [2, 5, 9])
def test_a_budget_that_does_not_suffice_proves_no_more_than_is_true(
    seed: int, crossing: Callable[..., Any]
) -> None:
    problem = crossing(seed, vehicles=3, units=4).problem()
    whole = search(problem, 4000)
    assert whole.exhausted
    assert whole.z is not None
    least, spent = cost(problem, whole.z), 0
    assert whole.bound == pytest.approx(least, rel=1e-3, abs=1e-9)
    for budget in (1, 3, 8, 20, 50):
        found = search(problem, budget)
        assert found.bound <= least * (1.0 + 1e-3) + 1e-9
        if found.exhausted:
            assert found.z is not None
            assert cost(problem, found.z) == pytest.approx(least, rel=1e-3)
        spent += not found.exhausted
    assert spent > 0  # else no budget was too small


@pytest.mark.parametrize("seed", [2, 5, 9])
def test_a_solution_keeps_every_gap_to_a_hundredth_of_a_millimetre(
    seed: int, crossing: Callable[..., Any]
) -> None:
    problem = crossing(seed, vehicles=3, units=4).problem()
    alone = problem.separations.slack(problem.least_cubes(np.array(problem.reference))).max(axis=1)
    assert alone.min() < -0.1  # by their guidance alone they meet
    found = search(problem, 4000)
    assert found.z is not None
    assert problem.separations.slack(found.z).max(axis=1).min() >= -1e-5


def test_a_found_solution_has_no_conflict_among_obstacles(crossing: Callable[..., Any]) -> None:
    problem = crossing(3, vehicles=3, units=5, obstacle=True).problem()
    found = search(problem, 1500)
    assert found.z is not None
    assert problem.separations.slack(found.z).max(axis=1).min() >= -1e-5


def test_the_same_problem_takes_the_same_nodes(crossing: Callable[..., Any]) -> None:
    first, second = (search(crossing(7, vehicles=4, units=5).problem(), 600) for _ in range(2))
    assert first.nodes == second.nodes
    assert first.groups == second.groups
    if first.z is not None:
        assert second.z is not None
        assert first.z.tobytes() == second.z.tobytes()
