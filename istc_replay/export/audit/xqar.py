"""audit.xqar: the findings in the result format of ASAM's Quality Checker framework.

The format's levels are error (1), warning (2) and information (3): serious and critical findings
are errors, minor ones warnings, data in doubt information.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import polars as pl

from istc_replay.datatypes import Verdict
from istc_replay.export.audit.xml_text import as_xml, xml_text
from istc_replay.safety.log_audit import Audit
from istc_replay.safety.rules import RULE_NAMES, worst_first
from istc_replay.units import NS_PER_S

#: Whose rules these are, of which standard and version: the first parts of a rule's name.
_RULES = "istc.replay:audit:1.0.0"
_LEVELS = {"critical": "1", "serious": "1", "minor": "2", None: "3"}


def audit_xqar(audit: Audit, version: str) -> bytes:
    """Give the audit as one bundle with one checker a rule.

    Parameters
    ----------
    audit : Audit
        The audit.
    version : str
        That of the program.
    """
    root = ET.Element("CheckerResults", version="1.0.0")
    name = xml_text(Path(audit.log.path).name)
    bundle = ET.SubElement(
        root,
        "CheckerBundle",
        build_date="",
        description="Post-hoc safety audit of recorded traffic",
        name="istc-replay audit",
        summary=f"Verdict: {audit.verdict.value}",
        version=version,
    )
    ET.SubElement(bundle, "Param", name="InputFile", value=name)
    number = 0
    for rule in RULE_NAMES:
        rows = worst_first(audit.findings.filter(pl.col("rule") == rule))
        verdicts = set(audit.coverage.filter(pl.col("rule") == rule)["verdict"])
        # A checker that was skipped has no issues.
        skipped = verdicts == {Verdict.NOT_APPLICABLE.value} and rows.is_empty()
        checker = ET.SubElement(
            bundle,
            "Checker",
            checkerId=f"istc_{rule}",
            description=f"The rule {rule}",
            summary=f"{rows.height} findings",
            status="skipped" if skipped else "completed",
        )
        for row in rows.iter_rows(named=True):
            _issue(checker, number, rule, row)
            number += 1
        ET.SubElement(checker, "AddressedRule", ruleUID=f"{_RULES}:{rule}")
    return as_xml(root)


def _issue(checker: ET.Element, number: int, rule: str, row: dict[str, Any]) -> None:
    told = (
        f"{row['severity'] or 'in doubt'}: {', '.join(row['vehicles'])}: "
        f"{row['value']:.6g} {row['unit']}, threshold {row['threshold']:.6g} ({row['threshold_source']}). "
        f"{row['detail']} [{row['finding_id']}]"
    )
    doubtful = row["verdict"] == Verdict.INCONCLUSIVE.value
    issue = ET.SubElement(
        checker,
        "Issue",
        issueId=str(number),
        description=xml_text(told),
        level="3" if doubtful else _LEVELS[row["severity"]],
        ruleUID=f"{_RULES}:{rule}",
    )
    locations = ET.SubElement(issue, "Locations", description="The worst instant, and where it is written")
    seconds, rest = divmod(row["worst_ns"], NS_PER_S)
    time = f"{seconds}.{rest:09d}"
    if row["message_index"] is not None and row["message_index"] >= 0:
        ET.SubElement(
            locations,
            "MessageLocation",
            index=str(row["message_index"]),
            channel=xml_text(str(row["topic"])),
            time=time,
        )
    if row["x_m"] is not None and row["y_m"] is not None:
        ET.SubElement(locations, "InertialLocation", x=f"{row['x_m']:.6f}", y=f"{row['y_m']:.6f}", z="0")
    ET.SubElement(locations, "TimeLocation", time=time)
