"""Choices that contradict each other are mended, or what is missed is told."""

from __future__ import annotations

from typing import Any

import numpy as np

from istc_replay.config import Config
from istc_replay.corridors.formulation import build_problem, default_limits
from istc_replay.corridors.problem import CorridorProblem
from istc_replay.corridors.seed.mending import mended

WALL = ((-2.0, 2.0, -3.0, 12.0),)


def problem_of(made: Any) -> CorridorProblem:
    scenario, guidance, _ = made
    config = Config().corridors
    limits = {p.vehicle_id: default_limits(config) for p in scenario.participants}
    return build_problem(scenario, guidance, config, limits, 10.0)


def test_a_choice_that_can_be_mended_keeps_every_separation(meeting: Any) -> None:
    problem = problem_of(meeting([(-15.0, 0.0, 0.0), (0.0, -15.0, np.pi / 2)]))
    found = mended(problem, problem.least_cubes(problem.reference))
    assert found.z is not None
    assert not found.missed_m
    assert problem.separations.slack(found.z).max(axis=1).min() >= -1e-6


def test_a_wall_that_is_driven_into_is_told_with_how_much_is_missed(meeting: Any) -> None:
    problem = problem_of(meeting([(-15.0, 0.0, 0.0)], WALL))
    # The points pass through the wall: half of the units are chosen before it, the others behind it.
    found = mended(problem, problem.least_cubes(problem.reference))
    assert found.z is None
    assert found.missed_m
    for number, missed in found.missed_m.items():
        assert problem.pair(number) == ("1", "block 1")
        assert missed > 0.1
