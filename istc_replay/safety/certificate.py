"""Certificates of plans, from the written result alone.

| check | says |
|---|---|
| complete | every vehicle with a corridor has a trajectory over all of its time units |
| cubes_disjoint | cubes of two vehicles keep the promised gap, eq. (5) |
| obstacles_clear | cubes keep the promised gap from obstacles, eq. (6) |
| obstacles_known | the scene's obstacles, and road users as recorded, are among those kept clear of |
| in_bounds | nothing leaves the map |
| cubes_overlap | at a switch of units the box lies in both cubes, eq. (11) |
| start | the plan starts where the vehicle was recorded, eq. (8) |
| seam | a plan that was handed over starts where the plan before has led, in state and controls |
| dynamics | the knots are those of the re-integrated bicycle, eq. (17) |
| limits | steering, speed, acceleration and their rates keep eq. (18) |
| in_corridor | the moving box stays in its cubes, eq. (19), in continuous time |
| lateral | in traffic, the moving box stays on the road, or near the recorded path |
| separation | moving boxes stay apart in continuous time, whatever the cubes |
| obstacle_separation | moving boxes stay clear of obstacles |

What cannot be judged is inconclusive, never a pass.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from istc_replay.config import Config
from istc_replay.datatypes import Certificate, Result, StaticScene, Verdict
from istc_replay.safety.case import build_case, listing
from istc_replay.safety.cube_checks import cubes_disjoint, cubes_overlap, in_bounds, obstacles_clear
from istc_replay.safety.lateral_check import lateral_kept
from istc_replay.safety.motion_checks import (
    dynamics,
    in_corridor,
    limits,
    obstacle_separation,
    seam,
    separation,
    start,
)
from istc_replay.safety.obstacle_check import obstacles_known
from istc_replay.safety.plan import WrittenPlan
from istc_replay.safety.recorded import Track, recorded_tracks
from istc_replay.safety.written_plans import written_plans

_CHECKS = {
    "cubes_disjoint": cubes_disjoint,
    "obstacles_clear": obstacles_clear,
    "obstacles_known": obstacles_known,
    "in_bounds": in_bounds,
    "cubes_overlap": cubes_overlap,
    "start": start,
    "seam": seam,
    "dynamics": dynamics,
    "limits": limits,
    "in_corridor": in_corridor,
    "lateral": lateral_kept,
    "separation": separation,
    "obstacle_separation": obstacle_separation,
}


def certify(result: Result, config: Config) -> tuple[Certificate, ...]:
    """Certify the plans of all windows of a result, from its tables alone.

    A trajectory is judged by the motion that its first state and held controls cause, not by its
    knots. Speed, steering and acceleration of planned states are those of the rear axle.

    Parameters
    ----------
    result : Result
        As read back from a result.mcap.
    config : Config
        The promised gaps, the limits and the tolerances.

    Returns
    -------
    tuple of Certificate
        One a check and window; none for a window that has no plan.
    """
    tracks = recorded_tracks(result.states, vehicles_only=False)
    plans = written_plans([result])
    return tuple(check for plan in plans for check in certify_plan(plan, tracks, result.scene, config))


def overall(certificates: Iterable[Certificate]) -> Verdict:
    """The verdict of several checks: fail before inconclusive before pass before not applicable."""
    verdicts = {certificate.verdict for certificate in certificates}
    for verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.PASS):
        if verdict in verdicts:
            return verdict
    return Verdict.NOT_APPLICABLE


@np.errstate(all="ignore")  # NaN and infinity are judged, not warned of
def certify_plan(
    plan: WrittenPlan, tracks: Mapping[str, Track], scene: StaticScene, config: Config
) -> list[Certificate]:
    """Certify one window's plan; `tracks` are those of all that was recorded, also of no vehicles."""
    case = build_case(plan, tracks, scene, config)
    if case is None:
        detail = "not judged: the plan has too many pieces of time"
        checks = [
            Certificate(plan.index, check, Verdict.INCONCLUSIVE, None, "m", None, plan.vehicles, detail)
            for check in _CHECKS
        ]
    else:
        checks = [check(case) for check in _CHECKS.values()]
    return [complete(plan), *checks]


def complete(plan: WrittenPlan) -> Certificate:
    """Every vehicle with a corridor has a sound trajectory over exactly its time units."""
    if not plan.faults:
        verdict = Verdict.PASS if plan.vehicles else Verdict.NOT_APPLICABLE
        return Certificate(plan.index, "complete", verdict, None, "", None, (), f"{len(plan.plans)} vehicles")
    vehicles = tuple(fault.vehicle_id for fault in plan.faults)
    first = plan.faults[0]
    detail = f"{listing(vehicles[:1])}: {first.detail}"
    if len(vehicles) > 1:
        detail += f"; and {len(vehicles) - 1} more"
    return Certificate(plan.index, "complete", Verdict.FAIL, None, "", first.time_s, vehicles, detail)
