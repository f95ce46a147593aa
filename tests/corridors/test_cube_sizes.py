"""Stage B: the options of the largest cubes about fixed pivotal points, against trying all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors import cbc
from istc_replay.corridors.cube_sizes import SizeProblem, size_problem
from istc_replay.corridors.groups import search
from istc_replay.corridors.polish import polish
from istc_replay.corridors.problem import CorridorProblem, IntArray
from istc_replay.datatypes import FloatArray, SolveStatus

CHOICES_MAX = 64


def pinned(problem: CorridorProblem, z: FloatArray) -> CorridorProblem:
    """The problem with its pivotal points at z, and no separations that this decides."""
    lower, upper = np.array(problem.lower), np.array(problem.upper)
    pivots = problem.pivot_indices
    lower[pivots], upper[pivots] = z[pivots] - 1e-7, z[pivots] + 1e-7
    return replace(problem, lower=lower, upper=upper)


def settled(sizes: SizeProblem) -> IntArray:
    """The options of the MILP where some are open, else what is known."""
    if len(sizes.open):
        model = sizes.milp()
        assert (
            cbc.solve(model, gap=0.0, node_budget=1000, emergency_stop_s=10.0).status is SolveStatus.OPTIMAL
        )
        sizes.settle(model)
    assert not len(sizes.open)
    return sizes.choice


@pytest.mark.parametrize("seed", range(12))
def test_no_other_options_give_larger_cubes(seed: int, crossing: Callable[..., Any]) -> None:
    problem = crossing(seed, vehicles=3, units=3, obstacle=True).problem()
    found = search(problem, 1500)
    assert found.z is not None
    by_trial, by_milp = size_problem(problem, found.z), size_problem(problem, found.z)
    by_trial.settle_small()
    fixed = pinned(problem, found.z)
    sized = [polish(fixed, settled(sizes)) for sizes in (by_trial, by_milp)]
    # Of options that least cubes do not meet, none can hold.
    met = problem.separations.slack(problem.least_cubes(found.z)) > -1e-6
    some = [np.flatnonzero(row) for row in met]
    assert np.prod([len(options) for options in some]) <= CHOICES_MAX
    tried = [polish(fixed, options) for options in product(*some)]
    best = min(fixed.objective(other) for other in tried if other is not None)
    for z in sized:
        assert z is not None
        assert fixed.objective(z) == pytest.approx(best, abs=1e-3)


def test_what_is_open_shares_no_wall_with_what_is_not(intersection: Callable[..., Any]) -> None:
    problem = intersection("intersection_turn_first").problem()
    found = search(problem, 1500)
    assert found.z is not None
    sizes = size_problem(problem, found.z)
    assert 0 < len(sizes.open) < len(problem.separations)
    assert (sizes.left.possible.sum(axis=1) > 1).any()
    walls = set(sizes.milp().z)
    table = problem.separations
    farthest = np.where(problem.linear > 0.0, sizes.lower, sizes.upper)
    for d in np.setdiff1d(np.arange(len(table)), sizes.open).tolist():
        option = sizes.choice[d]
        if table.slack(farthest)[d, option] < -1e-6:
            assert not walls & {int(table.larger[d, option]), int(table.smaller[d, option])}
