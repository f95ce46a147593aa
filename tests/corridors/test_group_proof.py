"""Bounds by groups: against the tree of all, brute force, their budgets, and where vehicles do not meet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors.group_proof import GroupProof
from istc_replay.corridors.groups import search
from istc_replay.corridors.joint_tree import prove
from istc_replay.corridors.polish import polish
from istc_replay.corridors.problem import CorridorProblem


def any_solution(problem: CorridorProblem) -> np.ndarray:
    """A solution that is not the best: least cubes about the conflict tree's points."""
    found = search(problem, 4000)
    assert found.z is not None
    return found.z


def optimum(problem: CorridorProblem, z: np.ndarray) -> float:
    """Eq. (4) of the best solution, by the tree of all vehicles."""
    closed = prove(problem, z, 1e-4, 20_000, 5000)
    best = z if closed.z is None else closed.z
    assert closed.bound >= problem.objective(best) - 2e-4 * max(1.0, abs(problem.objective(best)))
    return problem.objective(best)


@pytest.mark.parametrize("seed", [1, 4, 6])
def test_a_pair_alone_is_bounded_by_what_brute_force_finds(seed: int, crossing: Callable[..., Any]) -> None:
    problem = crossing(seed, vehicles=2, units=3).problem()
    choices = product(*(np.flatnonzero(row) for row in problem.separations.possible))
    exact = min(problem.objective(z) for z in (polish(problem, c) for c in choices) if z is not None)
    proof = GroupProof(problem, any_solution(problem), 1e-5, 8)
    proof.run(4000)
    by_points = proof.bound
    proof.close(1000)
    assert by_points <= proof.bound <= exact + 1e-9
    assert proof.bound >= exact - 1e-4 * max(1.0, abs(exact))


@pytest.mark.parametrize("together", [2, 3, 8])
@pytest.mark.parametrize("seed", [2, 5, 9, 12])
def test_whatever_the_groups_and_the_budget_the_bound_is_below_the_optimum(
    seed: int, together: int, crossing: Callable[..., Any]
) -> None:
    problem = crossing(seed, vehicles=4, units=5, obstacle=seed % 2 == 0).problem()
    z = any_solution(problem)
    best = optimum(problem, z)
    relaxed = polish(problem, None)
    assert relaxed is not None
    for budget, joint in ((0, 0), (20, 2), (500, 50)):
        proof = GroupProof(problem, z, 1e-4, together)
        proof.run(budget)
        proof.close(joint)
        assert proof.bound <= best + 1e-6 * max(1.0, abs(best))
        assert proof.bound >= problem.objective(relaxed) - 1e-4 * abs(best) - 1e-3
        assert max(map(len, proof.trees)) <= together


def test_more_nodes_and_larger_groups_raise_the_bound(crossing: Callable[..., Any]) -> None:
    problem = crossing(5, vehicles=4, units=5).problem()
    z = any_solution(problem)
    bounds = []
    for budget, together in ((0, 2), (400, 2), (400, 3), (400, 4)):
        proof = GroupProof(problem, z, 1e-4, together)
        proof.run(budget)
        bounds.append(proof.bound)
    assert all(later >= former - 1e-3 for former, later in pairwise(bounds))
    assert bounds[-1] > bounds[0] + 1.0


def test_plans_of_groups_put_together_are_no_worse_and_have_no_conflict(
    crossing: Callable[..., Any],
) -> None:
    for seed in (2, 5, 7):
        problem = crossing(seed, vehicles=4, units=5).problem()
        z = any_solution(problem)
        proof = GroupProof(problem, z, 1e-4, 8)
        proof.run(1000)
        proof.put_together()
        assert problem.objective(proof.z) <= problem.objective(z)
        assert problem.separations.slack(proof.z).max(axis=1).min() >= -1e-5


def test_vehicles_that_never_meet_are_bounded_apart(
    crossing: Callable[..., Any], transformed: Callable[..., Any]
) -> None:
    near = crossing(2, vehicles=2)
    far = transformed(near, 1, (60.0, 20.0), {"1": "3", "2": "4"})
    both = replace(
        near,
        scenario=replace(
            near.scenario, participants=(*near.scenario.participants, *far.scenario.participants)
        ),
        guidance=(*near.guidance, *far.guidance),
    ).problem()
    proof = GroupProof(both, any_solution(both), 1e-4, 8)
    proof.run(1000)
    proof.close(1000)
    pairs = {group for group in proof.trees if len(group) > 1}
    assert pairs == {frozenset({0, 1}), frozenset({2, 3})}
    best = optimum(both, proof.z)
    assert best - 2e-3 * max(1.0, abs(best)) <= proof.bound <= best + 1e-6 * max(1.0, abs(best))


def test_the_same_problem_gives_the_same_groups_and_bound(crossing: Callable[..., Any]) -> None:
    found = []
    for _ in range(2):
        problem = crossing(7, vehicles=4, units=5).problem()
        proof = GroupProof(problem, any_solution(problem), 1e-4, 8)
        proof.run(300)
        proof.close(20)
        found.append((proof.bound, proof.nodes, proof.joint_qps, list(proof.trees), proof.z.tobytes()))
    assert found[0] == found[1]
