"""Encounters: what happened between two bodies while they had findings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from istc_replay.config import AuditConfig
from istc_replay.datatypes import FloatArray, Verdict
from istc_replay.safety.bodies import Body
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.findings import Finding
from istc_replay.safety.pair_findings import judged_values
from istc_replay.safety.pair_samples import Encroachments, Pairs
from istc_replay.safety.relation import CONFLICT_TYPES, conflict_angle, conflict_type, delta_v
from istc_replay.safety.rules import SEVERITIES
from istc_replay.units import NS_PER_S, median_step

IntArray = NDArray[np.int64]

#: Encounters looked at in one go.
_BLOCK = 2_000


@dataclass(frozen=True, slots=True)
class Group:
    """Findings of one pair that follow each other closely."""

    bodies: tuple[int, int]
    start_ns: int
    end_ns: int
    findings: tuple[Finding, ...]

    def identity(self, bodies: list[Body]) -> str:
        """The id of its severest finding."""
        return "e" + self.worst().identity(bodies)

    def worst(self) -> Finding:
        """The severest finding, the earliest of equals, trusted ones first."""
        return min(self.findings, key=lambda f: (-_rank(f), f.verdict != Verdict.FAIL, f.worst_ns, f.rule))


def group_findings(findings: list[Finding], audit: AuditConfig) -> list[Group]:
    """Group the findings of pairs: those closer in time than the pause are one encounter."""
    pause = audit.encounter_pause_s * NS_PER_S
    groups: list[Group] = []
    for finding in sorted(findings, key=lambda f: (f.bodies, f.start_ns, f.end_ns, f.rule)):
        pair = (finding.bodies[0], finding.bodies[-1])
        last = groups[-1] if groups else None
        if last and last.bodies == pair and finding.start_ns - last.end_ns <= pause:
            end = max(last.end_ns, finding.end_ns)
            groups[-1] = Group(pair, last.start_ns, end, (*last.findings, finding))
        else:
            groups.append(Group(pair, finding.start_ns, finding.end_ns, (finding,)))
    return groups


def encounter_rows(
    groups: list[Group],
    pairs: Pairs,
    left: Encroachments,
    bodies: list[Body],
    times_ns: IntArray,
    audit: AuditConfig,
) -> list[dict[str, object]]:
    """Rows of ENCOUNTERS_SCHEMA.

    Parameters
    ----------
    groups : list of Group
        One an encounter.
    pairs, left : Pairs, Encroachments
        What was sampled of all pairs, and the places that one left to the other.
    bodies : list of Body
        Who was recorded.
    times_ns : (n,) array
        The common times of all bodies [ns].
    audit : AuditConfig
        The thresholds.
    """
    measures = {
        rule: judged_values(pairs, rule, audit)
        for rule in ("ttc", "drac", "required_deceleration", "thw", "rss")
    }
    period_s = median_step(times_ns) / NS_PER_S
    left_keys, pair_keys = left.key, pairs.key
    keys = [group.bodies[0] * (1 << 32) + group.bodies[1] for group in groups]
    starts, ends = (np.searchsorted(pair_keys, keys, side=side) for side in ("left", "right"))
    rows = []
    for k, (group, start, end) in enumerate(zip(groups, starts.tolist(), ends.tolist(), strict=True)):
        if k % _BLOCK == 0:
            meetings = _meetings(groups[k : k + _BLOCK], bodies, times_ns, audit)
        own = pairs.time_ns[start:end]
        inside = slice(
            start + int(np.searchsorted(own, group.start_ns)),
            start + int(np.searchsorted(own, group.end_ns, side="right")),
        )
        worst = group.worst()
        severity = max((_rank(finding) for finding in group.findings), default=-1)
        met = _encroachment(group, left, left_keys, period_s)
        rows.append(
            {
                "encounter_id": group.identity(bodies),
                "first": bodies[group.bodies[0]].name,
                "second": bodies[group.bodies[1]].name,
                "verdict": worst.verdict.value,
                "severity": SEVERITIES[severity] if severity >= 0 else None,
                "start_ns": group.start_ns,
                "worst_ns": worst.worst_ns,
                "end_ns": group.end_ns,
                "x_m": worst.x_m,
                "y_m": worst.y_m,
                "least_ttc_s": _extreme(measures["ttc"][inside], -1),
                "most_drac_mps2": _extreme(measures["drac"][inside], 1),
                "most_required_mps2": _extreme(measures["required_deceleration"][inside], 1),
                "least_thw_s": _extreme(measures["thw"][inside], -1),
                "least_rss_margin_m": _extreme(measures["rss"][inside], -1),
                **_exposure(pairs.time_ns[inside], measures["ttc"][inside], period_s, audit),
                **_meeting(k % _BLOCK, group, met.pop("angle_rad", None), meetings, audit),
                **met,
                "rules": sorted({finding.rule for finding in group.findings}),
            }
        )
    return rows


def _extreme(values: FloatArray, sign: int) -> float | None:
    values = values[~np.isnan(values)]
    if not values.size:
        return None
    return float(values.max() if sign > 0 else values.min())


def _exposure(times_ns: IntArray, ttc: FloatArray, period_s: float, audit: AuditConfig) -> dict[str, object]:
    """TET and TIT (Minderhoud and Bovy): each sample stands for the step to the next."""
    step = np.minimum(np.diff(times_ns) / NS_PER_S, period_s)
    step = np.append(step, period_s) if times_ns.size else step
    short = ttc < audit.exposure_ttc_s
    lacking = np.where(short, audit.exposure_ttc_s - ttc, 0.0)
    return {"tet_s": float(step[short].sum()), "tit_s2": float((lacking * step).sum())}


@dataclass(frozen=True, slots=True, eq=False)
class _Meetings:
    """Both bodies of many encounters at the common times, one encounter after the other.

    Encounter k has the rows `edges[k]` to `edges[k + 1]`; (n,) or, of either body, (2, n, ...).
    """

    edges: IntArray
    times_ns: IntArray
    boxes: FloatArray
    courses_rad: FloatArray
    velocities: FloatArray
    gap_m: FloatArray


def _meetings(groups: list[Group], bodies: list[Body], times_ns: IntArray, audit: AuditConfig) -> _Meetings:
    # How near they came shows only once the prediction has run out.
    pause = round(audit.encounter_pause_s * NS_PER_S)
    first = np.searchsorted(times_ns, [group.start_ns for group in groups])
    last = np.searchsorted(times_ns, [group.end_ns + pause for group in groups], side="right")
    edges = np.concatenate([[0], np.cumsum(last - first)])
    group = np.repeat(np.arange(len(groups)), last - first)
    times = times_ns[np.arange(edges[-1]) - edges[group] + first[group]]
    boxes, speeds = np.full((2, times.size, 5), np.nan), np.full((2, times.size), np.nan)
    for side in (0, 1):
        who = np.array([g.bodies[side] for g in groups], dtype=np.int64)[group]
        order = np.argsort(who, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(who[order])) + 1):
            if rows.size:
                boxes[side, rows], speeds[side, rows] = bodies[int(who[rows[0]])].boxes(times[rows])
    heading = boxes[..., 2]
    velocities = np.stack([np.cos(heading), np.sin(heading)], axis=-1) * speeds[..., None]
    courses = heading + np.where(speeds < 0.0, np.pi, 0.0)
    return _Meetings(edges, times, boxes, courses, velocities, box_gap(boxes[0], boxes[1]))


def _meeting(
    k: int, group: Group, met_rad: float | None, meetings: _Meetings, audit: AuditConfig
) -> dict[str, object]:
    """The least gap until the pause after it, and how the two met when it was worst."""
    start, end = int(meetings.edges[k]), int(meetings.edges[k + 1])
    gap, times = meetings.gap_m[start:end], meetings.times_ns[start:end]
    known = np.flatnonzero(np.isfinite(gap))
    if known.size == 0:
        return {}
    least = int(known[np.argmin(gap[known])])
    row = start + int(known[np.argmin(np.abs(times[known] - group.worst().worst_ns))])
    at = slice(row, row + 1)
    relative = meetings.velocities[1, at] - meetings.velocities[0, at]
    changes = [float(change[0]) for change in delta_v(meetings.boxes[0, at], meetings.boxes[1, at], relative)]
    courses = meetings.courses_rad[:, at]
    angle = conflict_angle(courses[0], courses[1]) if met_rad is None else np.array([met_rad])
    kind = int(conflict_type(angle, (audit.rear_end_rad, audit.crossing_rad, audit.head_on_rad))[0])
    consequence = None
    if max(changes) >= audit.delta_v_serious_mps:
        consequence = "critical" if max(changes) >= audit.delta_v_critical_mps else "serious"
    return {
        "least_gap_m": float(gap[least]),
        "least_gap_ns": int(times[least]),
        "conflict_type": CONFLICT_TYPES[kind] if kind >= 0 else None,
        "delta_v_first_mps": changes[0],
        "delta_v_second_mps": changes[1],
        "consequence": consequence,
    }


def _encroachment(group: Group, left: Encroachments, keys: IntArray, period_s: float) -> dict[str, Any]:
    """The least post-encroachment time of the pair, and that of the event: at the last place left."""
    one, two = group.bodies
    rows = np.concatenate(
        [_within(left, keys, first, second, group) for first, second in ((one, two), (two, one))]
    )
    if rows.size == 0:
        return {}
    seconds = (left.later_ns[rows] - left.earlier_ns[rows]) / NS_PER_S
    sign = np.where(left.first[rows] == one, 1.0, -1.0)
    least = int(np.argmin(seconds))
    same = np.flatnonzero(sign == sign[least])
    last = int(same[np.argmax(left.earlier_ns[rows][same])])
    found = {
        "least_pet_s": float(sign[least] * seconds[least]),
        "event_pet_s": float(sign[last] * seconds[last]),
        "pet_resolution_s": period_s,
    }
    if group.worst().rule == "pet":
        found["angle_rad"] = float(left.angle_rad[rows[least]])
    return found


def _within(left: Encroachments, keys: IntArray, first: int, second: int, group: Group) -> IntArray:
    """Rows of one body first and the other second that begin within the encounter."""
    start, end = np.searchsorted(keys, [first * (1 << 32) + second, first * (1 << 32) + second + 1]).tolist()
    earlier = left.earlier_ns[start:end]
    low, high = np.searchsorted(earlier, [group.start_ns, group.end_ns + 1]).tolist()
    return np.arange(start + low, start + high)


def _rank(finding: Finding) -> int:
    return SEVERITIES.index(finding.severity) if finding.severity else -1
