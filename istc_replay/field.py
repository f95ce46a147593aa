"""Recorded traffic made ready to plan: repaired recordings, narrow headings, gaps, who stays as recorded."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from istc_replay.apart import apart_m, least_clearance_m, overlap_text, recorded_boxes
from istc_replay.datatypes import (
    Exclusion,
    FloatArray,
    Frame,
    Guidance,
    Obstacle,
    Participant,
    Scenario,
    SolveRecord,
    StartState,
    Window,
    read_only,
)
from istc_replay.guidance.build import recorded_guidance
from istc_replay.guidance.path import Path
from istc_replay.road_frame import heading_slack
from istc_replay.tracks import tightest_radius_m
from istc_replay.trajectories.repair import recorded_poses

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from istc_replay.config import Config
    from istc_replay.trajectories.repair import RecordingRepairer, RepairedMotion

#: The plan must begin this near to the recorded start [m]; the certificate allows a little more.
_START_M = 0.04
#: Gaps are this much below what was recorded, so that the recording itself keeps them [m].
_BELOW_RECORDED_M = 0.05
#: How much faster a car that was led behind its recording catches up with it.
_CATCH_UP, _CATCH_UP_MPS, _EASE_MPS2 = 1.2, 0.5, 2.0
#: A gap that was lowered below this is none [m].
_LEAST_GAP_M = 0.06
#: Near a neighbour a car may turn by this share of what would touch it, at least by the second [rad].
_NEAR_SHARE, _NEAR_LEAST_RAD = 0.8, float(np.radians(1.5))
#: A car that has no room is held this near to its heading, while it is nearer than this to the other.
_STRAIGHT_RAD, _NARROW_M = float(np.radians(0.2)), 1.0


@dataclass(slots=True)
class Field:
    """A window of traffic while it is planned.

    `guidance` is in the order of the scenario's participants. `overlaps` tells of vehicles that are
    recorded within another where both are first there: no plan can start so. `frozen` vehicles were
    taken out again and stand as obstacles in the scenario.
    """

    scenario: Scenario
    guidance: tuple[Guidance, ...]
    vehicle_gap_m: float
    obstacle_gap_m: float
    records: list[SolveRecord] = field(default_factory=list)
    overlaps: dict[str, tuple[str, str]] = field(default_factory=dict)
    frozen: list[Exclusion] = field(default_factory=list)

    def lower_gaps(self, culprits: Sequence[tuple[str, ...]]) -> bool:
        """Promise a third of the gap where a pair has no room for it, and then none; whether it changed."""
        vehicles = {p.vehicle_id for p in self.scenario.participants}
        # A vehicle that enters or leaves within a unit is an obstacle there, and a vehicle elsewhere.
        obstacles = {o.obstacle_id for o in self.scenario.obstacles}
        pairs = [pair for pair in culprits if len(pair) == 2]
        before = self.vehicle_gap_m, self.obstacle_gap_m
        if any(vehicles.issuperset(pair) for pair in pairs):
            self.vehicle_gap_m = _third(self.vehicle_gap_m)
        if any(obstacles.intersection(pair) for pair in pairs):
            self.obstacle_gap_m = _third(self.obstacle_gap_m)
        return before != (self.vehicle_gap_m, self.obstacle_gap_m)

    def narrow(self, culprits: Sequence[tuple[str, ...]]) -> bool:
        """Hold cars to their guidance's heading near whom they cannot pass; whether that changed anything.

        Layer 1 then asks for the room that the car takes as it is; layer 2 turns it only within that.
        """
        boxes = {o.obstacle_id: o.boxes_m for o in self.scenario.obstacles}
        rows = {p.vehicle_id: row for row, p in enumerate(self.scenario.participants)}
        for participant, guide in zip(self.scenario.participants, self.guidance, strict=True):
            own = recorded_boxes(participant, guide.times_s, guide.poses, self.scenario)
            within = boxes.get(participant.vehicle_id, own)
            boxes[participant.vehicle_id] = np.where(np.isnan(own), within, own)
        changed, guidance = False, list(self.guidance)
        pairs = [pair for pair in culprits if len(pair) == 2]
        for name, other in (*pairs, *(pair[::-1] for pair in pairs)):
            before = guidance[rows[name]].slack_rad if name in rows else None
            if before is None:
                continue
            near = _near(boxes[name], boxes[other], self.scenario.participants[rows[name]])
            slack = np.where(near, np.minimum(before, _STRAIGHT_RAD), before)
            changed |= bool((slack < before).any())
            guidance[rows[name]] = replace(guidance[rows[name]], slack_rad=read_only(slack))
        self.guidance = tuple(guidance)
        return changed

    def freeze(self, reasons: Mapping[str, tuple[str, str]]) -> None:
        """Leave vehicles as recorded, by reason and detail; the others plan around them."""
        kept = [p.vehicle_id not in reasons for p in self.scenario.participants]
        frozen = [p for p, keep in zip(self.scenario.participants, kept, strict=True) if not keep]
        self.guidance = tuple(g for g, keep in zip(self.guidance, kept, strict=True) if keep)
        self.scenario = _without(self.scenario, frozen)
        self.frozen += [Exclusion(p.vehicle_id, *reasons[p.vehicle_id]) for p in frozen]


def _near(own_m: FloatArray, other_m: FloatArray, participant: Participant) -> NDArray[np.bool_]:
    """Unit boundaries (K+1,) of a participant beside a unit in which two swept boxes (N, 4) are near."""
    apart = np.maximum(own_m[:, 0::2] - other_m[:, 1::2], other_m[:, 0::2] - own_m[:, 1::2]).max(axis=1)
    begin, units = participant.first_unit, participant.units
    near = np.nan_to_num(apart[begin : begin + units], nan=np.inf) < _NARROW_M
    return np.asarray(np.append(near, False) | np.insert(near, 0, False))


def _third(gap_m: float) -> float:
    return gap_m / 3.0 if gap_m > _LEAST_GAP_M else 0.0


class Repairs:
    """Repaired recordings of one window, kept for its other time units and frames.

    Parameters
    ----------
    repairer : RecordingRepairer
        Keeps the NLPs that it built.
    """

    def __init__(self, repairer: RecordingRepairer) -> None:
        self._repairer = repairer
        self._known: dict[tuple[object, ...], tuple[Frame, RepairedMotion | None]] = {}

    def of(
        self, participant: Participant, window: Window, speed_max_mps: float
    ) -> tuple[RepairedMotion | None, SolveRecord | None]:
        """The repaired motion in the window's frame, and the record of the solve where it took one."""
        first_s = participant.first_unit * window.unit_s
        key = (participant.vehicle_id, first_s, first_s + participant.units * window.unit_s, speed_max_mps)
        if key not in self._known:
            motion, record = self._repairer.repair(
                participant, window.unit_s, speed_max_mps, back_to_recording
            )
            self._known[key] = window.frame, motion
            return motion, record
        frame, motion = self._known[key]
        return None if motion is None else motion.moved(frame, window.frame), None


def prepare(scenario: Scenario, config: Config, repairs: Repairs, speed_max_mps: float) -> Field:
    """Repair the recordings of a window; a vehicle that no car could have driven becomes an obstacle.

    Parameters
    ----------
    scenario : Scenario
        A window of recorded traffic.
    config : Config
        Largest deviation, gaps.
    repairs : Repairs
        Repairs recordings, and keeps what it repaired.
    speed_max_mps : float
        Largest speed.
    """
    records, kept, guidance, excluded, dropped = [], [], [], [], []
    for participant in scenario.participants:
        motion, record = repairs.of(participant, scenario.window, speed_max_mps)
        records += [] if record is None else [record]
        detail = ""
        if motion is None:
            detail = "no drivable motion was found near it"
        elif participant.approach is None and motion.deviation_m > config.guidance.deviation_max_m:
            detail = f"the nearest drivable motion is {motion.deviation_m:.2f} m away"
            detail += _too_tight(participant, config.trajectories.steering_max_rad)
        elif participant.approach is None and _off_start_m(motion, participant) > _START_M:
            detail = "no drivable motion starts where it was recorded"
        if motion is None or detail:
            excluded.append(Exclusion(participant.vehicle_id, "undrivable_track", detail))
            dropped.append(participant)
            continue
        x, y, heading = motion.poses[0]
        start = StartState(float(x), float(y), float(heading), float(motion.driven.states[0, 4]))
        handed = participant.approach is not None
        kept.append(participant if handed else replace(participant, start=start))
        guide = recorded_guidance(participant, scenario.window.unit_s, motion.times_s, motion.poses)
        guidance.append(replace(guide, motion=motion.driven))
    scenario = replace(_without(scenario, dropped), excluded=(*scenario.excluded, *excluded))
    scenario = replace(scenario, participants=tuple(kept))
    return _narrowed(scenario, tuple(guidance), config, records)


def _too_tight(participant: Participant, steering_max_rad: float) -> str:
    """What to say of a recording that turns more tightly than a car of its size can."""
    size, recorded_m = participant.dimensions, tightest_radius_m(participant.recording.poses)
    able_m = float(np.hypot(size.wheelbase_m / np.tan(steering_max_rad), size.rear_axle_to_centre_m))
    if recorded_m >= able_m:
        return ""
    return f": it turns with a radius of {recorded_m:.1f} m, where its steering allows {able_m:.1f} m"


def back_to_recording(participant: Participant, at_s: FloatArray) -> FloatArray:
    """Poses (S, 3) at times (S,) from a start that was handed over back to the recording.

    A car that was led behind the recording (or ahead of it) follows the recorded path, a fifth and half a
    metre a second faster (or a fifth slower), until it is where it was recorded.
    """
    start, recorded = participant.start, recorded_poses(participant, at_s)
    if participant.approach is None:
        return recorded
    poses = np.vstack([participant.approach, participant.recording.poses])
    path = Path.through(poses[:, :2], poses[:, 2])
    way, _ = path.project(np.array([start.x_m, start.y_m]))
    here = path.project(recorded[0, :2])[0]
    arc = here + np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(recorded[:, :2], axis=0).T))])
    law, speed = [way], start.speed_mps
    for step, until, seconds in zip(np.diff(arc), arc[1:], np.diff(at_s), strict=True):
        # No faster than the car can speed up, no slower than it can brake with ease.
        most = min(_CATCH_UP * step + _CATCH_UP_MPS * seconds, (speed + _EASE_MPS2 * seconds) * seconds)
        least = max(step / _CATCH_UP, (speed - _EASE_MPS2 * seconds) * seconds, 0.0)
        law.append(float(np.clip(until, law[-1] + min(least, most), law[-1] + most)))
        speed = (law[-1] - law[-2]) / seconds
    targets = path.at(np.asarray(law, dtype=np.float64))
    targets[0] = start.x_m, start.y_m, start.heading_rad
    return targets


def _off_start_m(motion: RepairedMotion, participant: Participant) -> float:
    return float(np.hypot(*(motion.poses[0, :2] - participant.recording.poses[0, :2])))


def _narrowed(
    scenario: Scenario, guidance: tuple[Guidance, ...], config: Config, records: list[SolveRecord]
) -> Field:
    """Lower the gaps to what was recorded, and hold headings narrow at speed and near neighbours."""
    unit_s, participants = scenario.window.unit_s, scenario.participants
    slack = [heading_slack(np.column_stack([g.points_m, g.headings_rad]), unit_s) for g in guidance]
    least, overlaps = np.inf, dict[str, tuple[str, str]]()
    near = [np.full(p.units + 1, np.inf) for p in participants]
    for a, b in combinations(range(len(participants)), 2):
        first, second = participants[a], participants[b]
        begin = max(first.first_unit, second.first_unit)
        end = min(first.first_unit + first.units, second.first_unit + second.units)
        if end <= begin:
            continue
        apart = apart_m(first, guidance[a], second, guidance[b], begin, end)
        if apart[0] < 0.0:
            for name, other in ((first, second), (second, first)):
                overlaps[name.vehicle_id] = ("overlap_at_start", overlap_text(name, other, -apart[0]))
            continue
        least = min(least, float(apart.min()))
        per_unit = (len(apart) - 1) // (end - begin)
        for row, one in ((a, first), (b, second)):
            units = slice(begin - one.first_unit, end - one.first_unit + 1)
            near[row][units] = np.minimum(near[row][units], apart[::per_unit])
    gap = _lowered(config.corridors.vehicle_gap_m, least)
    for row, participant in enumerate(participants):
        room = _NEAR_SHARE * (near[row] - gap) / participant.dimensions.length_m
        slack[row] = np.minimum(slack[row], np.maximum(room, _NEAR_LEAST_RAD))
    narrow = tuple(replace(g, slack_rad=read_only(s)) for g, s in zip(guidance, slack, strict=True))
    clear = least_clearance_m(scenario, guidance)
    return Field(scenario, narrow, gap, _lowered(config.corridors.obstacle_gap_m, clear), records, overlaps)


def _lowered(gap_m: float, recorded_m: float) -> float:
    return float(np.clip(recorded_m - _BELOW_RECORDED_M, 0.0, gap_m))


def _without(scenario: Scenario, dropped: Sequence[Participant]) -> Scenario:
    """Turn participants into obstacles that move as recorded."""
    boxes = {
        p.vehicle_id: recorded_boxes(p, p.recording.times_s, p.recording.poses, scenario) for p in dropped
    }
    standing = {o.obstacle_id: o for o in scenario.obstacles}
    for name, swept in boxes.items():
        if name in standing:  # where it enters or leaves within a unit
            before = standing[name].boxes_m
            swept = read_only(np.where(np.isnan(swept), before, swept))
        standing[name] = Obstacle(name, swept)
    return replace(
        scenario,
        participants=tuple(p for p in scenario.participants if p.vehicle_id not in boxes),
        obstacles=tuple(standing.values()),
    )


def least_cover(pairs: Sequence[tuple[str, ...]], participants: Sequence[Participant]) -> tuple[str, ...]:
    """Vehicles without which none of the pairs is left, few and of low priority."""
    priority = {p.vehicle_id: p.priority for p in participants}
    order = {p.vehicle_id: row for row, p in enumerate(participants)}
    left = [tuple(name for name in pair if name in order) for pair in pairs]
    left = [pair for pair in left if pair]
    chosen: list[str] = []
    while left:
        names = {name for pair in left for name in pair}
        # One that is in a pair by itself has no other to give way.
        alone = {pair[0] for pair in left if len(pair) == 1}
        pick = min(
            alone or names,
            key=lambda name: (-sum(name in pair for pair in left), priority[name], -order[name]),
        )
        chosen.append(pick)
        left = [pair for pair in left if pick not in pair]
    return tuple(chosen)
