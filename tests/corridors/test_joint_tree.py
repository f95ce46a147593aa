"""The tree of eq. (4): against brute force and CBC's full MIQP, its bound, its budget, its parts."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors.groups import search
from istc_replay.corridors.joint_tree import prove
from istc_replay.corridors.polish import polish
from istc_replay.corridors.problem import CorridorProblem


def any_solution(problem: CorridorProblem) -> np.ndarray:
    """A solution that is not the best: least cubes about the conflict tree's points."""
    found = search(problem, 4000)
    assert found.z is not None
    return found.z


@pytest.mark.parametrize("seed", [1, 4, 6])
def test_the_joint_tree_finds_and_bounds_what_brute_force_finds(
    seed: int, crossing: Callable[..., Any]
) -> None:
    problem = crossing(seed, vehicles=2, units=3).problem()
    choices = product(*(np.flatnonzero(row) for row in problem.separations.possible))
    exact = min(problem.objective(z) for z in (polish(problem, c) for c in choices) if z is not None)
    found = prove(problem, any_solution(problem), 1e-5, 4000, 1000)
    assert found.z is not None
    assert problem.objective(found.z) == pytest.approx(exact, rel=1e-5, abs=1e-5)
    assert exact - 3e-5 * max(1.0, abs(exact)) <= found.bound <= exact


@pytest.mark.parametrize("budget", [(0, 0), (1, 0), (20, 1), (100, 5), (400, 40)])
def test_whatever_the_budget_the_bound_is_below_the_optimum(
    budget: tuple[int, int], crossing: Callable[..., Any]
) -> None:
    problem = crossing(5, vehicles=4, units=5).problem()
    z = any_solution(problem)
    closed = prove(problem, z, 1e-4, 20_000, 5000)
    assert closed.z is not None
    optimum = problem.objective(closed.z)
    assert closed.bound >= optimum - 2e-4 * max(1.0, abs(optimum))
    found = prove(problem, z, 1e-4, *budget)
    assert found.bound <= optimum
    assert found.nodes <= budget[0] + 1
    assert found.joint_qps <= budget[1] + 2 * len(problem.blocks)


def test_more_nodes_never_lower_the_bound(crossing: Callable[..., Any]) -> None:
    problem = crossing(5, vehicles=4, units=5).problem()
    z = any_solution(problem)
    bounds = [prove(problem, z, 1e-4, 10 * budget, budget).bound for budget in (1, 4, 16, 64)]
    assert all(later >= former - 1e-3 for former, later in pairwise(bounds))
    assert bounds[-1] > bounds[0]


def test_a_better_solution_has_no_conflict(crossing: Callable[..., Any]) -> None:
    problem = crossing(3, vehicles=3, units=5, obstacle=True).problem()
    z = any_solution(problem)
    found = prove(problem, z, 1e-4, 4000, 500)
    assert found.z is not None
    assert problem.objective(found.z) < problem.objective(z)
    assert problem.separations.slack(found.z).max(axis=1).min() >= -1e-5


@pytest.mark.parametrize("seed", [2, 5])
def test_parts_bound_the_whole(seed: int, crossing: Callable[..., Any]) -> None:
    problem = crossing(seed, vehicles=4, units=5).problem()
    z = any_solution(problem)
    whole = prove(problem, z, 1e-4, 20_000, 5000)
    assert whole.z is not None
    optimum = problem.objective(whole.z)
    parts = prove(problem, z, 1e-4, 20_000, 5000, together=2)
    assert parts.z is None
    relaxed = polish(problem, None)
    assert relaxed is not None
    assert problem.objective(relaxed) <= parts.bound <= optimum
