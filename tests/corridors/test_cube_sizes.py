"""Stage B: the options of the largest cubes about fixed pivotal points, against trying all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors import cbc
from istc_replay.corridors.groups import search
from istc_replay.corridors.miqp import build_size_milp
from istc_replay.corridors.polish import polish
from istc_replay.corridors.problem import CorridorProblem
from istc_replay.datatypes import FloatArray

CHOICES_MAX = 64


def pinned(problem: CorridorProblem, z: FloatArray) -> CorridorProblem:
    """The problem with its pivotal points at z, and no separations that this decides."""
    lower, upper = np.array(problem.lower), np.array(problem.upper)
    pivots = problem.pivot_indices
    lower[pivots], upper[pivots] = z[pivots] - 1e-7, z[pivots] + 1e-7
    return replace(problem, lower=lower, upper=upper)


@pytest.mark.parametrize("seed", range(12))
def test_no_other_options_give_larger_cubes(seed: int, crossing: Callable[..., Any]) -> None:
    problem = crossing(seed, vehicles=3, units=3, obstacle=True).problem()
    found = search(problem, 1500)
    if found.z is None:
        pytest.skip("this one has no solution")
    sizes = build_size_milp(problem, found.z)
    choice = sizes.choice
    if sizes.model is not None:
        cbc.solve(sizes.model, gap=0.0, node_budget=1000, emergency_stop_s=10.0)
        choice = sizes.chosen()
    fixed = pinned(problem, found.z)
    z = polish(fixed, choice)
    assert z is not None
    # Of options that least cubes do not meet, none can hold.
    met = problem.separations.slack(problem.least_cubes(found.z)) > -1e-6
    some = [np.flatnonzero(row) for row in met]
    if np.prod([len(options) for options in some]) > CHOICES_MAX:
        pytest.skip("too many to try")
    tried = [polish(fixed, options) for options in product(*some)]
    best = min(fixed.objective(other) for other in tried if other is not None)
    assert fixed.objective(z) == pytest.approx(best, abs=1e-3)


def test_the_model_holds_what_is_tied_to_a_choice_alone(intersection: Callable[..., Any]) -> None:
    problem = intersection("intersection_turn_first").problem()
    found = search(problem, 1500)
    assert found.z is not None
    sizes = build_size_milp(problem, found.z)
    assert sizes.model is not None
    assert 0 < len(sizes.open) < len(problem.separations)
    assert (sizes.left.possible.sum(axis=1) > 1).any()
    # Walls of the model belong to no separation outside of it.
    walls = set(sizes.model.z)
    others = np.setdiff1d(np.arange(len(problem.separations)), sizes.open)
    table = problem.separations
    tied = [
        walls & {int(table.larger[d, o]), int(table.smaller[d, o])}
        for d, o in zip(others, sizes.choice[others], strict=True)
    ]
    slack = table.slack(sizes.grown)[others, sizes.choice[others]]
    assert not any(t for t, missed in zip(tied, slack < -1e-6, strict=True) if missed)
