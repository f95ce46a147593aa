"""Quadratic programmes that lead to a solution, held to IPOPT from the first guess alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from istc_replay.bench import recorded_log
from istc_replay.config import Config, TrajectoriesConfig
from istc_replay.coordinate import Planners, plan_part
from istc_replay.datatypes import Scenario, SolveStatus
from istc_replay.samples.scenes import find_sample
from istc_replay.trajectories.knots import KnotNlp
from istc_replay.trajectories.plan import TrajectoryOutcome, TrajectoryPlanner
from istc_replay.windows import log_parts

from ..support import courses

LED, ALONE = TrajectoriesConfig(), TrajectoriesConfig(quadratic_passes=0)


class BothWays(TrajectoryPlanner):
    """Plans with quadratic programmes and without, and keeps both."""

    def __init__(self, unit_s: float, kept: list[tuple[TrajectoryOutcome, TrajectoryOutcome]]) -> None:
        super().__init__(LED, unit_s)
        self._alone, self._kept = TrajectoryPlanner(ALONE, unit_s), kept

    def plan(self, *given: Any) -> TrajectoryOutcome:
        led = super().plan(*given)
        self._kept.append((led, self._alone.plan(*given)))
        return led


class PlannersBothWays(Planners):
    """Such planners for a replay."""

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.kept: list[tuple[TrajectoryOutcome, TrajectoryOutcome]] = []

    def of(self, scenario: Scenario) -> TrajectoryPlanner:
        return BothWays(scenario.window.unit_s, self.kept)


def random_course(seed: int, wander_m: float = 0.0) -> Any:
    """A bend of random curvature and speed in cubes of random width, its pivotal points off the path.

    With `wander_m`, cubes go with pivotal points that wander away from it, so that not all can be driven.
    """
    random = np.random.default_rng(seed)
    bends, phase = random.uniform(-0.1, 0.1, 2), random.uniform(0.0, 6.0)
    slower, unit_s = random.uniform(0.0, 2.0), float(random.choice([0.5, 1.0]))
    pivots, headings = courses.driven_path(
        lambda t: bends[0] * np.sin(0.7 * t) + bends[1] * np.sin(0.4 * t + phase) * np.tanh(t),
        lambda t: 5.0 - slower * np.sin(0.3 * t),
        8,
        unit_s,
    )
    pivots[1:] += np.cumsum(random.normal(0.0, 1.0, (8, 2)), axis=0) * wander_m
    course = courses.course_along(pivots, headings, 5.0, room_m=random.uniform(0.0, 1.0), unit_s=unit_s)
    course.pivots[1:] += random.normal(0.0, 0.2, (8, 2))
    return course


@pytest.mark.parametrize("seed", range(12))
def test_random_corridors_are_driven_as_by_ipopt_alone(seed: int) -> None:
    course = random_course(seed)
    led, alone = courses.plan(course, LED), courses.plan(course, ALONE)
    assert led.undrivable is None
    assert led.trajectory.cost == pytest.approx(alone.trajectory.cost, rel=1e-4, abs=1e-4)
    assert led.trajectory.states == pytest.approx(alone.trajectory.states, abs=0.02)
    assert sum(r.iterations for r in led.records) < 0.5 * sum(r.iterations for r in alone.records)


def test_walls_that_the_soft_twin_keeps_at_the_knots_are_moved_until_they_hold_between_them() -> None:
    course = random_course(85, wander_m=0.8)
    outcome = courses.plan(course, LED)
    assert [r.stage for r in outcome.records] == ["nlp", "soft", "nlp", "nlp"]
    assert outcome.records[0].status is SolveStatus.INFEASIBLE
    assert courses.least_margin_m(outcome.trajectory, course) > -1e-6
    assert outcome.trajectory.cost <= courses.planned(course, ALONE).cost * 1.001


@pytest.mark.slow
def test_whom_ipopt_alone_can_drive_quadratic_programmes_lead_too() -> None:
    planners = {
        (config.quadratic_passes, unit_s): TrajectoryPlanner(config, unit_s)
        for config in (LED, ALONE)
        for unit_s in (0.5, 1.0)
    }
    driven, costs = [], []
    for seed in range(120):
        course = random_course(seed, wander_m=0.8)
        pair = [
            courses.plan(course, config, planners[config.quadratic_passes, course.unit_s]).trajectory
            for config in (LED, ALONE)
        ]
        driven.append([found is not None for found in pair])
        if all(driven[-1]):
            costs.append([found.cost for found in pair])
    led, alone = np.array(driven).T
    assert (led >= alone).all()
    assert 3 < (~alone).sum() < 60
    # Optima are local: a few differ, to either side.
    ratios = np.divide(*np.array(costs).T)
    assert np.quantile(abs(ratios - 1.0), 0.9) < 1e-4
    assert np.mean(ratios) < 1.01


@pytest.mark.parametrize("name", ["intersection_turn_first", "dense_4", "dense_4_obstacles"])
def test_a_scenes_vehicles_are_driven_as_by_ipopt_alone(name: str) -> None:
    config = Config()
    fast = config.model_copy(update={"corridors": config.corridors.model_copy(update={"mode": "fast"})})
    planners = PlannersBothWays(fast)
    plan_part(next(iter(log_parts(recorded_log(find_sample(name).record()), fast))), fast, planners)
    assert len(planners.kept) >= 3
    led, alone = (np.array([pair[i].trajectory.cost for pair in planners.kept]) for i in (0, 1))
    assert led == pytest.approx(alone, rel=1e-3)
    assert led.sum() <= alone.sum() * (1 + 1e-5)


def test_where_no_quadratic_programme_is_solved_ipopt_starts_from_the_guess_if_it_is_to_insist(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    led = courses.planned(courses.s_bend())
    monkeypatch.setattr(KnotNlp, "_approached", lambda *_, **__: None)
    outcome = courses.plan(courses.s_bend())
    # The soft twin insists, and what it finds is a guess to insist on.
    assert [(r.stage, r.status) for r in outcome.records] == [
        ("nlp", SolveStatus.INFEASIBLE),
        ("soft", SolveStatus.OPTIMAL),
        ("nlp", SolveStatus.OPTIMAL),
    ]
    assert outcome.records[0].detail == "Linearisation_Infeasible"
    assert outcome.records[0].iterations == 0
    assert outcome.trajectory.cost == pytest.approx(led.cost, rel=1e-4)


def test_a_corridor_that_the_soft_twin_can_keep_keeps_its_margin(monkeypatch: pytest.MonkeyPatch) -> None:
    course = courses.s_bend(radius_m=8.0, room_m=0.5)
    course.pivots[1:] += [0.0, 0.8]
    direct = courses.planned(course)
    monkeypatch.setattr(KnotNlp, "_approached", lambda *_, **__: None)
    by_twin = courses.planned(course)
    margin = TrajectoriesConfig().margin_m
    assert courses.least_margin_m(by_twin, course) == pytest.approx(
        courses.least_margin_m(direct, course), abs=1e-3
    )
    assert by_twin.cost == pytest.approx(direct.cost, rel=1e-3)
    assert courses.least_margin_m(by_twin, course) < 2 * margin  # a wall binds
