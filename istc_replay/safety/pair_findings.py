"""Findings of pairs of bodies: measures past thresholds, and post-encroachment times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from istc_replay.config import HARDEST_BRAKING_MPS2, AuditConfig
from istc_replay.datatypes import FloatArray
from istc_replay.safety.bodies import Body
from istc_replay.safety.events import Event, find_events, longest_bridge_ns
from istc_replay.safety.findings import Finding, make_finding
from istc_replay.safety.pair_samples import Encroachments, Pairs
from istc_replay.safety.relation import CONFLICT_TYPES
from istc_replay.safety.rules import PAIR_RULES, PET_RULE, Rule
from istc_replay.units import NS_PER_S

IntArray = NDArray[np.int64]

#: Boxes nearer than this touch, but for rounding [m].
_TOUCHING_M = 1e-6
#: Rules that predict straight lines.
_STRAIGHT = ("ttc", "drac", "required_deceleration")
#: Who followed this long before paths part was following.
_PARTED_NS = 2 * NS_PER_S


def pair_findings(
    pairs: Pairs, bodies: list[Body], spans: list[IntArray], period_ns: float, audit: AuditConfig
) -> list[Finding]:
    """Findings of pairs of bodies, but for the post-encroachment times."""
    found = []
    bridge = np.full(pairs.time_ns.size, longest_bridge_ns(period_ns, audit))
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
    """Findings of post-encroachment times; positive where the first named body was there first.

    Parameters
    ----------
    left, pairs : Encroachments, Pairs
        The places that one left to the other, and what was sampled of the pairs.
    bodies : list of Body
        Who was recorded.
    spans : list of (n, 2) arrays
        Spans of doubtful data of each body [ns].
    period_ns : float
        Median step of the common times [ns].
    audit : AuditConfig
        The thresholds.
    """
    seconds = (left.later_ns - left.earlier_ns) / NS_PER_S
    levels = np.array([level for _, level, _ in PET_RULE.thresholds(audit)])
    bridge = longest_bridge_ns(period_ns, audit)
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
