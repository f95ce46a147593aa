"""The audit of a log as files: Parquet tables, JSON, Markdown and JUnit XML."""

from __future__ import annotations

import json
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import polars as pl

from istc_replay.datatypes import Log, Verdict
from istc_replay.errors import ExportError
from istc_replay.export.atomic import atomic_file, prepare_folder
from istc_replay.export.tables import write_tables
from istc_replay.safety.log_audit import Audit
from istc_replay.safety.rules import RULE_NAMES, SEVERITIES
from istc_replay.states import COVERAGE_SCHEMA, ENCOUNTERS_SCHEMA, FINDINGS_SCHEMA
from istc_replay.units import NS_PER_S

AuditFormat = Literal["parquet", "json", "md", "junit"]
Severity = Literal["minor", "serious", "critical"]

SCHEMA = "istc-replay.audit.v1"
#: Findings that one line of people's files lists; the tables have them all.
_LISTED = 50
#: Characters that XML 1.0 cannot hold.
_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_TABLES = {"findings": FINDINGS_SCHEMA, "encounters": ENCOUNTERS_SCHEMA, "coverage": COVERAGE_SCHEMA}


def audit_tables(audit: Audit) -> dict[str, pl.DataFrame]:
    """Give an audit's tables by name."""
    names = ("findings", "encounters", "pair_samples", "vehicle_samples", "coverage")
    return {name: getattr(audit, name) for name in names}


def audit_exit_code(audit: Audit, log: Log, fail_on: Severity) -> int:
    """Tell the exit code: 1 with findings, 3 where data are in doubt or missing, else 0.

    Parameters
    ----------
    audit : Audit
        The audit.
    log : Log
        Its log; one that is not complete is not judged whole.
    fail_on : {"minor", "serious", "critical"}
        The least severity that counts.
    """
    if not _counting(audit.findings, fail_on).is_empty():
        return 1
    doubtful = Verdict.INCONCLUSIVE.value in set(audit.findings["verdict"])
    return 3 if doubtful or not log.complete or audit.verdict == Verdict.INCONCLUSIVE else 0


def audit_summary(audit: Audit, log: Log) -> dict[str, Any]:
    """Give the audit as plain data, the same truth as the tables but for their samples.

    Floats that are infinite or not numbers are null: a time to collision of null is none.
    """
    counts = audit.findings.filter(pl.col("verdict") == Verdict.FAIL.value)["severity"]
    return {
        "schema": SCHEMA,
        "input": {"path": Path(log.path).name, "sha256": log.sha256, "complete": log.complete},
        "verdict": audit.verdict.value,
        "counts": {severity: int((counts == severity).sum()) for severity in SEVERITIES},
        "inconclusive": int((audit.findings["verdict"] == Verdict.INCONCLUSIVE.value).sum()),
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


def audit_markdown(audit: Audit, log: Log) -> str:
    """Give a summary for people, such as a page of a CI run."""
    summary = audit.findings.filter(pl.col("verdict") == Verdict.FAIL.value)
    doubt = audit.findings.filter(pl.col("verdict") == Verdict.INCONCLUSIVE.value)
    counts = ", ".join(
        f"{(summary['severity'] == severity).sum()} {severity}" for severity in reversed(SEVERITIES)
    )
    applicable = audit.coverage.filter(pl.col("verdict") != Verdict.NOT_APPLICABLE.value)
    judged, recorded = (float(applicable[name].sum()) for name in ("judged_s", "recorded_s"))
    share = f"{100.0 * judged / recorded:.0f} %" if recorded else "nothing"
    lines = [
        f"# Audit of {_cell(Path(log.path).name)}: {audit.verdict.value}",
        "",
        f"Findings: {counts}; {doubt.height} inconclusive. Judged: {share} of what the rules apply to.",
    ]
    first = log.states["time_ns"].min()
    start = first if isinstance(first, int) else 0
    for title, rows in (("Findings", summary), ("In doubt", doubt)):
        if rows.is_empty():
            continue
        lines += [
            "",
            f"## {title}",
            "",
            "| severity | rule | vehicles | at s | value | threshold | source | detail |",
        ]
        lines.append("|---|---|---|---|---|---|---|---|")
        ordered = rows.with_columns(_rank=_rank()).sort("_rank", "start_ns", descending=[True, False])
        lines += [_line(row, start) for row in ordered.head(_LISTED).iter_rows(named=True)]
        if rows.height > _LISTED:
            lines += ["", f"{rows.height - _LISTED} more are in the tables."]
    return "\n".join(lines) + "\n"


def audit_junit(audit: Audit, log: Log, fail_on: Severity) -> bytes:
    """Give JUnit XML: one test case a rule; findings fail it, doubtful data are its error."""
    counting = _counting(audit.findings, fail_on)
    suite = ET.Element("testsuite", name=_xml(Path(log.path).name))
    tally = {"tests": 0, "failures": 0, "errors": 0, "skipped": 0}
    for rule in RULE_NAMES:
        case = ET.SubElement(suite, "testcase", classname="istc-replay.audit", name=rule)
        tally["tests"] += 1
        found = counting.filter(pl.col("rule") == rule)
        doubt = audit.findings.filter(pl.col("rule") == rule, pl.col("verdict") == Verdict.INCONCLUSIVE.value)
        verdicts = set(audit.coverage.filter(pl.col("rule") == rule)["verdict"])
        if found.height:
            _told(case, "failure", found)
            tally["failures"] += 1
        elif doubt.height:
            _told(case, "error", doubt)
            tally["errors"] += 1
        elif Verdict.INCONCLUSIVE.value in verdicts:
            ET.SubElement(
                case, "error", message="not judged throughout: see the coverage", type="inconclusive"
            )
            tally["errors"] += 1
        elif verdicts == {Verdict.NOT_APPLICABLE.value}:
            ET.SubElement(case, "skipped", message="does not apply")
            tally["skipped"] += 1
    for name, count in tally.items():
        suite.set(name, str(count))
    ET.indent(suite)
    return bytes(ET.tostring(suite, encoding="utf-8", xml_declaration=True)) + b"\n"


def write_audit(
    audit: Audit, log: Log, folder: Path, formats: Sequence[AuditFormat], fail_on: Severity = "serious"
) -> list[Path]:
    """Write an audit: the tables as Parquet, audit.json, audit.md, audit.junit.xml.

    Parameters
    ----------
    audit : Audit
        The audit.
    log : Log
        Its log.
    folder : Path
        Made where it is missing.
    formats : sequence of {"parquet", "json", "md", "junit"}
        What to write.
    fail_on : {"minor", "serious", "critical"}
        The least severity that fails a JUnit test case.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    ExportError
        If a format is not one of these, or a file cannot be written.
    """
    writers: Mapping[str, tuple[str, Callable[[], bytes]]] = {
        "json": ("audit.json", lambda: _json(audit_summary(audit, log))),
        "md": ("audit.md", lambda: audit_markdown(audit, log).encode()),
        "junit": ("audit.junit.xml", lambda: audit_junit(audit, log, fail_on)),
    }
    for format_ in formats:
        if format_ not in (*writers, "parquet"):
            known = ", ".join(("parquet", *writers))
            raise ExportError(f"no format of an audit is named {format_!r}; there are {known}")
    prepare_folder(folder)
    written = []
    for format_ in formats:
        if format_ == "parquet":
            written += write_tables(audit_tables(audit), folder, ["parquet"])
            continue
        name, content = writers[format_]
        with atomic_file(folder / name) as temporary:
            temporary.write_bytes(content())
        written.append(folder / name)
    return written


def _counting(findings: pl.DataFrame, fail_on: Severity) -> pl.DataFrame:
    """Trusted findings at or above a severity."""
    severities = SEVERITIES[SEVERITIES.index(fail_on) :]
    return findings.filter(pl.col("verdict") == Verdict.FAIL.value, pl.col("severity").is_in(severities))


def _rank() -> pl.Expr:
    ranks = {severity: rank for rank, severity in enumerate(SEVERITIES)}
    return pl.col("severity").replace_strict(ranks, default=-1, return_dtype=pl.Int8)


def _json(value: dict[str, Any]) -> bytes:
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
    kind = "integer" if dtype == pl.Int64 else "number" if dtype == pl.Float64 else "string"
    return {"type": [kind, "null"]}


def _line(row: dict[str, Any], start_ns: int) -> str:
    at = (row["worst_ns"] - start_ns) / NS_PER_S
    cells = [
        row["severity"] or "-",
        row["rule"],
        " ".join(_cell(name) for name in row["vehicles"][:5]) + (" ..." if len(row["vehicles"]) > 5 else ""),
        f"{at:.2f}",
        f"{row['value']:.3g} {row['unit']}",
        f"{row['threshold']:.3g}",
        _cell(row["threshold_source"]),
        _cell(row["detail"]),
    ]
    return "| " + " | ".join(cells) + " |"


def _cell(text: str) -> str:
    """Text of a log as one cell of a table, without markup."""
    one_line = "".join(character if character.isprintable() else " " for character in text)
    return re.sub(r"([\\`*_{}\[\]<>()#+!|&~$-])", r"\\\1", one_line[:200])


def _told(case: ET.Element, kind: str, rows: pl.DataFrame) -> None:
    worst = rows.with_columns(_rank=_rank()).sort("_rank", descending=True, maintain_order=True)
    lines = [
        f"{row['finding_id']} {', '.join(row['vehicles'])}: {row['value']:.6g} {row['unit']} "
        f"(threshold {row['threshold']:.6g}, {row['threshold_source']}) at {row['worst_ns']} ns, "
        f"{row['topic']} message {row['message_index']}. {row['detail']}"
        for row in worst.head(_LISTED).iter_rows(named=True)
    ]
    what = worst["severity"][0] or "inconclusive"
    element = ET.SubElement(case, kind, message=f"{rows.height} findings, {what}", type=what)
    element.text = _xml("\n".join(lines))


def _xml(text: str) -> str:
    return _NOT_XML.sub("?", text)
