"""The plan before is always a plan of the next window: no window in steps is without one."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay import coordinate
from istc_replay.bench import recorded_log
from istc_replay.config import Config, parse_config
from istc_replay.coordinate import Planners, plan_part
from istc_replay.corridors.formulation import default_limits
from istc_replay.corridors.solve import go_on
from istc_replay.datatypes import SOUND, Log, WindowOutcome, WindowPlan, WindowStatus
from istc_replay.fallback import FOUND_BY, carried_on
from istc_replay.handover import motion_before
from istc_replay.pipeline.judge import judged
from istc_replay.pipeline.replay import replay_read
from istc_replay.pipeline.windows import plan_windows
from istc_replay.samples.scenes import find_sample, record
from istc_replay.windows import LogPart, lengthened, log_parts

from .test_random_scenes import random_scene

STEPS = """
corridors.mode = "fast"
window = {{ whole_log_s = {stride}, horizon_s = {horizon}, stride_s = {stride}, start = "handed_over" }}
"""


def steps(horizon_s: float = 6.0, stride_s: float = 3.0) -> Config:
    """A scene in steps."""
    return parse_config(STEPS.format(horizon=horizon_s, stride=stride_s))


def failed(part: LogPart, plan: WindowPlan) -> WindowPlan:
    """A window whose solvers found nothing."""
    return WindowPlan(plan.scenario, WindowStatus.NO_CORRIDORS, f"nothing in window {part.span[2]}")


def planned(log: Log, config: Config) -> list[tuple[LogPart, WindowOutcome]]:
    return list(zip(log_parts(log, config), plan_windows(log, config), strict=True))


def scene_log(name: str | int) -> Log:
    return recorded_log(record(random_scene(name)) if isinstance(name, int) else find_sample(name).record())


CASES = [
    ("dense_4", (5.0, 2.0)),
    (0, (6.0, 3.0)),
    (1, (6.0, 2.2)),
    *(pytest.param(seed, (5.0, 2.5), marks=pytest.mark.slow) for seed in range(2, 20)),
    pytest.param("dense_8_obstacles", (8.0, 4.0), marks=pytest.mark.slow),
]


def assert_corridors_about(before: WindowPlan, shifted: WindowPlan, config: Config) -> None:
    """Layer 1 written about the motion of the plan before has it as a solution, and finds one as good."""
    scenario = shifted.scenario
    frames = motion_before(before, scenario, shifted.guidance)
    limits = {p.vehicle_id: default_limits(config.corridors) for p in scenario.participants}
    found = go_on(frames, scenario, shifted.guidance, config.corridors, limits, 10.0)
    assert len(found.corridors) == len(scenario.participants)
    pivots = [frame.points_m for frame in frames]
    references = [guide.points_m for guide in shifted.guidance]
    away = [float(((p - r) ** 2).sum()) for p, r in zip(pivots, references, strict=True)]
    assert found.objective is not None
    assert found.objective <= 10.0 * sum(away) + 1e-6


@pytest.mark.parametrize(("scene", "step"), CASES)
def test_whatever_the_solvers_find_the_plan_before_is_one_that_passes_every_check(
    scene: str | int, step: tuple[float, float]
) -> None:
    config = steps(*step)
    windows = planned(scene_log(scene), config)
    assert len(windows) > 2
    for (_, before), (part, outcome) in pairwise(windows):
        assert outcome.plan.status in SOUND
        shifted = carried_on(failed(part, outcome.plan), before.plan, part, config)
        assert shifted is not None
        again = judged(shifted, part, config, before.plan)
        assert again.plan.status in SOUND, again.plan.reason
        assert len(again.plan.trajectories) == len(before.plan.trajectories)
        assert_corridors_about(before.plan, shifted, config)


def test_a_plan_that_reaches_further_goes_on_window_after_window() -> None:
    config = steps(5.0, 2.0)
    first, *parts = log_parts(scene_log(0), config)
    before = plan_part(lengthened(first)[0], config, Planners(config))
    before = judged(before, first, config).plan
    for part in parts:
        shifted = carried_on(failed(part, before), before, part, config)
        assert shifted is not None
        before = judged(shifted, part, config, before).plan
        assert before.status in SOUND, before.reason


def test_who_goes_on_stands_at_the_end_of_its_window() -> None:
    windows = planned(scene_log("dense_4"), steps(5.0, 2.0))
    for _, outcome in windows[:-1]:
        for participant, trajectory in zip(
            outcome.plan.scenario.participants, outcome.plan.trajectories, strict=True
        ):
            assert participant.goes_on
            assert np.abs(trajectory.states[-1, 4:]).max() < 1e-6
    assert not any(p.goes_on for p in windows[-1][1].plan.scenario.participants)


def test_where_nothing_is_found_any_more_all_come_to_stand_in_their_corridors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def solvers_that_fail(part: LogPart, *rest: Any) -> WindowPlan:
        plan = plan_part(part, *rest)
        return plan if part.span[2] == 0 else failed(part, plan)

    monkeypatch.setattr(coordinate, "plan_part", solvers_that_fail)
    done = replay_read(scene_log("dense_4"), steps())
    first, *others = done.summary["windows"]
    assert first["status"] == "certified"
    assert [w["status"] for w in others[:-1]] == ["certified"] * (len(others) - 1)
    assert others[-1]["status"] == "goal_not_reached"
    for window in others:
        assert window["corridors"]["found_by"] == FOUND_BY
        assert (
            f"the plan before goes on: no_corridors: nothing in window {window['index']}" in window["reason"]
        )
        assert {v["start"] for v in window["vehicles"]} == {"handed_over"}
        checks = {check["check"]: check["verdict"] for check in window["certificate"]["checks"]}
        assert checks["seam"] == "pass"
    last = done.result.states.filter(pl.col("source") == "planned", pl.col("window") == others[-1]["index"])
    assert float(last["speed_mps"].abs().max()) < 1e-6  # type: ignore[arg-type]


def test_where_somebody_new_comes_the_window_is_reported_and_the_next_begins_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = scene_log("dense_4")
    name = log.states["vehicle_id"][0]
    late = int(log.states["time_ns"].min()) + 2_500_000_000  # type: ignore[arg-type]
    log = replace(log, states=log.states.filter((pl.col("vehicle_id") != name) | (pl.col("time_ns") > late)))

    def one_that_fails(part: LogPart, *rest: Any) -> WindowPlan:
        plan = plan_part(part, *rest)
        return failed(part, plan) if part.span[2] == 1 else plan

    monkeypatch.setattr(coordinate, "plan_part", one_that_fails)
    first, second, third, *_ = replay_read(log, steps()).summary["windows"]
    assert (first["status"], third["status"]) == ("certified", "certified")
    assert (second["status"], second["reason"]) == ("no_corridors", "nothing in window 1")
    assert second["vehicles_certified"] == 0
    assert {v["start"] for v in third["vehicles"]} == {"recording"}
