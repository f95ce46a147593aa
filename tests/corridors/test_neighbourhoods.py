"""Plans improved, and put together, by few vehicles at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors.groups import search
from istc_replay.corridors.neighbourhoods import improve, join
from istc_replay.corridors.pivot_qp import PivotQp
from istc_replay.corridors.problem import CorridorProblem


def alone(problem: CorridorProblem) -> np.ndarray:
    """Each vehicle's own optimum, whatever the others do."""
    qp = PivotQp(problem)
    root = qp.root(tuple(range(len(problem.blocks))), ())
    assert root is not None
    return problem.least_cubes(qp.z(root))


def conflict(problem: CorridorProblem, z: np.ndarray) -> float:
    """Largest overlap that is left [m]."""
    return float(-problem.separations.slack(z).max(axis=1).min())


@pytest.mark.parametrize("seed", [2, 3, 5, 7])
def test_vehicles_that_join_one_by_one_have_no_conflict(seed: int, crossing: Callable[..., Any]) -> None:
    problem = crossing(seed, vehicles=4, units=6).problem()
    assert conflict(problem, alone(problem)) > 0.1
    joined, nodes, left = join(problem, alone(problem), [0, 1, 2, 3])
    assert joined is not None
    assert left == ()
    assert nodes >= 4
    assert conflict(problem, joined) <= 1e-5
    rows = problem.rows
    value = rows.value(joined)
    assert np.all(value >= rows.lower - 1e-6)
    assert np.all(value <= rows.upper + 1e-6)


@pytest.mark.parametrize("seed", [2, 5])
def test_neighbourhoods_bring_a_plan_to_within_a_tenth_of_the_optimum(
    seed: int, crossing: Callable[..., Any]
) -> None:
    problem = crossing(seed, vehicles=4, units=6).problem()
    best = search(problem, 8000)
    assert best.exhausted
    assert best.z is not None
    joined, _, _ = join(problem, alone(problem), [3, 2, 1, 0])
    assert joined is not None
    improved, _ = improve(problem, joined, 2000)
    assert conflict(problem, improved) <= 1e-5
    optimum = problem.reference_cost(best.z)
    assert (
        optimum * (1 - 1e-3)
        <= problem.reference_cost(improved)
        <= problem.reference_cost(joined) * (1 + 1e-9)
    )
    assert problem.reference_cost(improved) <= 1.1 * optimum + 1e-6


@pytest.mark.parametrize("together", [1, 2])
@pytest.mark.parametrize("seed", [2, 5, 7])
def test_two_vehicles_beside_all_others_make_a_plan_better_and_leave_no_conflict(
    seed: int, together: int, crossing: Callable[..., Any]
) -> None:
    problem = crossing(seed, vehicles=4, units=6).problem()
    joined, _, _ = join(problem, alone(problem), [3, 2, 1, 0])
    assert joined is not None
    improved, nodes = improve(problem, joined, 300, together)
    assert nodes <= 300 + 120
    assert conflict(problem, improved) <= 1e-5
    assert problem.reference_cost(improved) < problem.reference_cost(joined)


def test_an_optimum_is_left_as_it_is(crossing: Callable[..., Any]) -> None:
    problem = crossing(2, vehicles=3, units=5).problem()
    best = search(problem, 8000)
    assert best.exhausted
    assert best.z is not None
    again, _ = improve(problem, best.z, 500)
    assert problem.reference_cost(again) == pytest.approx(problem.reference_cost(best.z), rel=2e-4)


@pytest.mark.parametrize(("nodes", "together"), [(1000, 2), (3, 8), (1, 4)])
def test_a_group_past_the_budget_is_solved_one_against_the_other(
    nodes: int, together: int, crossing: Callable[..., Any]
) -> None:
    problem = crossing(5, vehicles=5, units=6).problem()
    found = search(problem, nodes, together)
    assert found.z is not None
    assert not found.exhausted
    assert len(found.in_turn) > together or nodes < 5
    assert conflict(problem, found.z) <= 1e-5
    assert found.bound <= problem.reference_cost(found.z)
    jointly = search(problem, 8000)
    assert jointly.in_turn == ()
    assert jointly.bound <= problem.reference_cost(found.z) * (1 + 1e-6)


def test_who_finds_no_place_beside_others_is_named_with_one_in_its_way(crossing: Callable[..., Any]) -> None:
    problem = crossing(5, vehicles=4, units=6).problem()
    table = problem.separations
    # Vehicle 2 and 3 cannot be separated in one unit; all others can.
    (blocked,) = np.flatnonzero((table.first == 2) & (table.second == 3) & ~table.obstacle)[:1]
    gap = table.gap.copy()
    gap[blocked] = np.inf
    hopeless = replace(problem, separations=replace(table, gap=gap))
    joined, _, left = join(hopeless, alone(problem), [0, 1, 2, 3])
    assert joined is None
    assert [names for _, names in left] == [("3", "4")]
    found = search(hopeless, 1, 2)
    assert (found.z, found.culprits) == (None, (("3", "4"),))
