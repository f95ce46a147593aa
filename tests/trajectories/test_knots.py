"""Quadratic programmes that lead to a solution, held to IPOPT from the first guess alone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from istc_replay.bench import recorded_log
from istc_replay.config import Config, TrajectoriesConfig
from istc_replay.coordinate import Planners, plan_part
from istc_replay.datatypes import SolveStatus
from istc_replay.samples.scenes import find_sample
from istc_replay.trajectories.knots import KnotNlp
from istc_replay.trajectories.plan import TrajectoryOutcome, TrajectoryPlanner
from istc_replay.windows import log_parts


@contextmanager
def ipopt_alone() -> Iterator[None]:
    """No quadratic programmes: IPOPT starts from every first guess itself."""
    with pytest.MonkeyPatch.context() as patched:
        solve = KnotNlp.solve
        patched.setattr(KnotNlp, "_approached", lambda *_, **__: None)
        patched.setattr(KnotNlp, "solve", lambda self, **given: solve(self, **given | {"insist": True}))
        yield


def random_course(lab: SimpleNamespace, seed: int) -> Any:
    """A bend of random curvature and speed in cubes of random width, its pivotal points off the path."""
    random = np.random.default_rng(seed)
    bends, phase = random.uniform(-0.1, 0.1, 2), random.uniform(0.0, 6.0)
    slower, unit_s = random.uniform(0.0, 2.0), float(random.choice([0.5, 1.0]))
    pivots, headings = lab.driven_path(
        lambda t: bends[0] * np.sin(0.7 * t) + bends[1] * np.sin(0.4 * t + phase) * np.tanh(t),
        lambda t: 5.0 - slower * np.sin(0.3 * t),
        8,
        unit_s,
    )
    course = lab.course_along(pivots, headings, 5.0, room_m=random.uniform(0.0, 1.0), unit_s=unit_s)
    course.pivots[1:] += random.normal(0.0, 0.2, (8, 2))
    return course


@pytest.mark.parametrize("seed", range(12))
def test_random_corridors_are_driven_as_by_ipopt_alone(lab: SimpleNamespace, seed: int) -> None:
    course = random_course(lab, seed)
    led = lab.plan(course)
    with ipopt_alone():
        alone = lab.plan(course)
    assert led.undrivable is None
    assert led.trajectory.cost == pytest.approx(alone.trajectory.cost, rel=1e-4, abs=1e-4)
    assert led.trajectory.states == pytest.approx(alone.trajectory.states, abs=0.02)
    assert sum(r.iterations for r in led.records) < 0.5 * sum(r.iterations for r in alone.records)


@pytest.mark.parametrize("name", ["intersection_turn_first", "dense_4", "dense_4_obstacles"])
def test_a_scenes_vehicles_are_driven_as_by_ipopt_alone(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plan, pairs = TrajectoryPlanner.plan, []

    def twice(self: TrajectoryPlanner, *given: Any) -> TrajectoryOutcome:
        with ipopt_alone():
            alone = plan(self, *given)
        pairs.append((plan(self, *given), alone))
        return pairs[-1][0]

    monkeypatch.setattr(TrajectoryPlanner, "plan", twice)
    config = Config()
    fast = config.model_copy(update={"corridors": config.corridors.model_copy(update={"mode": "fast"})})
    plan_part(next(iter(log_parts(recorded_log(find_sample(name).record()), fast))), fast, Planners(fast))
    assert len(pairs) >= 3
    led, alone = (np.array([pair[i].trajectory.cost for pair in pairs]) for i in (0, 1))
    assert led == pytest.approx(alone, rel=1e-3)
    assert led.sum() <= alone.sum() * (1 + 1e-5)


def test_where_no_quadratic_programme_is_solved_ipopt_starts_from_the_guess_if_it_is_to_insist(
    lab: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    led = lab.planned(lab.s_bend())
    monkeypatch.setattr(KnotNlp, "_approached", lambda *_, **__: None)
    outcome = lab.plan(lab.s_bend())
    # The soft twin insists, and what it finds is a guess to insist on.
    assert [(r.stage, r.status) for r in outcome.records] == [
        ("nlp", SolveStatus.INFEASIBLE),
        ("soft", SolveStatus.OPTIMAL),
        ("nlp", SolveStatus.OPTIMAL),
    ]
    assert outcome.records[0].detail == "Linearisation_Infeasible"
    assert outcome.records[0].iterations == 0
    assert outcome.trajectory.cost == pytest.approx(led.cost, rel=1e-4)


def test_a_corridor_that_the_soft_twin_can_keep_keeps_its_margin(
    lab: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    course = lab.s_bend(radius_m=8.0, room_m=0.5)
    course.pivots[1:] += [0.0, 0.8]
    direct = lab.planned(course)
    monkeypatch.setattr(KnotNlp, "_approached", lambda *_, **__: None)
    by_twin = lab.planned(course)
    margin = TrajectoriesConfig().margin_m
    assert lab.least_margin_m(by_twin, course) == pytest.approx(lab.least_margin_m(direct, course), abs=1e-3)
    assert by_twin.cost == pytest.approx(direct.cost, rel=1e-3)
    assert lab.least_margin_m(by_twin, course) < 2 * margin  # a wall binds
