"""Crowded scenes from seeds: everybody arrives, nobody meets, and it repeats."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from istc_replay.bench import recorded_log
from istc_replay.config import Config
from istc_replay.coordinate import Planners, plan_part
from istc_replay.corridors.formulation import default_limits
from istc_replay.corridors.seed.seeding import make_lattices
from istc_replay.corridors.seeded import Seeds
from istc_replay.corridors.solve import find_corridors, solve_corridors
from istc_replay.datatypes import Corridors, Guidance, Scenario, SolveStatus, WindowPlan
from istc_replay.guidance.build import build_guidance
from istc_replay.samples.scenes import find_sample
from istc_replay.scenario import build_scenario
from istc_replay.windows import CROWDED_UNIT_S, log_parts

Case = tuple[Scenario, tuple[Guidance, ...], Config]


@pytest.fixture(scope="module")
def among_obstacles() -> Case:
    """Four vehicles among two blocks, fast mode, in the units of seeds."""
    config = Config()
    config = config.model_copy(update={"corridors": config.corridors.model_copy(update={"mode": "fast"})})
    log = recorded_log(find_sample("dense_4_obstacles").record())
    scenario = build_scenario(next(iter(log_parts(log, config))), config, CROWDED_UNIT_S)
    return scenario, build_guidance(scenario, config.guidance), config


def solved(case: Case, **changes: object) -> Corridors:
    scenario, guidance, config = case
    settings = config.corridors.model_copy(update=changes)
    limits = {p.vehicle_id: default_limits(settings) for p in scenario.participants}
    return solve_corridors(scenario, guidance, settings, limits, 10.0)


def planned_stages(**corridors: object) -> tuple[WindowPlan, list[str]]:
    """The plan of four vehicles among two blocks, and the stages of layer 1 that led to it."""
    config = Config.model_validate({"corridors": {"mode": "fast"} | corridors})
    log = recorded_log(find_sample("dense_4_obstacles").record())
    plan = plan_part(next(iter(log_parts(log, config))), config, Planners(config))
    return plan, [record.stage for record in plan.records if record.layer == "corridors"]


def test_a_small_crowd_is_planned_by_the_conflict_tree_where_that_closes() -> None:
    plan, stages = planned_stages()
    assert plan.scenario.small_crowd
    assert plan.scenario.window.unit_s == 0.75
    assert len(plan.trajectories) == 4
    assert not plan.reason
    assert stages == ["conflict tree", "cube sizes", "joint polish", "relaxation"]


def test_a_small_crowd_that_the_tree_does_not_hold_is_planned_from_seeds_in_shorter_units() -> None:
    plan, stages = planned_stages(small_crowd_node_budget=20)
    assert plan.scenario.window.unit_s == 0.5
    assert len(plan.trajectories) == 4
    assert "seed paths" in stages
    assert "conflict tree" not in stages


def test_everybody_is_at_the_goal_and_no_two_cubes_meet(among_obstacles: Case) -> None:
    found = solved(among_obstacles)
    assert found.status is SolveStatus.FEASIBLE
    assert len(found.frames) == 4
    for corridor, guide in zip(found.corridors, among_obstacles[1], strict=True):
        assert np.hypot(*(corridor.pivots_m[-1] - guide.points_m[-1])) < 0.3
    for first, second in combinations(found.corridors, 2):
        a, b = first.cubes_m, second.cubes_m
        apart = np.stack([a[:, 0] - b[:, 1], b[:, 0] - a[:, 1], a[:, 2] - b[:, 3], b[:, 2] - a[:, 3]])
        assert apart.max(axis=0).min() >= 0.3 - 1e-5
    for corridor in found.corridors:
        for obstacle in among_obstacles[0].obstacles:
            a, b = corridor.cubes_m, obstacle.boxes_m
            apart = np.stack([a[:, 0] - b[:, 1], b[:, 0] - a[:, 1], a[:, 2] - b[:, 3], b[:, 2] - a[:, 3]])
            assert apart.max(axis=0).min() >= 0.2 - 1e-5


def test_the_same_scene_gives_the_same_corridors_bit_for_bit(among_obstacles: Case) -> None:
    first, second = (solved(among_obstacles, seed_improvements=2) for _ in range(2))
    for a, b in zip(first.corridors, second.corridors, strict=True):
        assert a.cubes_m.tobytes() == b.cubes_m.tobytes()


def test_a_conflict_that_is_left_is_named_with_its_unit(among_obstacles: Case) -> None:
    found = solved(among_obstacles, vehicle_gap_m=7.0, seeds=1, seed_rounds=2)
    assert found.status is SolveStatus.LIMIT
    assert found.reason.startswith("conflict left: ")
    assert " in time unit " in found.reason
    assert found.culprits


def test_who_cannot_be_driven_moves_otherwise_in_the_next_attempt(among_obstacles: Case) -> None:
    scenario, guidance, config = among_obstacles
    limits = {p.vehicle_id: default_limits(config.corridors) for p in scenario.participants}
    seeds = Seeds()
    first, _ = find_corridors(scenario, guidance, config.corridors, limits, 10.0, seeds)
    assert first.corridors
    assert seeds.grown is not None
    before, number = seeds.grown.repair.motions[0], seeds.grown.repair.seed
    seeds.again([(0, 6)])
    second, _ = find_corridors(scenario, guidance, config.corridors, limits, 10.0, seeds)
    assert second.corridors
    after = seeds.grown.repair.motions[0]
    assert seeds.grown.repair.seed == number
    assert (after.path, after.places[6:8].tolist()) != (before.path, before.places[6:8].tolist())


def test_seeds_are_planted_along_other_routes_too(among_obstacles: Case) -> None:
    scenario, guidance, config = among_obstacles
    assert any(guide.others for guide in guidance)
    alone = make_lattices(scenario, [replace(guide, others=()) for guide in guidance], config.corridors)
    both = make_lattices(scenario, guidance, config.corridors)
    assert sum(len(lattice.paths) for lattice in both) > sum(len(lattice.paths) for lattice in alone)


def test_pivotal_points_are_no_faster_than_the_bends_of_a_seed_allow(among_obstacles: Case) -> None:
    found = solved(among_obstacles)
    tight = 0
    for corridor, frame in zip(found.corridors, found.frames, strict=True):
        assert frame.fastest_mps is not None
        steps_m, own_m = (
            np.hypot(*np.diff(points, axis=0).T) for points in (corridor.pivots_m, frame.points_m)
        )
        # The step along the frame's own is bounded; a cone of 0.4 beside it makes it a little longer.
        most_m = np.maximum(frame.fastest_mps * CROWDED_UNIT_S, own_m) * np.hypot(1.0, 0.4)
        assert (steps_m[1:] <= most_m[1:] + 1e-6).all()
        tight += int((frame.fastest_mps < 5.0).sum())
    assert tight
