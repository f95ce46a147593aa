"""The safety audit of a log's recorded traffic: data quality, measures, findings, encounters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from istc_replay.config import Config
from istc_replay.datatypes import Log, Verdict
from istc_replay.safety.against_plan import corridor_findings
from istc_replay.safety.bodies import Body, common_times, recorded_bodies
from istc_replay.safety.clocks import Clock, check_clocks
from istc_replay.safety.encounters import encounter_rows, group_findings
from istc_replay.safety.findings import Finding, issue_findings
from istc_replay.safety.issues import Issue, doubtful_spans, is_doubtful
from istc_replay.safety.pair_findings import encroachment_findings, pair_findings
from istc_replay.safety.pair_samples import pairs_table, sample_pairs
from istc_replay.safety.quality import body_issues, clock_issues, overlap_issues
from istc_replay.safety.rules import CORRIDOR_RULE, PAIR_RULES, PET_RULE, SEVERITIES, VEHICLE_RULES
from istc_replay.safety.turning import with_turning
from istc_replay.safety.vehicle_findings import vehicle_findings, vehicle_values
from istc_replay.safety.vehicle_samples import Motion, smoothed_motion, vehicles_table
from istc_replay.states import (
    AGAINST_PLAN_SCHEMA,
    CERTIFICATES_SCHEMA,
    COVERAGE_SCHEMA,
    ENCOUNTERS_SCHEMA,
    FINDINGS_SCHEMA,
    conform,
)
from istc_replay.units import NS_PER_S, median_step

IntArray = NDArray[np.int64]

#: Rules that say nothing of vehicles that stand.
_OF_MOVING = ("curvature", "steering_rate", "side_slip")


@dataclass(frozen=True, slots=True, eq=False)
class Audit:
    """The audit of what `log` recorded by the thresholds of `config`, as tables (see `states.py`).

    `findings` and `encounters` are sorted by start, `pair_samples` and `vehicle_samples` by whom
    and time; `coverage` says of each vehicle and rule how much was judged. Of a result there are
    also the `certificates` of its plans, made anew, and what was recorded `against_plan`; of a
    log these are empty. `origin_ns` is where a result's views begin to count, None of a log.
    """

    log: Log
    config: Config
    findings: pl.DataFrame
    encounters: pl.DataFrame
    pair_samples: pl.DataFrame
    vehicle_samples: pl.DataFrame
    coverage: pl.DataFrame
    against_plan: pl.DataFrame
    certificates: pl.DataFrame
    origin_ns: int | None = None

    @property
    def verdict(self) -> Verdict:
        """Fail with a trusted finding, else inconclusive where data are in doubt, else pass."""
        verdicts = {*self.findings["verdict"], *self.certificates["verdict"]}
        if Verdict.FAIL in verdicts:
            return Verdict.FAIL
        nothing = self.coverage.is_empty() or (self.coverage["judged_s"].sum() == 0.0)
        return Verdict.INCONCLUSIVE if Verdict.INCONCLUSIVE in verdicts or nothing else Verdict.PASS

    @property
    def of_result(self) -> bool:
        """Whether a result was audited, with its plans."""
        return self.origin_ns is not None

    @property
    def counts(self) -> dict[str, int]:
        """Trusted findings by severity, least severe first."""
        trusted = self.findings.filter(pl.col("verdict") == Verdict.FAIL.value)["severity"]
        return {severity: int((trusted == severity).sum()) for severity in SEVERITIES}

    @property
    def in_doubt(self) -> int:
        """Findings that rest on doubtful data, and those of data quality."""
        return int((self.findings["verdict"] == Verdict.INCONCLUSIVE.value).sum())


# A log may hold any number: what overflows is not judged.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def audit_log(
    log: Log, config: Config, against: pl.DataFrame | None = None, clocks: list[Clock] | None = None
) -> Audit:
    """Audit the recorded traffic of a log.

    Parameters
    ----------
    log : Log
        A log as read.
    config : Config
        The section `audit` has the thresholds, `vehicles` the sizes that the log does not tell.
    against : DataFrame, optional
        What was recorded against plans (AGAINST_PLAN_SCHEMA), where there are any.
    clocks : list of Clock, optional
        Faults of stamps and clocks that are known already; by default those of the log's states.

    Returns
    -------
    Audit
        Findings of behaviour and of data quality, and all that they rest on.
    """
    audit = config.audit
    bodies = recorded_bodies(log.states, config.vehicles)
    times = common_times(bodies, audit)
    period_ns = median_step(times)
    motions = [smoothed_motion(body, audit) for body in bodies]
    pairs, left = sample_pairs(bodies, times, audit)
    pairs = with_turning(pairs, bodies, motions, audit)
    issues = clock_issues(check_clocks(log.states, audit) if clocks is None else clocks, bodies)
    issues += body_issues(bodies, motions, audit)
    issues += overlap_issues(pairs, bodies, times)
    spans = doubtful_spans(issues, len(bodies))
    of_pairs = pair_findings(pairs, bodies, spans, period_ns, audit)
    of_pairs += encroachment_findings(left, pairs, bodies, spans, period_ns, audit)
    of_vehicles = vehicle_findings(bodies, motions, spans, audit)
    against = AGAINST_PLAN_SCHEMA.to_frame() if against is None else against
    of_vehicles += corridor_findings(against, bodies, spans, audit)
    groups = group_findings(of_pairs, audit)
    encounters = encounter_rows(groups, pairs, left, bodies, times, audit)
    names = {id(finding): group.identity(bodies) for group in groups for finding in group.findings}
    findings = [*issue_findings(issues, bodies), *of_pairs, *of_vehicles]
    doubtful = [
        is_doubtful(own, body.track.times_ns, body.track.times_ns)
        for own, body in zip(spans, bodies, strict=True)
    ]
    return Audit(
        log=log,
        config=config,
        findings=_findings_table(findings, names, bodies),
        encounters=_table(encounters, ENCOUNTERS_SCHEMA, ("start_ns", "first", "second")),
        pair_samples=pairs_table(pairs, [body.name for body in bodies]),
        vehicle_samples=vehicles_table(bodies, motions, doubtful),
        coverage=_coverage(bodies, motions, doubtful, findings, issues, against, config),
        against_plan=against,
        certificates=CERTIFICATES_SCHEMA.to_frame(),
    )


def _findings_table(findings: list[Finding], names: dict[int, str], bodies: list[Body]) -> pl.DataFrame:
    rows, seen = [], Counter[str]()
    for finding in findings:
        identity = finding.identity(bodies)
        seen[identity] += 1
        topic, index = bodies[finding.bodies[0]].origin(finding.worst_ns)
        rows.append(
            {
                # The same twice, such as stamps of two topics: in the order of the topics.
                "finding_id": identity if seen[identity] == 1 else f"{identity}-{seen[identity]}",
                "rule": finding.rule,
                "verdict": finding.verdict.value,
                "severity": finding.severity,
                "vehicles": [bodies[row].name for row in finding.bodies],
                "start_ns": finding.start_ns,
                "worst_ns": finding.worst_ns,
                "end_ns": finding.end_ns,
                "x_m": finding.x_m,
                "y_m": finding.y_m,
                "value": finding.value,
                "unit": finding.unit,
                "threshold": finding.threshold,
                "threshold_source": finding.source,
                "topic": topic,
                "message_index": index,
                "encounter_id": names.get(id(finding)),
                "detail": finding.detail,
            }
        )
    return _table(rows, FINDINGS_SCHEMA, ("start_ns", "rule", "worst_ns", "finding_id"))


def _table(rows: Sequence[Mapping[str, object]], schema: pl.Schema, order: tuple[str, ...]) -> pl.DataFrame:
    table = pl.DataFrame(list(rows), schema=schema) if rows else pl.DataFrame(schema=schema)
    return conform(table, schema).sort(order, maintain_order=True)


def _coverage(
    bodies: list[Body],
    motions: list[Motion],
    doubtful: list[NDArray[np.bool_]],
    findings: list[Finding],
    issues: list[Issue],
    against: pl.DataFrame,
    config: Config,
) -> pl.DataFrame:
    audit, rows = config.audit, []
    begin = min((int(body.track.times_ns[0]) for body in bodies), default=0)
    end = max((int(body.track.times_ns[-1]) for body in bodies), default=0)
    verdicts: dict[tuple[int, str], set[Verdict]] = {}
    for finding in findings:
        for row in finding.bodies:
            verdicts.setdefault((row, finding.rule), set()).add(finding.verdict)
    gaps = {row for issue in issues if issue.rule == "data_gap" for row in issue.bodies}
    for row, (body, motion, doubt) in enumerate(zip(bodies, motions, doubtful, strict=True)):
        times = body.track.times_ns
        # Each sample stands for the step to the next, and no longer than a period.
        share = np.minimum(np.diff(times, append=times[-1:]), body.track.period_ns) / NS_PER_S
        known = np.isfinite(body.track.states).all(axis=1)
        judged = {rule.name: known for rule in (*PAIR_RULES, PET_RULE)}
        applicable = set(judged)
        for rule in VEHICLE_RULES:
            values = vehicle_values(rule, body, motion, audit) if body.is_vehicle else None
            judged[rule.name] = np.zeros(times.size, dtype=bool) if values is None else np.isfinite(values)
            too_slow = rule.name in _OF_MOVING and body.fastest_mps() <= audit.heading_speed_mps
            if values is not None and rule.thresholds(audit) and not too_slow:
                applicable.add(rule.name)
        judged[CORRIDOR_RULE.name] = known & _planned(against, body)
        if judged[CORRIDOR_RULE.name].any():
            applicable.add(CORRIDOR_RULE.name)
        for name, flags in judged.items():
            found = verdicts.get((row, name), set())
            verdict = Verdict.PASS
            if name not in applicable:
                verdict = Verdict.NOT_APPLICABLE
            elif Verdict.FAIL in found:
                verdict = Verdict.FAIL
            elif found or doubt.any() or row in gaps or not flags.any():
                verdict = Verdict.INCONCLUSIVE
            rows.append(
                {
                    "vehicle_id": body.name,
                    "rule": name,
                    "verdict": verdict.value,
                    "recorded_s": float(times[-1] - times[0]) / NS_PER_S,
                    "judged_s": float(share[flags & ~doubt].sum()),
                    "affected_s": float(share[doubt].sum()),
                    "late_start_s": float(times[0] - begin) / NS_PER_S,
                    "early_end_s": float(end - times[-1]) / NS_PER_S,
                    "dimensions_source": body.dimensions_source,
                    "detail": "a gap in its data" if row in gaps else "",
                }
            )
    return _table(rows, COVERAGE_SCHEMA, ("vehicle_id", "rule"))


def _planned(against: pl.DataFrame, body: Body) -> NDArray[np.bool_]:
    """Samples of a body within its plans."""
    times, planned = body.track.times_ns, np.zeros(body.track.times_ns.size, dtype=bool)
    spans = against.filter(pl.col("vehicle_id") == body.name).select("start_ns", "end_ns")
    for start, end in spans.iter_rows():
        planned |= (times >= start) & (times <= end)
    return planned
