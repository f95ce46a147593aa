"""The audit as plain data: audit.json, its schema, and its tables."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Literal

import polars as pl

from istc_replay.datatypes import Verdict
from istc_replay.safety.log_audit import Audit
from istc_replay.safety.rules import SEVERITIES
from istc_replay.states import (
    AGAINST_PLAN_SCHEMA,
    CERTIFICATES_SCHEMA,
    COVERAGE_SCHEMA,
    ENCOUNTERS_SCHEMA,
    FINDINGS_SCHEMA,
)

Severity = Literal["minor", "serious", "critical"]

SCHEMA = "istc-replay.audit.v1"
_TABLES = {
    "findings": FINDINGS_SCHEMA,
    "encounters": ENCOUNTERS_SCHEMA,
    "coverage": COVERAGE_SCHEMA,
    "certificates": CERTIFICATES_SCHEMA,
    "against_plan": AGAINST_PLAN_SCHEMA,
}


def audit_tables(audit: Audit) -> dict[str, pl.DataFrame]:
    """Give an audit's tables by name; the last two where it is of a result."""
    names = ["findings", "encounters", "pair_samples", "vehicle_samples", "coverage"]
    if audit.of_result:
        names += ["certificates", "against_plan"]
    return {name: getattr(audit, name) for name in names}


def audit_exit_code(audit: Audit, fail_on: Severity) -> int:
    """Tell the exit code: 1 with findings, 3 where data are in doubt or missing, else 0.

    A certificate that fails is a finding of any severity. A log that is not complete is not
    judged whole.

    Parameters
    ----------
    audit : Audit
        The audit.
    fail_on : {"minor", "serious", "critical"}
        The least severity that counts.
    """
    certificates = set(audit.certificates["verdict"])
    if not counting(audit.findings, fail_on).is_empty() or Verdict.FAIL in certificates:
        return 1
    doubtful = audit.in_doubt > 0 or Verdict.INCONCLUSIVE in certificates
    return 3 if doubtful or not audit.log.complete or audit.verdict == Verdict.INCONCLUSIVE else 0


def counting(findings: pl.DataFrame, fail_on: Severity) -> pl.DataFrame:
    """Trusted findings at or above a severity."""
    severities = SEVERITIES[SEVERITIES.index(fail_on) :]
    return findings.filter(pl.col("verdict") == Verdict.FAIL.value, pl.col("severity").is_in(severities))


def audit_summary(audit: Audit) -> dict[str, Any]:
    """Give the audit as plain data, the same truth as the tables but for their samples.

    Floats that are infinite or not numbers are null: a time to collision of null is none.
    """
    log = audit.log
    return {
        "schema": SCHEMA,
        "input": {"path": Path(log.path).name, "sha256": log.sha256, "complete": log.complete},
        "verdict": audit.verdict.value,
        "counts": audit.counts,
        "inconclusive": audit.in_doubt,
        **{name: [_plain(row) for row in getattr(audit, name).iter_rows(named=True)] for name in _TABLES},
    }


def audit_schema() -> dict[str, Any]:
    """Give the JSON Schema of `audit_summary`."""
    count = {"type": "integer", "minimum": 0}
    properties: dict[str, Any] = {
        "schema": {"const": SCHEMA},
        "input": _record(
            {"path": {"type": "string"}, "sha256": {"type": "string"}, "complete": {"type": "boolean"}}
        ),
        "verdict": {"enum": ["pass", "fail", "inconclusive"]},
        "counts": _record(dict.fromkeys(SEVERITIES, count)),
        "inconclusive": count,
    }
    for name, schema in _TABLES.items():
        row = _record({column: _json_type(dtype) for column, dtype in schema.items()})
        properties[name] = {"type": "array", "items": row}
    top = _record(properties)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "The audit of a log", **top}


def json_bytes(value: dict[str, Any]) -> bytes:
    """JSON as a file's bytes; names that are no text become question marks."""
    return (json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode(
        "utf-8", "replace"
    )


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in row.items()
    }


def _record(properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _json_type(dtype: pl.DataType | type[pl.DataType]) -> dict[str, Any]:
    if isinstance(dtype, pl.List):
        return {"type": "array", "items": {"type": "string"}}
    kind = "integer" if dtype in (pl.Int64, pl.Int32) else "number" if dtype == pl.Float64 else "string"
    return {"type": [kind, "null"]}
