"""The QP of the pivotal points against another solver, its prices and its ends against their definitions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors.pivot_qp import PivotQp
from istc_replay.corridors.polish import polish
from istc_replay.corridors.problem import CorridorProblem


def some_choices(problem: CorridorProblem, seed: int, count: int) -> list[tuple[int, int]]:
    """Possible options of some separations."""
    random = np.random.default_rng(seed)
    some = random.permutation(len(problem.separations))[:count]
    return [(int(d), int(random.choice(np.flatnonzero(problem.separations.possible[d])))) for d in some]


@pytest.mark.parametrize("seed", range(6))
def test_options_chosen_one_by_one_cost_what_another_solver_finds(
    seed: int, crossing: Callable[..., Any]
) -> None:
    problem = crossing(seed, vehicles=3, units=4, obstacle=True).problem()
    chosen = some_choices(problem, seed, 5)
    qp = PivotQp(problem)
    solution = qp.root((0, 1, 2), ())
    assert solution is not None
    taken = list[tuple[int, int]]()
    for choice in chosen:
        child = qp.with_option(solution, choice)
        if child is not None:
            solution, taken = child, [*taken, choice]
    # Of all separations those alone that were chosen, and no gain from size.
    table = problem.separations.taken(np.array([d for d, _ in taken], dtype=np.int64))
    alone = replace(problem, separations=table, linear=np.zeros(problem.size))
    z = polish(alone, [o for _, o in taken])
    assert z is not None
    assert solution.cost == pytest.approx(problem.reference_cost(z), abs=1e-4)
    assert problem.reference_cost(qp.z(solution)) == pytest.approx(solution.cost, abs=1e-9)
    assert sorted(solution.choices) == sorted(taken)
    scratch = qp.root((0, 1, 2), solution.choices)
    assert scratch is not None
    assert scratch.cost == pytest.approx(solution.cost, abs=1e-6)


@pytest.mark.parametrize("held", [(), (1,)])
def test_ends_tell_how_far_options_hold_with_least_cubes(
    held: tuple[int, ...], crossing: Callable[..., Any]
) -> None:
    problem = crossing(5, vehicles=3, units=5, obstacle=True).problem()
    qp = PivotQp(problem)
    around = np.random.default_rng(0).normal(0.0, 20.0, problem.size)
    free = tuple(v for v in range(3) if v not in held)
    view = qp.beside(around, free) if held else qp
    solution = view.root(free, ())
    assert solution is not None
    z = view.z(solution)
    for vehicle in held:
        pivots = problem.blocks[vehicle].pivot[1:]
        assert np.array_equal(z[pivots], around[pivots])
    plain = problem.separations.slack(problem.least_cubes(z))
    assert np.array_equal(view.ends.slack(view.points(solution)), plain)
    some = np.arange(0, len(problem.separations), 3)
    assert np.array_equal(view.ends.taken(some).slack(view.points(solution)), plain[some])


@pytest.mark.parametrize("held", [(), (1,)])
def test_an_option_costs_at_least_its_price(held: tuple[int, ...], crossing: Callable[..., Any]) -> None:
    problem = crossing(4, vehicles=2, units=5, obstacle=True).problem()
    free = tuple(v for v in range(2) if v not in held)
    qp = PivotQp(problem).beside(problem.reference, free)
    root = qp.root(free, ())
    assert root is not None
    table = problem.separations
    mine = np.flatnonzero(np.isin(table.first, free) | (np.isin(table.second, free) & ~table.obstacle))
    prices = qp.prices(mine)
    slack = qp.ends.slack(qp.points(root))[mine]
    dearer = 0
    for row, option in zip(*np.nonzero(np.isfinite(slack) & (slack < 0.0)), strict=True):
        child = qp.with_option(root, (int(mine[row]), int(option)))
        if child is not None:
            dearer += 1
            least = float(prices[row, option] * slack[row, option] ** 2)
            assert child.cost >= root.cost + least - 1e-6
    assert dearer


def test_what_nobody_free_can_change_has_no_price(crossing: Callable[..., Any]) -> None:
    problem = crossing(4, vehicles=2, units=5, obstacle=True).problem()
    qp = PivotQp(problem).beside(problem.reference, (0,))
    table = problem.separations
    theirs = np.flatnonzero(table.obstacle & (table.first == 1))
    assert len(theirs)
    assert np.isinf(qp.prices(theirs)).all()
