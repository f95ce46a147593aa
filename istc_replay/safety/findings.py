"""Findings: what is told of an event, with its place, its time and its origin."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from istc_replay.config import AuditConfig
from istc_replay.datatypes import Verdict
from istc_replay.safety.bodies import Body
from istc_replay.safety.issues import Issue, is_doubtful
from istc_replay.safety.rules import Rule

IntArray = NDArray[np.int64]


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
    """A finding of behaviour.

    What makes it less than certain is told in its detail; doubtful data make it inconclusive.

    Parameters
    ----------
    rule, audit : Rule, AuditConfig
        What was measured, and the thresholds.
    level : int
        Which of the rule's thresholds was passed, from 0 on.
    who : tuple of int
        Rows of the bodies.
    times : tuple of int
        Start, worst and end [ns].
    place : tuple of float
        x and y where it was worst [m, map frame].
    value, detail : float, str
        The worst value, in the rule's unit, and what else is known of it.
    bodies : list of Body
        Who was recorded.
    spans : list of (n, 2) arrays
        Spans of doubtful data of each body [ns].
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
