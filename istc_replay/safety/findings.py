"""From measures to findings: events past thresholds, each with its place, its time and its origin."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from istc_replay.config import HARDEST_BRAKING_MPS2, AuditConfig
from istc_replay.datatypes import FloatArray, Verdict
from istc_replay.safety.bodies import Body
from istc_replay.safety.events import Event, find_events
from istc_replay.safety.pair_samples import Encroachments, Pairs
from istc_replay.safety.quality import Issue, is_doubtful
from istc_replay.safety.relation import CONFLICT_TYPES
from istc_replay.safety.rules import PAIR_RULES, PET_RULE, VEHICLE_RULES, Rule
from istc_replay.safety.vehicle_samples import Motion
from istc_replay.units import NS_PER_S

IntArray = NDArray[np.int64]

#: Boxes nearer than this touch, but for rounding [m].
_TOUCHING_M = 1e-6
#: Rules that predict straight lines.
_STRAIGHT = ("ttc", "drac", "required_deceleration")
#: A bridge spans a sample at least, whatever the rate.
_BRIDGED_PERIODS = 1.5
#: Who followed this long before paths part was following.
_PARTED_NS = 2 * NS_PER_S


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding; `bodies` are rows of the bodies, `severity` is None for data quality."""

    rule: str
    verdict: Verdict
    severity: str | None
    bodies: tuple[int, ...]
    start_ns: int
    worst_ns: int
    end_ns: int
    x_m: float
    y_m: float
    value: float
    unit: str
    threshold: float
    source: str
    detail: str

    def identity(self, bodies: list[Body]) -> str:
        """A stable id: of the rule and its unit, who, and when it was worst."""
        who = "\x1f".join(bodies[row].name for row in self.bodies)
        return hashlib.sha256(f"{self.rule}\x1e{self.unit}\x1e{who}\x1e{self.worst_ns}".encode()).hexdigest()[
            :16
        ]


def pair_findings(
    pairs: Pairs, bodies: list[Body], spans: list[IntArray], period_ns: float, audit: AuditConfig
) -> list[Finding]:
    """Findings of pairs of bodies, but for the post-encroachment times."""
    found = []
    bridge = np.full(pairs.time_ns.size, max(audit.bridge_s * NS_PER_S, _BRIDGED_PERIODS * period_ns))
    for rule in PAIR_RULES:
        values = judged_values(pairs, rule.name, audit)
        thresholds = rule.thresholds(audit)
        least = [1 if source == "contact" else audit.least_samples for _, _, source in thresholds]
        events = find_events(
            pairs.key,
            pairs.time_ns,
            rule.badness(values),
            rule.badness(np.array([level for _, level, _ in thresholds])),
            release=rule.release(audit),
            bridge_ns=bridge,
            least_samples=np.array(least),
            reach=_reach(pairs, rule, len(thresholds)),
        )
        for event in events:
            who = (int(pairs.first[event.start]), int(pairs.second[event.start]))
            times = tuple(int(pairs.time_ns[row]) for row in (event.start, event.worst, event.end))
            place = (float(pairs["x_m"][event.worst]), float(pairs["y_m"][event.worst]))
            detail = "; ".join(_pair_notes(rule, pairs, event, bodies))
            found.append(
                make_finding(
                    rule,
                    audit,
                    event.level,
                    who,
                    times,
                    place,
                    float(values[event.worst]),
                    detail,
                    bodies,
                    spans,
                )
            )
    return found


def _reach(pairs: Pairs, rule: Rule, levels: int) -> IntArray:
    """(n,) the last level that each sample counts for: minor where arcs avoid what lines would hit."""
    straight = rule.name in _STRAIGHT and "ttc_turning_s" in pairs.values
    avoided = np.isinf(pairs["ttc_turning_s"]) if straight else np.zeros(pairs.time_ns.size, dtype=bool)
    return np.where(avoided, 0, levels - 1)


def judged_values(pairs: Pairs, rule: str, audit: AuditConfig) -> FloatArray:
    """(n,) values of a rule; NaN where it does not apply: parked, in a queue, or only grazing."""
    moving = pairs["fastest_mps"] > audit.moving_mps
    relative = pairs["relative_speed_mps"] > audit.relative_mps
    if rule == "gap":
        gap = pairs["gap_m"]
        return np.where(moving & (relative | (gap <= 0.0)), gap, np.nan)
    if rule == "thw":
        return np.where(pairs["follower_mps"] >= audit.queue_mps, pairs["thw_s"], np.nan)
    if rule == "rss":
        return np.where(pairs["fastest_mps"] >= audit.queue_mps, pairs["rss_margin_m"], np.nan)
    # What overlaps at once is a finding of the gap; what would graze may as well pass.
    real = moving & relative & (pairs["gap_m"] > _TOUCHING_M) & (pairs["silhouette_m"] > audit.grazing_m)
    if rule == "required_deceleration":
        # Head on, and where neither can brake its way out, other measures tell how near contact is.
        needed = np.fmin(pairs["required_first_mps2"], pairs["required_second_mps2"])
        braking_helps = np.isfinite(needed) & (pairs["conflict_type"] != CONFLICT_TYPES.index("head_on"))
        return np.where(real & braking_helps, needed, np.nan)
    if rule == "ttc":
        # A queue closes up at little gaps: there DRAC says whether it does so hard.
        queue = pairs["conflict_type"] == CONFLICT_TYPES.index("rear_end")
        real &= ~(queue & (pairs["fastest_mps"] < audit.queue_mps))
    return np.where(real, pairs[{"ttc": "ttc_s", "drac": "drac_mps2"}[rule]], np.nan)


def _pair_notes(rule: Rule, pairs: Pairs, event: Event, bodies: list[Body]) -> list[str]:
    worst = event.worst
    if rule.name == "gap":
        gap, bound = pairs["gap_m"][worst], pairs["gap_bound_m"][worst]
        if gap < -bound:
            return [f"collision: the boxes overlap by more than the sampling bound of {bound:.3g} m"]
        return ["possible collision: within the sampling bound"] if gap <= bound else []
    if rule.name == "thw":
        return [f"{bodies[int(pairs['follower'][worst])].name} follows"]
    notes = []
    braking = 0.0
    if rule.name == "drac":
        braking = pairs["drac_mps2"][worst]
        notes.append("of the relative motion")
    if rule.name == "required_deceleration":
        first, second = pairs["required_first_mps2"][worst], pairs["required_second_mps2"][worst]
        who, braking = (pairs.first, first) if first <= second else (pairs.second, second)
        notes.append(f"of {bodies[int(who[worst])].name} alone")
    if braking >= HARDEST_BRAKING_MPS2:
        notes.append("or more: no car brakes so hard that contact is avoided")
    if rule.name in _STRAIGHT and event.level == 0 and np.isinf(pairs["ttc_turning_s"][worst]):
        notes.append("minor, as with the yaw rates held there is no contact")
    return notes


def encroachment_findings(
    left: Encroachments,
    pairs: Pairs,
    bodies: list[Body],
    spans: list[IntArray],
    period_ns: float,
    audit: AuditConfig,
) -> list[Finding]:
    """Findings of post-encroachment times; positive where the first named body was there first."""
    seconds = (left.later_ns - left.earlier_ns) / NS_PER_S
    levels = np.array([level for _, level, _ in PET_RULE.thresholds(audit)])
    bridge = max(audit.bridge_s * NS_PER_S, _BRIDGED_PERIODS * period_ns)
    events = find_events(
        left.key,
        left.earlier_ns,
        -seconds,
        -levels,
        release=-levels[0],
        bridge_ns=np.full(seconds.size, bridge),
        least_samples=np.ones(levels.size, dtype=np.int64),
    )
    found, keys = [], pairs.key
    for event in events:
        who = (int(left.first[event.start]), int(left.second[event.start]))
        if _follows(pairs, keys, who, int(left.earlier_ns[event.start])):
            continue
        times = (
            int(left.earlier_ns[event.start]),
            int(left.later_ns[event.worst]),
            int(left.later_ns[event.start : event.end + 1].max()),
        )
        value = float(seconds[event.worst])
        detail = (
            f"{bodies[who[0]].name} first; {seconds[event.end]:.3g} s after it left the path, "
            f"within {period_ns / NS_PER_S:.3g} s"
        )
        place = (float(left.x_m[event.worst]), float(left.y_m[event.worst]))
        pair = (min(who), max(who))
        signed = value if who == pair or value == 0.0 else -value
        found.append(
            make_finding(PET_RULE, audit, event.level, pair, times, place, signed, detail, bodies, spans)
        )
    return _contacts_once(found)


def _follows(pairs: Pairs, keys: IntArray, who: tuple[int, int], time_ns: int) -> bool:
    """Whether the second follows the first before their paths part: then headway is the measure."""
    key = min(who) * (1 << 32) + max(who)
    start, end = np.searchsorted(keys, [key, key + 1]).tolist()
    before = (pairs.time_ns[start:end] <= time_ns) & (pairs.time_ns[start:end] >= time_ns - _PARTED_NS)
    return bool((before & (pairs["follower"][start:end] == who[1])).any())


def _contacts_once(found: list[Finding]) -> list[Finding]:
    """Contact is found both ways round: keep the longer of two that overlap."""
    kept: list[Finding] = []
    until: dict[tuple[int, ...], int] = {}
    for finding in sorted(found, key=lambda f: (f.start_ns, -f.end_ns, f.detail)):
        if finding.value == 0.0:
            if until.get(finding.bodies, finding.start_ns - 1) >= finding.start_ns:
                continue
            until[finding.bodies] = finding.end_ns
        kept.append(finding)
    return kept


def vehicle_findings(
    bodies: list[Body], motions: list[Motion], spans: list[IntArray], audit: AuditConfig
) -> list[Finding]:
    """Findings of single vehicles."""
    found = []
    for row, (body, motion) in enumerate(zip(bodies, motions, strict=True)):
        if not body.is_vehicle:
            continue
        times = body.track.times_ns
        bridge = max(audit.bridge_s * NS_PER_S, _BRIDGED_PERIODS * body.track.period_ns)
        for rule in VEHICLE_RULES:
            values, thresholds = vehicle_values(rule, body, motion, audit), rule.thresholds(audit)
            if values is None or not thresholds:
                continue
            levels = np.array([level for _, level, _ in thresholds])
            events = find_events(
                np.zeros(times.size, dtype=np.int64),
                times,
                values,
                levels,
                release=rule.release(audit),
                bridge_ns=np.full(times.size, bridge),
                least_samples=np.full(levels.size, audit.least_samples),
            )
            for event in events:
                when = tuple(int(times[k]) for k in (event.start, event.worst, event.end))
                place = (float(body.track.states[event.worst, 0]), float(body.track.states[event.worst, 1]))
                value = float(values[event.worst])
                found.append(
                    make_finding(rule, audit, event.level, (row,), when, place, value, "", bodies, spans)
                )
    return found


def vehicle_values(rule: Rule, body: Body, motion: Motion, audit: AuditConfig) -> FloatArray | None:
    """(S,) values of a rule of single vehicles, larger is worse; None where it does not apply."""
    speed = body.track.states[:, 3]
    if rule.name == "speed_limit":
        return None if audit.speed_limit_mps is None else np.abs(speed) - audit.speed_limit_mps
    if rule.name == "braking":
        # Slowing down is against the way it drives, forwards or backwards.
        values = -motion.acceleration_mps2 * np.where(speed < 0.0, -1.0, 1.0)
        return np.where(np.isfinite(values), values, np.nan)
    values = np.abs(getattr(motion, rule.column))
    return np.where(np.isfinite(values), values, np.nan)


def issue_findings(issues: list[Issue], bodies: list[Body]) -> list[Finding]:
    """Data quality as findings: inconclusive, without severity."""
    found = []
    for issue in issues:
        track = bodies[issue.bodies[0]].track
        row = max(int(np.searchsorted(track.times_ns, issue.worst_ns, side="right")) - 1, 0)
        place = track.states[row, :2]
        found.append(
            Finding(
                issue.rule,
                Verdict.INCONCLUSIVE,
                None,
                issue.bodies,
                issue.start_ns,
                issue.worst_ns,
                issue.end_ns,
                float(place[0]),
                float(place[1]),
                issue.value,
                issue.unit,
                issue.threshold,
                issue.source,
                issue.detail,
            )
        )
    return found


def make_finding(
    rule: Rule,
    audit: AuditConfig,
    level: int,
    who: tuple[int, ...],
    times: tuple[int, ...],
    place: tuple[float, float],
    value: float,
    detail: str,
    bodies: list[Body],
    spans: list[IntArray],
) -> Finding:
    """A finding of behaviour; `level` is one of the rule's thresholds, `times` start, worst and end.

    What makes it less than certain is told in its detail; doubtful data make it inconclusive.
    """
    severity, threshold, source = rule.thresholds(audit)[level]
    notes = [detail] if detail else []
    start, worst, end = times
    doubtful = [row for row in who if is_doubtful(spans[row], np.array([start]), np.array([end]))[0]]
    if doubtful:
        notes.append("data in doubt: " + ", ".join(bodies[row].name for row in doubtful))
    if any(end >= bodies[row].track.times_ns[-1] for row in who):
        notes.append("cut off by the end of a track: its worst may be unseen")
    if any(start <= bodies[row].track.times_ns[0] for row in who):
        notes.append("under way when a track begins")
    assumed = [bodies[row].name for row in who if bodies[row].dimensions_source == "default"]
    if assumed and len(who) > 1:
        notes.append("size assumed: " + ", ".join(assumed))
    verdict = Verdict.INCONCLUSIVE if doubtful else Verdict.FAIL
    return Finding(
        rule.name,
        verdict,
        severity,
        who,
        start,
        worst,
        end,
        *place,
        value,
        rule.unit,
        threshold,
        source,
        "; ".join(notes),
    )
