"""The plan before, shifted: a plan of a scene's next window that is at hand whatever its solvers find.

In steps a plan ends standing. What it has left when its step is over, and then standing in its last
cubes, is a plan of the next window: it stays in cubes that are disjoint, since the plan before did.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.arrival import late_text, late_vehicles
from istc_replay.datatypes import (
    SOUND,
    Corridor,
    Corridors,
    SolveStatus,
    WindowPlan,
    WindowStatus,
    read_only,
)
from istc_replay.guidance.build import build_guidance
from istc_replay.handover import handed_over, held, units_since
from istc_replay.scenario import build_scenario
from istc_replay.trajectories.nlp import COSTS
from istc_replay.trajectories.task import Task
from istc_replay.trajectories.walls import Grid
from istc_replay.windows import in_steps

if TYPE_CHECKING:
    from istc_replay.config import Config, CorridorsConfig
    from istc_replay.datatypes import Guidance, Participant, Trajectory
    from istc_replay.windows import LogPart

FOUND_BY = "the plan before"
#: A plan that ends with no more speed and acceleration stands [m/s, m/s^2].
_STANDING = 1e-6


def carried_on(failed: WindowPlan, before: WindowPlan, part: LogPart, config: Config) -> WindowPlan | None:
    """Go on with the plan of the window before where this window's own failed.

    Parameters
    ----------
    failed : WindowPlan
        What was tried in this window, and told in the reason.
    before : WindowPlan
        The plan of the window before.
    part : LogPart
        This window's part of the log.
    config : Config
        The settings in force.

    Returns
    -------
    WindowPlan or None
        None where the plan before is none of this window: it passes not every check, someone is new, or
        its time units do not divide the stride.
    """
    window = before.scenario.window
    shift = units_since(before, part.span[0])
    if not in_steps(config.window, traffic=part.traffic) or before.status not in SOUND:
        return None
    if before.frozen or shift is None:
        return None
    # It stands at its end, not before: the window reaches as far, where the one before reached further.
    start_ns, length_ns, index = part.span
    part = replace(part, span=(start_ns, max(length_ns, window.end_ns - start_ns), index))
    handed = handed_over(before, start_ns)
    scenario = build_scenario(part, config, window.unit_s, handed=handed, frame=window.frame)
    guidance = build_guidance(scenario, config.guidance)
    corridors = {c.vehicle_id: c for c in before.corridors.corridors} if before.corridors else {}
    driven = {t.vehicle_id: t for t in before.trajectories}
    shifted, trajectories, objective = [], [], 0.0
    for participant, guide in zip(scenario.participants, guidance, strict=True):
        name = participant.vehicle_id
        if participant.approach is None or name not in corridors:
            return None
        corridor = _shifted(corridors[name], shift, participant, guide)
        per_unit = len(driven[name].controls) // len(corridors[name].cubes_m)
        trajectory = _going_on(driven[name], shift, per_unit, corridor, participant, guide, config)
        if trajectory is None:
            return None
        shifted.append(corridor)
        objective += _objective(corridor, participant.priority, config.corridors)
        trajectories.append(trajectory)
    late = late_vehicles(scenario.participants, trajectories)
    told = f"the plan before goes on: {failed.status}: {failed.reason}"
    return replace(
        failed,
        scenario=scenario,
        status=WindowStatus.NOT_CERTIFIED,  # until the certificate has said otherwise
        reason="; ".join(filter(None, [late_text(late, scenario), told])),
        guidance=guidance,
        corridors=Corridors(
            SolveStatus.FEASIBLE,
            tuple(shifted),
            objective=objective,
            found_by=FOUND_BY,
        ),
        trajectories=tuple(trajectories),
        undrivable=(),
        frozen=(),
        vehicle_gap_m=before.vehicle_gap_m,
        obstacle_gap_m=before.obstacle_gap_m,
        late=tuple(late),
    )


def _shifted(corridor: Corridor, shift: int, participant: Participant, guide: Guidance) -> Corridor:
    """A corridor from a later unit on; after its end, the vehicle stays in its last cube."""
    return Corridor(
        corridor.vehicle_id,
        0,
        read_only(held(corridor.cubes_m[shift:], participant.units)),
        read_only(held(corridor.pivots_m[shift:], participant.units + 1)),
        guide.points_m,
    )


def _going_on(
    before: Trajectory,
    shift: int,
    per_unit: int,
    corridor: Corridor,
    participant: Participant,
    guide: Guidance,
    config: Config,
) -> Trajectory | None:
    """A trajectory from a later unit on, then standing; None where it ends in motion too early."""
    first, intervals = shift * per_unit, per_unit * participant.units
    moving = np.abs(before.states[-1, 4:]).max() > _STANDING
    if first >= len(before.controls) or (moving and len(before.controls) - first < intervals):
        return None
    states = held(before.states[first:], intervals + 1)
    controls = np.zeros((intervals, 2))
    own = before.controls[first:][:intervals]
    controls[: len(own)] = own
    grid = Grid(participant.units, per_unit, float(before.times_s[1] - before.times_s[0]))
    task = Task.of(participant, corridor, guide, grid, config.trajectories.speed_max_mps)
    relative = states - np.concatenate([task.origin_m, np.zeros(4)])
    costs = task.costs(relative, controls, config.trajectories)
    return replace(
        before,
        times_s=read_only(grid.knots_s),
        states=read_only(states),
        controls=read_only(controls),
        cost=sum(costs),
        costs=dict(zip(COSTS, costs, strict=True)),
    )


def _objective(corridor: Corridor, priority: float, config: CorridorsConfig) -> float:
    """A vehicle's part of eq. (4)."""
    off = corridor.pivots_m[1:] - corridor.references_m[1:]
    sides = corridor.cubes_m[:, 1::2] - corridor.cubes_m[:, 0::2]
    return priority * float(config.reference_weight * (off**2).sum() - config.area_weight * sides.sum())
