"""Who stops near its goal is held at the goal."""

from __future__ import annotations

from typing import Any

import numpy as np

from istc_replay.config import Config
from istc_replay.corridors.formulation import build_problem, default_limits
from istc_replay.corridors.incumbent import Search, bring_home
from istc_replay.corridors.polish import polish_about
from istc_replay.datatypes import SolveStatus


def searched(meeting: Any, beside_m: float) -> tuple[Search, Any]:
    """The plan of two that pass, whose first vehicle would rather end that far ahead of its goal."""
    scenario, guidance, _ = meeting([(-15.0, -4.0, 0.0), (15.0, 4.0, np.pi)])
    config = Config().corridors
    limits = {p.vehicle_id: default_limits(config) for p in scenario.participants}
    problem = build_problem(scenario, guidance, config, limits, 10.0)
    last = problem.blocks[0].pivot[-1]
    problem.reference.flags.writeable = True
    problem.reference[last[0]] += beside_m
    search = Search(problem)
    search.offer(polish_about(problem, problem.least_cubes(np.array(problem.reference))), "joint polish")
    return search, guidance


def away_m(search: Search, guidance: Any, vehicle: int) -> float:
    assert search.z is not None
    return float(
        np.hypot(*(search.z[search.problem.blocks[vehicle].pivot[-1]] - guidance[vehicle].points_m[-1]))
    )


def test_who_ends_beside_its_goal_is_held_there_at_a_higher_price(meeting: Any) -> None:
    search, guidance = searched(meeting, 2.0)
    before, found_by = search.objective, search.found_by
    assert away_m(search, guidance, 0) > 0.4
    bring_home(search, guidance)
    assert away_m(search, guidance, 0) < 0.3 * np.sqrt(2.0) + 1e-6
    assert search.objective > before
    assert (found_by, search.found_by) == ("joint polish", "goals held")
    values = search.problem.rows.value(search.z)
    assert (values > search.problem.rows.lower - 1e-5).all()
    assert (values < search.problem.rows.upper + 1e-5).all()


def test_who_is_at_the_goal_or_far_from_it_is_left_alone(meeting: Any) -> None:
    search, guidance = searched(meeting, 0.0)
    z = search.z
    bring_home(search, guidance)
    assert search.z is z
    assert not search.records


def test_where_the_goal_is_out_of_reach_the_plan_stays(meeting: Any) -> None:
    search, guidance = searched(meeting, 2.0)
    z, last = search.z, search.problem.blocks[0].pivot[-1]
    search.problem.lower.flags.writeable = True
    search.problem.lower[last[0]] = guidance[0].points_m[-1, 0] + 0.35  # a wall before the goal
    bring_home(search, guidance)
    assert search.z is z
    assert search.found_by == "joint polish"
    assert [record.status for record in search.records] == [SolveStatus.INFEASIBLE]
