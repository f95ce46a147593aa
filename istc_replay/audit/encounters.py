"""Encounters: what happened between two bodies while they had findings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from istc_replay.audit.bodies import Body
from istc_replay.audit.findings import Finding, judged_values
from istc_replay.audit.pair_samples import Encroachments, Pairs
from istc_replay.audit.relation import CONFLICT_TYPES
from istc_replay.audit.rules import SEVERITIES
from istc_replay.audit_config import AuditConfig
from istc_replay.datatypes import FloatArray, Verdict
from istc_replay.units import NS_PER_S


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
    period_ns: float,
    audit: AuditConfig,
) -> list[dict[str, object]]:
    """Rows of ENCOUNTERS_SCHEMA."""
    measures = {
        rule: judged_values(pairs, rule, audit)
        for rule in ("ttc", "drac", "required_deceleration", "thw", "rss")
    }
    edges = np.searchsorted(pairs.key, [_key(group) for group in groups])
    ends = np.searchsorted(pairs.key, [_key(group) for group in groups], side="right")
    rows = []
    for group, start, end in zip(groups, edges.tolist(), ends.tolist(), strict=True):
        times = pairs.time_ns[start:end]
        inside = slice(
            start + int(np.searchsorted(times, group.start_ns)),
            start + int(np.searchsorted(times, group.end_ns, side="right")),
        )
        worst = group.worst()
        severity = max((_rank(finding) for finding in group.findings), default=-1)
        at = (
            inside.start + int(np.argmin(np.abs(pairs.time_ns[inside] - worst.worst_ns)))
            if inside.stop > inside.start
            else -1
        )
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
                **_extremes(pairs, measures, inside),
                **_exposure(pairs, measures["ttc"], inside, period_ns, audit),
                **_at_worst(pairs, at, audit),
                **_encroachment(group, left, period_ns),
                "rules": sorted({finding.rule for finding in group.findings}),
            }
        )
    return rows


def _extremes(pairs: Pairs, measures: dict[str, FloatArray], inside: slice) -> dict[str, object]:
    gap = pairs["gap_m"][inside]
    least = int(np.nanargmin(gap)) if np.isfinite(gap).any() else -1
    return {
        "least_gap_m": float(gap[least]) if least >= 0 else None,
        "least_gap_ns": int(pairs.time_ns[inside][least]) if least >= 0 else None,
        "least_ttc_s": _extreme(measures["ttc"][inside], -1),
        "most_drac_mps2": _extreme(measures["drac"][inside], 1),
        "most_required_mps2": _extreme(measures["required_deceleration"][inside], 1),
        "least_thw_s": _extreme(measures["thw"][inside], -1),
        "least_rss_margin_m": _extreme(measures["rss"][inside], -1),
    }


def _extreme(values: FloatArray, sign: int) -> float | None:
    values = values[~np.isnan(values)]
    if not values.size:
        return None
    return float(values.max() if sign > 0 else values.min())


def _exposure(
    pairs: Pairs, ttc: FloatArray, inside: slice, period_ns: float, audit: AuditConfig
) -> dict[str, object]:
    """TET and TIT (Minderhoud and Bovy): each sample stands for the step to the next."""
    times = pairs.time_ns[inside]
    step = np.minimum(np.diff(times, append=times[-1:] + int(period_ns)), period_ns) / NS_PER_S
    short = ttc[inside] < audit.exposure_ttc_s
    lacking = np.where(short, audit.exposure_ttc_s - ttc[inside], 0.0)
    return {"tet_s": float(step[short].sum()), "tit_s2": float((lacking * step).sum())}


def _at_worst(pairs: Pairs, row: int, audit: AuditConfig) -> dict[str, object]:
    if row < 0:
        return {}
    changes = [float(pairs[f"delta_v_{which}_mps"][row]) for which in ("first", "second")]
    kind, most = int(pairs["conflict_type"][row]), max(changes)
    consequence = None
    if most >= audit.delta_v_critical_mps:
        consequence = "critical"
    elif most >= audit.delta_v_serious_mps:
        consequence = "serious"
    return {
        "conflict_type": CONFLICT_TYPES[kind] if kind >= 0 else None,
        "delta_v_first_mps": changes[0],
        "delta_v_second_mps": changes[1],
        "consequence": consequence,
    }


def _encroachment(group: Group, left: Encroachments, period_ns: float) -> dict[str, object]:
    """The least post-encroachment time of the pair, and that of the event: at the last place left."""
    one, two = group.bodies
    ours = ((left.first == one) & (left.second == two)) | ((left.first == two) & (left.second == one))
    ours &= (left.earlier_ns >= group.start_ns) & (left.earlier_ns <= group.end_ns)
    rows = np.flatnonzero(ours)
    if rows.size == 0:
        return {}
    seconds = (left.later_ns[rows] - left.earlier_ns[rows]) / NS_PER_S
    sign = np.where(left.first[rows] == one, 1.0, -1.0)
    least = int(np.argmin(seconds))
    same = np.flatnonzero(sign == sign[least])
    last = int(same[np.argmax(left.earlier_ns[rows][same])])
    return {
        "least_pet_s": float(sign[least] * seconds[least]),
        "event_pet_s": float(sign[last] * seconds[last]),
        "pet_resolution_s": period_ns / NS_PER_S,
    }


def _key(group: Group) -> int:
    return group.bodies[0] * (1 << 32) + group.bodies[1]


def _rank(finding: Finding) -> int:
    return SEVERITIES.index(finding.severity) if finding.severity else -1
