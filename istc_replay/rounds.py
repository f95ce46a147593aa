"""The rounds of both layers for one window: what one cannot do takes freedom from whom it concerns."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.arrival import distance_left_m, drawn_home, late_text, late_vehicles
from istc_replay.bicycle import dense_motion
from istc_replay.corridors.formulation import default_limits
from istc_replay.corridors.seeded import Seeds
from istc_replay.corridors.solve import bounded, find_corridors, go_on, prove_corridors
from istc_replay.datatypes import ARRIVED_M, SolveStatus, WindowPlan, WindowStatus
from istc_replay.field import Field, least_cover
from istc_replay.geometry import shift_along
from istc_replay.lateral import ROAD, lateral

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from istc_replay.config import Config, CorridorsConfig
    from istc_replay.corridors.incumbent import Search
    from istc_replay.corridors.problem import Limits
    from istc_replay.datatypes import (
        Corridor,
        Corridors,
        Guidance,
        Lateral,
        LateralBound,
        Participant,
        Scenario,
        SolveRecord,
        Trajectory,
        Undrivable,
    )
    from istc_replay.trajectories.plan import TrajectoryOutcome, TrajectoryPlanner

#: A scene whose vehicles do not arrive is tried again from other seeds so often.
_RESEEDS = 2
#: A plan keeps this from its lateral bound, at instants no farther apart than the second [m, s].
_LATERAL_RESERVE_M, _LATERAL_STEP_S = 0.02, 0.1


@dataclass(slots=True)
class Rounds:
    """The rounds of both layers for one window, until a plan stands or nobody is left.

    Unless it `may_freeze` vehicles, it stops where it would have to, or where a small crowd is left by the
    conflict tree to seeds, and can go on from there.
    """

    ready: Field
    config: Config
    planner: TrajectoryPlanner
    fastest_mps: float
    progress: Callable[[str], None]
    seconds: dict[str, float]
    may_freeze: bool = False
    round: int = 0
    pending: dict[str, tuple[str, str]] = field(default_factory=dict)
    limits: dict[str, Limits] = field(default_factory=dict)
    tightened: dict[str, int] = field(default_factory=dict)
    strayed: dict[str, int] = field(default_factory=dict)
    lateral: tuple[Lateral, ...] = ()
    records: list[SolveRecord] = field(default_factory=list)
    # None while a small crowd is tried by the conflict tree alone.
    seeds: Seeds | None = field(default_factory=Seeds)
    kept: tuple[tuple[int, float], WindowPlan, Search | None] | None = None
    search: Search | None = None  # of the last round
    before: tuple[Guidance, ...] = ()  # in steps, how the plan before goes on
    stuck: bool = False
    _known: dict[tuple[str, bytes], TrajectoryOutcome] = field(default_factory=dict)
    _beside: dict[tuple[str, bytes], Lateral] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.ready.freeze(self.ready.overlaps)
        self.records = list(self.ready.records)
        participants = self.ready.scenario.participants
        self.limits = {p.vehicle_id: default_limits(self.config.corridors) for p in participants}
        if self.ready.scenario.small_crowd and self.config.corridors.formulation != "paper":
            self.seeds = None

    def leave_the_tree(self) -> bool:
        """Go on with seeds where a small crowd was tried without; whether it was."""
        if self.seeds is not None:
            return False
        self.seeds, self.round = Seeds(), 0
        return True

    def run(self) -> WindowPlan | None:
        """Solve the layers in turn; every round takes freedom from a vehicle, so that they end."""
        if not self.ready.scenario.participants and not self.ready.frozen:
            reason = "no vehicle of the window can be planned: " + _exclusion_text(self.ready.scenario)
            return self._plan(WindowStatus.NOTHING_TO_PLAN, reason, None)
        while True:
            if self.pending or self.stuck:
                if not self.may_freeze:
                    return None
                self.stuck = False
                self.ready.freeze(self.pending)
                self.pending = {}
            if not self.ready.scenario.participants:
                frozen = "; ".join(f"{e.vehicle_id}: {e.detail}" for e in self.ready.frozen)
                return self._plan(WindowStatus.NO_CORRIDORS, f"nobody could be planned: {frozen}", None)
            self.round += 1
            plan = self._round()
            if plan is not None:
                return plan

    def _round(self) -> WindowPlan | None:
        """One round: the plan, or None where something has been changed to try again."""
        corridors = self._corridors()
        if not corridors.corridors:
            self.stuck = self.leave_the_tree()
            if (
                self.stuck
                or self._yield_to_conflicts(corridors)
                or self._reseed(corridors.status is SolveStatus.LIMIT)
            ):
                return None
            going_on = self._going_on()
            if going_on is None:
                status = WindowStatus.CONFLICT_LEFT if corridors.conflicts else WindowStatus.NO_CORRIDORS
                return self._settled(status, corridors.reason + self._after(), corridors)
            corridors = going_on
        outcomes = self._trajectories(corridors)
        undrivable = tuple(o.undrivable for o in outcomes if o.undrivable is not None)
        found = tuple(o.trajectory for o in outcomes if o.trajectory is not None)
        late = {} if undrivable else self._late(found)
        if undrivable or late:
            self.stuck = self.leave_the_tree()
            if self.stuck:
                return None
        if undrivable:
            if self._give_way(undrivable):
                return None
            reason = "; ".join(_undrivable_text(u) for u in undrivable) + self._after()
            return self._settled(WindowStatus.NOT_DRIVABLE, reason, corridors, undrivable=undrivable)
        if self._strays(found):
            return None
        reason = "; ".join(filter(None, [late_text(late, self.ready.scenario), corridors.reason]))
        # Not certified until the certificate has said so.
        plan = self._plan(WindowStatus.NOT_CERTIFIED, reason, corridors, trajectories=found)
        plan = replace(plan, late=tuple(late))
        rank = (len(late), corridors.objective or 0.0)
        if self.kept is None or rank < self.kept[0]:
            self.kept = (rank, plan, self.search)
        return None if self._reseed(bool(late)) else self._settled(plan.status, reason, corridors)

    def _settled(
        self,
        status: WindowStatus,
        reason: str,
        corridors: Corridors,
        undrivable: tuple[Undrivable, ...] = (),
    ) -> WindowPlan:
        """The best plan of all rounds, or this outcome where there is none."""
        if self.kept is None:
            plan, search = self._plan(status, reason, corridors, undrivable=undrivable), self.search
        else:
            _, plan, search = self.kept
        if search is not None:
            plan = self._proven(plan, search)
        return replace(plan, rounds=self.round, records=tuple(self.records), seconds=self.seconds)

    def _proven(self, plan: WindowPlan, search: Search) -> WindowPlan:
        """A plan with its bound; with better corridors that the proof found where they do as well."""
        self.progress("proof")
        began, known = time.perf_counter(), len(search.records)
        better = prove_corridors(search, self.ready.scenario, self._settings())
        self.seconds["corridors"] += time.perf_counter() - began
        self.records += better.records[known:]
        before = plan.corridors
        if before is None or better.objective == before.objective:
            return replace(plan, corridors=better)
        if plan.trajectories:
            outcomes = self._trajectories(better)
            found = tuple(o.trajectory for o in outcomes if o.trajectory is not None)
            if len(found) == len(outcomes) and [*self._late(found)] == [*self._late(plan.trajectories)]:
                laterals = self._laterals(found)
                if all(kept.margin_m >= _LATERAL_RESERVE_M for kept in laterals):
                    return replace(plan, corridors=better, trajectories=found, lateral=laterals)
        return replace(plan, corridors=bounded(before, better.bound, self.config.corridors.gap_tolerance))

    def _reseed(self, wanted: bool, undrivable: Sequence[Undrivable] = ()) -> bool:
        """Whether a scene is tried again: from its last seed, where that is undrivable, or from others."""
        scene = not self.ready.scenario.traffic and self.config.corridors.formulation != "paper"
        most = self.config.trajectories.feedback_rounds
        if not undrivable:
            most = min(_RESEEDS, most)
        if not (wanted and scene and self.round <= most):
            return False
        numbers = {p.vehicle_id: i for i, p in enumerate(self.ready.scenario.participants)}
        self.seeds = self.seeds or Seeds()
        self.seeds.again([(numbers[u.vehicle_id], u.unit) for u in undrivable])
        return True

    def _late(self, found: Sequence[Trajectory]) -> dict[str, float]:
        """Vehicles that end beside their goals; of traffic only a part of each way is in the window."""
        scenario = self.ready.scenario
        return {} if scenario.traffic else late_vehicles(scenario.participants, found)

    def _corridors(self) -> Corridors:
        self.progress("corridors" if self.round == 1 else f"corridors, round {self.round}")
        began = time.perf_counter()
        scenario, guidance = self.ready.scenario, self.ready.guidance
        corridors, self.search = find_corridors(
            scenario, guidance, self._settings(), self.limits, self.fastest_mps, self.seeds
        )
        self.seconds["corridors"] += time.perf_counter() - began
        self.records += corridors.records
        return corridors

    def _going_on(self) -> Corridors | None:
        """Corridors about the plan before, once; None where there are none."""
        frames, self.before = self.before, ()
        if not frames:
            return None
        began = time.perf_counter()
        scenario, guidance = self.ready.scenario, self.ready.guidance
        found = go_on(frames, scenario, guidance, self._settings(), self.limits, self.fastest_mps)
        self.seconds["corridors"] += time.perf_counter() - began
        self.records += found.records
        return found if found.corridors else None

    def _settings(self) -> CorridorsConfig:
        """Layer 1's settings with the gaps of this window."""
        gaps = {"vehicle_gap_m": self.ready.vehicle_gap_m, "obstacle_gap_m": self.ready.obstacle_gap_m}
        return self.config.corridors.model_copy(update=gaps)

    def _trajectories(self, corridors: Corridors) -> list[TrajectoryOutcome]:
        self.progress("trajectories")
        began = time.perf_counter()
        outcomes = []
        participants = self.ready.scenario.participants
        for participant, corridor, guide in zip(
            participants, corridors.corridors, corridors.frames or self.ready.guidance, strict=True
        ):
            key = (participant.vehicle_id, corridor.cubes_m.tobytes() + corridor.pivots_m.tobytes())
            if key not in self._known:
                self._known[key] = self._driven(participant, corridor, guide)
            outcomes.append(self._known[key])
        self.seconds["trajectories"] += time.perf_counter() - began
        return outcomes

    def _driven(self, participant: Participant, corridor: Corridor, guide: Guidance) -> TrajectoryOutcome:
        """Layer 2 of one vehicle; who would end beside its goal is held there, where it can be."""
        outcome = self.planner.plan(participant, corridor, guide, self.fastest_mps)
        self.records += outcome.records
        found = outcome.trajectory
        if found is None or self.ready.scenario.traffic or distance_left_m(participant, found) <= ARRIVED_M:
            return outcome
        home = drawn_home(corridor, participant)
        if home is None:
            return outcome
        again = self.planner.plan(participant, home, guide, self.fastest_mps)
        self.records += again.records
        return outcome if again.trajectory is None else again

    def _give_way(self, undrivable: tuple[Undrivable, ...]) -> bool:
        """Tighten the limits of vehicles that cannot be driven, or in traffic freeze them."""
        most = self.config.trajectories.feedback_rounds
        if self.config.corridors.formulation == "paper":
            most = 0
        again = [u.vehicle_id for u in undrivable if self.tightened.get(u.vehicle_id, 0) < most]
        if self.ready.scenario.crowded:
            return self._reseed(most > 0, undrivable)
        if not self.ready.scenario.traffic:
            again = [u.vehicle_id for u in undrivable] if self.round <= most else []
        for vehicle in again:
            self.limits[vehicle] = self.limits[vehicle].tightened()
            self.tightened[vehicle] = self.tightened.get(vehicle, 0) + 1
        given_up = {
            u.vehicle_id: ("undrivable", f"in time unit {u.unit}: {u.detail}")
            for u in undrivable
            if u.vehicle_id not in again
        }
        if given_up and self.ready.scenario.traffic:
            self.pending = given_up
            return True
        return bool(again)

    def _yield_to_conflicts(self, corridors: Corridors) -> bool:
        """Narrow the cars' headings, lower the gaps, then freeze the fewest; whether any of it helps."""
        if not self.ready.scenario.traffic:  # only who was handed over has headings to narrow
            return self.config.corridors.formulation != "paper" and self.ready.narrow(corridors.culprits)
        if self.ready.narrow(corridors.culprits) or self.ready.lower_gaps(corridors.culprits):
            return True
        names = least_cover(corridors.culprits, self.ready.scenario.participants)
        for name in names:
            others = sorted({o for pair in corridors.culprits if name in pair for o in pair} - {name})
            detail = "no way past " + ", ".join(others) if others else corridors.reason
            if others and corridors.status is SolveStatus.LIMIT:
                detail += " was found, planned one after the other"
            self.pending[name] = ("no_relation" if others else "no_corridor", detail)
        return bool(names)

    def _laterals(self, found: tuple[Trajectory, ...]) -> tuple[Lateral, ...]:
        """How trajectories keep their lateral bounds; most are those of the round before."""
        kept = []
        for trajectory, participant in zip(found, self.ready.scenario.participants, strict=True):
            key = (trajectory.vehicle_id, trajectory.states.tobytes())
            if participant.lateral is not None and key not in self._beside:
                self._beside[key] = _lateral(trajectory, participant.lateral)
            if key in self._beside:
                kept.append(self._beside[key])
        return tuple(kept)

    def _strays(self, found: tuple[Trajectory, ...]) -> bool:
        """In traffic, have whoever goes too far sideways planned with more room, then freeze it."""
        self.lateral = self._laterals(found)
        again = False
        for kept in self.lateral:
            name, short = kept.vehicle_id, _LATERAL_RESERVE_M - kept.margin_m
            if short <= 0.0:
                continue
            if self.strayed.get(name, 0) < self.config.trajectories.feedback_rounds:
                self.strayed[name] = self.strayed.get(name, 0) + 1
                limits = self.limits[name]
                self.limits[name] = replace(limits, room_m=limits.room_m + short + _LATERAL_RESERVE_M)
                again = True
            else:
                self.pending[name] = _astray(kept)
        return again or bool(self.pending)

    def _plan(
        self,
        status: WindowStatus,
        reason: str,
        corridors: Corridors | None,
        *,
        trajectories: tuple[Trajectory, ...] = (),
        undrivable: tuple[Undrivable, ...] = (),
    ) -> WindowPlan:
        ready = self.ready
        return WindowPlan(
            scenario=ready.scenario,
            status=status,
            reason=reason,
            guidance=ready.guidance,
            corridors=corridors,
            trajectories=trajectories,
            undrivable=undrivable,
            rounds=max(1, self.round),
            records=tuple(self.records),
            seconds=self.seconds,
            frozen=tuple(ready.frozen),
            vehicle_gap_m=ready.vehicle_gap_m,
            obstacle_gap_m=ready.obstacle_gap_m,
            lateral=self.lateral if trajectories else (),
        )

    def _after(self) -> str:
        return "" if self.round == 1 else f" (after {self.round} rounds)"


def _lateral(trajectory: Trajectory, bound: LateralBound) -> Lateral:
    """How a trajectory keeps its lateral bound, between its knots too."""
    size, times = trajectory.dimensions, trajectory.times_s
    dense, _, _ = dense_motion(
        trajectory.states[0],
        trajectory.controls,
        float(times[1] - times[0]),
        size.wheelbase_m,
        _LATERAL_STEP_S,
    )
    states = np.vstack([dense[:, :-1].reshape(-1, 6), dense[-1, -1]])
    centres = shift_along(states[:, 0], states[:, 1], states[:, 2], size.rear_axle_to_centre_m)
    poses = np.column_stack([centres, states[:, 2]])
    return lateral(trajectory.vehicle_id, bound, poses, (size.length_m, size.width_m))


def _astray(kept: Lateral) -> tuple[str, str]:
    """Reason and detail of a plan beyond its lateral bound."""
    if kept.bound == ROAD:
        return "off_the_road", f"its plan comes within {kept.margin_m:.2f} m of the road's edge"
    most = kept.excursion_m + kept.margin_m
    detail = f"its plan leaves the recorded path by {kept.excursion_m:.2f} m, more than {most:.2f} m"
    return "off_the_path", detail


def _undrivable_text(undrivable: Undrivable) -> str:
    return f"{undrivable.vehicle_id} in time unit {undrivable.unit}: {undrivable.detail}"


def _exclusion_text(scenario: Scenario) -> str:
    if not scenario.excluded:
        return "none is present"
    return "; ".join(f"{e.vehicle_id}: {e.detail}" for e in scenario.excluded[:5])
