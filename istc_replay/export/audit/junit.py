"""audit.junit.xml: a test case a rule and a check, for CI."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import polars as pl

from istc_replay.datatypes import Verdict
from istc_replay.export.audit.record import Severity, counting
from istc_replay.export.audit.xml_text import as_xml, xml_text
from istc_replay.safety.log_audit import Audit
from istc_replay.safety.rules import RULE_NAMES, SOLVER_RULE, worst_first

#: Findings that one test case lists.
_LISTED = 50


def audit_junit(audit: Audit, fail_on: Severity) -> bytes:
    """Give JUnit XML: one test case a rule; findings fail it, doubtful data are its error.

    A result has one test case a check of its plans, too.
    """
    suite = ET.Element("testsuite", name=xml_text(Path(audit.log.path).name))
    tally = {"tests": 0, "failures": 0, "errors": 0, "skipped": 0}
    found = counting(audit.findings, fail_on)
    for rule in RULE_NAMES:
        case = ET.SubElement(suite, "testcase", classname="istc-replay.audit", name=rule)
        tally["tests"] += 1
        outcome = _outcome(case, rule, audit, found)
        if outcome:
            tally[outcome] += 1
    for check in audit.certificates["check"].unique(maintain_order=True):
        case = ET.SubElement(suite, "testcase", classname="istc-replay.certificate", name=check)
        tally["tests"] += 1
        outcome = _certified(case, audit.certificates.filter(pl.col("check") == check))
        if outcome:
            tally[outcome] += 1
    for name, count in tally.items():
        suite.set(name, str(count))
    return as_xml(suite)


def _outcome(case: ET.Element, rule: str, audit: Audit, counted: pl.DataFrame) -> str:
    found = counted.filter(pl.col("rule") == rule)
    doubt = audit.findings.filter(pl.col("rule") == rule, pl.col("verdict") == Verdict.INCONCLUSIVE.value)
    verdicts = set(audit.coverage.filter(pl.col("rule") == rule)["verdict"])
    if found.height:
        _told(case, "failure", found)
        return "failures"
    if doubt.height:
        _told(case, "error", doubt)
        return "errors"
    if Verdict.INCONCLUSIVE.value in verdicts:
        ET.SubElement(case, "error", message="not judged throughout: see the coverage", type="inconclusive")
        return "errors"
    of_plans = rule == SOLVER_RULE and not audit.of_result
    if verdicts == {Verdict.NOT_APPLICABLE.value} or of_plans:
        ET.SubElement(case, "skipped", message="does not apply")
        return "skipped"
    return ""


def _certified(case: ET.Element, rows: pl.DataFrame) -> str:
    for verdict, kind, outcome in (
        (Verdict.FAIL, "failure", "failures"),
        (Verdict.INCONCLUSIVE, "error", "errors"),
    ):
        wrong = rows.filter(pl.col("verdict") == verdict.value)
        if wrong.height:
            element = ET.SubElement(case, kind, message=f"{wrong.height} windows", type=verdict.value)
            lines = [f"window {row['window']}: {row['detail']}" for row in wrong.iter_rows(named=True)]
            element.text = xml_text("\n".join(lines[:_LISTED]))
            return outcome
    if set(rows["verdict"]) == {Verdict.NOT_APPLICABLE.value}:
        ET.SubElement(case, "skipped", message="does not apply")
        return "skipped"
    return ""


def _told(case: ET.Element, kind: str, rows: pl.DataFrame) -> None:
    worst = worst_first(rows)
    lines = [
        f"{row['finding_id']} {', '.join(row['vehicles'])}: {row['value']:.6g} {row['unit']} "
        f"(threshold {row['threshold']:.6g}, {row['threshold_source']}) at {row['worst_ns']} ns, "
        f"{row['topic']} message {row['message_index']}. {row['detail']}"
        for row in worst.head(_LISTED).iter_rows(named=True)
    ]
    what = worst["severity"][0] or "inconclusive"
    element = ET.SubElement(case, kind, message=f"{rows.height} findings, {what}", type=what)
    element.text = xml_text("\n".join(lines))
