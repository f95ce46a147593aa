"""Planning one window: its scenario and guidance at each time unit, and the rounds of both layers."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

from istc_replay.datatypes import WindowPlan
from istc_replay.errors import SolveError
from istc_replay.field import Field, Repairs, prepare
from istc_replay.guidance.build import build_guidance
from istc_replay.handover import handed_over, motion_before
from istc_replay.jam import jammed
from istc_replay.rounds import Rounds
from istc_replay.scenario import build_scenario
from istc_replay.tracks import road_users
from istc_replay.trajectories.plan import TrajectoryPlanner
from istc_replay.trajectories.repair import RecordingRepairer
from istc_replay.windows import CROWDED_UNIT_S, TRAFFIC_UNITS_S, fitting_unit_s, in_steps, lengthened

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from istc_replay.config import Config
    from istc_replay.datatypes import (
        LateralBound,
        Scenario,
    )
    from istc_replay.windows import LogPart

#: Plans may be this much faster than the fastest recorded vehicle of their window.
_FASTER_SHARE, _FASTER_MPS = 1.15, 1.0
#: Where vehicles have to be frozen, plans at so many of the finest time units are compared.
_PARTIALS = 2


def speed_max_mps(scenario: Scenario, config: Config) -> float:
    """Largest speed of a plan: the configured one, or more where traffic was faster."""
    fastest = max((float(abs(p.recording.speeds_mps).max()) for p in scenario.participants), default=0.0)
    return max(config.trajectories.speed_max_mps, _FASTER_SHARE * fastest + _FASTER_MPS)


class Planners:
    """The compiled NLPs of a replay, which all windows share."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._planners: dict[float, TrajectoryPlanner] = {}
        self.repairer = RecordingRepairer(config.trajectories)

    def of(self, scenario: Scenario) -> TrajectoryPlanner:
        """The planner of a window's time unit."""
        unit_s = scenario.window.unit_s
        if unit_s not in self._planners:
            self._planners[unit_s] = TrajectoryPlanner(self._config.trajectories, unit_s)
        return self._planners[unit_s]


def plan_part(
    part: LogPart,
    config: Config,
    planners: Planners,
    progress: Callable[[str], None] = lambda _: None,
    before: WindowPlan | None = None,
) -> WindowPlan:
    """Plan one window of a log; of traffic with finer time units where vehicles had to be frozen.

    The plan follows from the part and the configuration alone, whatever was planned before.

    Parameters
    ----------
    part : LogPart
        Of `windows.log_parts`.
    config : Config
        The settings in force.
    planners : Planners
        Shared by all windows.
    progress : callable
        Told in words what is being done.
    before : WindowPlan, optional
        The plan of the window before, which hands its vehicles over.
    """
    began = time.perf_counter()
    longer = lengthened(part) if in_steps(config.window, traffic=part.traffic) else []
    tried: list[Rounds] = []
    plan = _plan_span(part, config, planners, progress, before, tried)
    for further in longer:  # a jam is left to no later window: there is no way back
        if not plan.trajectories or not jammed(plan):
            break
        other = _plan_span(further, config, planners, progress, before, tried)
        plan = other if other.trajectories else plan
    seconds: dict[str, float] = {}
    for rounds in tried:
        for name, value in rounds.seconds.items():
            seconds[name] = seconds.get(name, 0.0) + value
    seconds["scenario"] = time.perf_counter() - began - sum(seconds.values())
    return replace(plan, seconds=seconds)


def _plan_span(
    part: LogPart,
    config: Config,
    planners: Planners,
    progress: Callable[[str], None],
    before: WindowPlan | None,
    tried: list[Rounds],
) -> WindowPlan:
    """Plan one span of time, at finer time units where that fails; adds to the rounds that were `tried`."""
    handed = handed_over(before, part.span[0])
    users = road_users(part.states)
    repairs = Repairs(planners.repairer)
    bounds: dict[str, LateralBound] = {}
    first = build_scenario(part, config, users=users, handed=handed, bounds=bounds)
    stepping, known = in_steps(config.window, traffic=part.traffic), len(tried)
    plan: WindowPlan | None = None
    # Finer time units leave more room to cars that are close: they are tried before any is frozen.
    for unit_s in (None, *_finer_units(first, config)):
        scenario = (
            first
            if unit_s is None
            else build_scenario(part, config, unit_s, users=users, handed=handed, bounds=bounds)
        )
        tried.append(_begin(scenario, config, planners.of(scenario), progress, repairs))
        if stepping:
            ready = tried[-1].ready
            tried[-1].before = motion_before(before, ready.scenario, ready.guidance)
        if unit_s is not None:
            tried[-1].leave_the_tree()
        plan = tried[-1].run()
        if plan is not None and (plan.trajectories or not stepping):
            return plan
    return plan or _best_partial(tried[known:])


def _finer_units(scenario: Scenario, config: Config) -> list[float]:
    """Time units [s] to try a window at where there is no plan for all at its own."""
    if config.window.unit_s != "auto":
        return []
    finer: tuple[float, ...] = ()
    if scenario.traffic:
        finer = TRAFFIC_UNITS_S
    elif scenario.small_crowd or in_steps(config.window, traffic=False):
        finer = (fitting_unit_s(CROWDED_UNIT_S, config.window, traffic=False),)
    return [unit_s for unit_s in finer if unit_s < scenario.window.unit_s]


def _best_partial(tried: Sequence[Rounds]) -> WindowPlan:
    """The plan of the most vehicles where some have to be frozen, from the finest time unit on."""
    best: WindowPlan | None = None
    for rounds in reversed(tried[-_PARTIALS:]):
        rounds.may_freeze = True
        plan = rounds.run()
        if plan is not None and (best is None or len(plan.trajectories) > len(best.trajectories)):
            best = plan
    if best is None:
        raise SolveError("a window's rounds ended without an outcome: please report this log")
    return best


def _begin(
    scenario: Scenario,
    config: Config,
    planner: TrajectoryPlanner,
    progress: Callable[[str], None],
    repairs: Repairs,
) -> Rounds:
    """Make a window ready to be planned: its guidance by the law that is set."""
    progress("guidance")
    began = time.perf_counter()
    fastest = speed_max_mps(scenario, config)
    law = config.guidance.law
    if law == "recorded" or (law == "auto" and scenario.traffic):
        ready = prepare(scenario, config, repairs, fastest)
    else:
        gaps = config.corridors.vehicle_gap_m, config.corridors.obstacle_gap_m
        ready = Field(scenario, build_guidance(scenario, config.guidance), *gaps)
    seconds = {"guidance": time.perf_counter() - began, "corridors": 0.0, "trajectories": 0.0}
    return Rounds(ready, config, planner, fastest, progress, seconds)
