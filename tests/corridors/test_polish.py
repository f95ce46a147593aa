"""Stage C with far separations left out, beside the QP of all of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors import polish as module
from istc_replay.corridors.groups import search
from istc_replay.corridors.polish import polish, polish_about
from istc_replay.corridors.problem import CorridorProblem
from istc_replay.datatypes import FloatArray


def planned(problem: CorridorProblem) -> FloatArray:
    """A solution with least cubes."""
    found = search(problem, 1500)
    assert found.z is not None
    return found.z


@pytest.mark.parametrize("near_m", [0.0, 0.5, 10.0])
@pytest.mark.parametrize("seed", [2, 3, 7])
def test_leaving_far_separations_out_changes_nothing(
    seed: int, near_m: float, crossing: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = crossing(seed, vehicles=3, units=5, obstacle=True).problem()
    z = planned(problem)
    of_all = polish(problem, problem.separations.best(z))
    assert of_all is not None
    monkeypatch.setattr(module, "_NEAR_M", near_m)
    found = polish_about(problem, z)
    assert found is not None
    assert problem.objective(found) == pytest.approx(problem.objective(of_all), rel=1e-7)
    assert problem.separations.slack(found).max(axis=1).min() >= -module.FEASIBLE_M


def test_options_that_contradict_each_other_have_no_solution(crossing: Callable[..., Any]) -> None:
    problem = crossing(2, vehicles=2, units=5).problem()
    z = planned(problem)
    table = problem.separations
    pair = np.flatnonzero(~table.obstacle)
    # In turn to the left and to the right of each other, a unit apart: nobody is that quick.
    choice = np.array(table.best(z))
    turns = np.arange(len(pair)) % 2
    choice[pair] = np.where(table.possible[pair, turns], turns, choice[pair])
    assert len(set(choice[pair])) > 1
    assert polish(problem, choice) is None
    assert polish_about(problem, z, choice) is None
