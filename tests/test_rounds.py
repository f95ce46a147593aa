"""The hardest scenes take one round of both layers."""

from __future__ import annotations

import pytest

from istc_replay.bench import recorded_log
from istc_replay.samples.scenes import find_sample

from .support.planning import planned


@pytest.mark.parametrize(
    "name",
    [
        "dense_6_row",
        *(pytest.param(f"dense_{scene}", marks=pytest.mark.slow) for scene in ("8_obstacles", "8_row", "12")),
    ],
)
def test_everybody_is_driven_to_its_goal_in_the_first_round(name: str) -> None:
    plan = planned(recorded_log(find_sample(name).record()))
    assert len(plan.trajectories) == len(plan.scenario.participants)
    assert not plan.late
    assert plan.rounds == 1


@pytest.mark.slow
def test_who_layer_2_would_leave_beside_its_goal_is_planned_into_a_cube_about_it() -> None:
    plan = planned(recorded_log(find_sample("dense_12").record()))
    assert plan.corridors is not None
    assert plan.corridors.found_by == "goals held"
    solved = [record.vehicle_id for record in plan.records if record.stage == "nlp"]
    twice = {vehicle for vehicle in solved if solved.count(vehicle) > 1}
    assert twice
    assert not plan.late
