"""Planning one window: guidance, corridors, trajectories, and the feedback between the layers."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

from istc_replay.corridors.formulation import default_limits
from istc_replay.corridors.solve import solve_corridors
from istc_replay.datatypes import WindowPlan, WindowStatus
from istc_replay.guidance.build import build_guidance
from istc_replay.trajectories.plan import TrajectoryPlanner

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from istc_replay.config import Config
    from istc_replay.datatypes import (
        Corridors,
        Guidance,
        Scenario,
        SolveRecord,
        Undrivable,
    )
    from istc_replay.trajectories.plan import TrajectoryOutcome

#: Plans may be this much faster than the fastest recorded vehicle of their window.
_FASTER_SHARE, _FASTER_MPS = 1.15, 1.0


def speed_max_mps(scenario: Scenario, config: Config) -> float:
    """Largest speed of a plan: the configured one, or more where traffic was faster."""
    fastest = max((float(abs(p.recording.speeds_mps).max()) for p in scenario.participants), default=0.0)
    return max(config.trajectories.speed_max_mps, _FASTER_SHARE * fastest + _FASTER_MPS)


def plan_window(
    scenario: Scenario,
    config: Config,
    planner: TrajectoryPlanner,
    progress: Callable[[str], None] = lambda _: None,
) -> WindowPlan:
    """Plan one window; every outcome is a WindowPlan with its status and reason.

    A vehicle that cannot be driven in its corridor has its layer-1 limits tightened and layer 1
    is solved again, at most `trajectories.feedback_rounds` times.

    Parameters
    ----------
    scenario : Scenario
        Who takes part.
    config : Config
        Settings of both layers.
    planner : TrajectoryPlanner
        Keeps the NLPs that it built, so that windows share them.
    progress : callable
        Told in words what is being done.
    """
    seconds = {"guidance": 0.0, "corridors": 0.0, "trajectories": 0.0}
    if not scenario.participants:
        reason = "no vehicle of the window can be planned: " + _exclusion_text(scenario)
        return WindowPlan(scenario, WindowStatus.NOTHING_TO_PLAN, reason, seconds=seconds)
    began = time.perf_counter()
    guidance = build_guidance(scenario, config.guidance)
    seconds["guidance"] = time.perf_counter() - began
    limits = {p.vehicle_id: default_limits(config.corridors) for p in scenario.participants}
    fastest = speed_max_mps(scenario, config)
    records: list[SolveRecord] = []
    round_ = 0
    while True:
        round_ += 1
        progress("corridors" if round_ == 1 else f"corridors, round {round_}")
        began = time.perf_counter()
        corridors = solve_corridors(scenario, guidance, config.corridors, limits, fastest)
        seconds["corridors"] += time.perf_counter() - began
        records += corridors.records
        if not corridors.corridors:
            reason = corridors.reason + _after(round_)
            plan = WindowPlan(scenario, WindowStatus.NO_CORRIDORS, reason, guidance, corridors)
            break
        progress("trajectories")
        began = time.perf_counter()
        outcomes = _trajectories(scenario, guidance, corridors, planner, fastest)
        seconds["trajectories"] += time.perf_counter() - began
        records += [record for outcome in outcomes for record in outcome.records]
        undrivable = tuple(o.undrivable for o in outcomes if o.undrivable is not None)
        if not undrivable:
            found = tuple(o.trajectory for o in outcomes if o.trajectory is not None)
            # Not certified until the certificate has said so.
            plan = WindowPlan(scenario, WindowStatus.NOT_CERTIFIED, "", guidance, corridors, found)
            break
        if round_ > config.trajectories.feedback_rounds or config.corridors.formulation == "paper":
            reason = "; ".join(_undrivable_text(u) for u in undrivable) + _after(round_)
            plan = WindowPlan(
                scenario, WindowStatus.NOT_DRIVABLE, reason, guidance, corridors, undrivable=undrivable
            )
            break
        for culprit in undrivable:
            limits[culprit.vehicle_id] = limits[culprit.vehicle_id].tightened()
    return replace(plan, rounds=round_, records=tuple(records), seconds=seconds)


def _trajectories(
    scenario: Scenario,
    guidance: Sequence[Guidance],
    corridors: Corridors,
    planner: TrajectoryPlanner,
    fastest_mps: float,
) -> list[TrajectoryOutcome]:
    return [
        planner.plan(participant, corridor, guide, fastest_mps)
        for participant, corridor, guide in zip(
            scenario.participants, corridors.corridors, guidance, strict=True
        )
    ]


def _undrivable_text(undrivable: Undrivable) -> str:
    return f"{undrivable.vehicle_id} in time unit {undrivable.unit}: {undrivable.detail}"


def _after(rounds: int) -> str:
    return "" if rounds == 1 else f" (after {rounds} rounds of tightened limits)"


def _exclusion_text(scenario: Scenario) -> str:
    if not scenario.excluded:
        return "none is present"
    return "; ".join(f"{e.vehicle_id}: {e.detail}" for e in scenario.excluded[:5])
