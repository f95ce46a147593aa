"""The audit as files: whole, of one truth, valid, and without markup from a log."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config
from istc_replay.datatypes import Log, StaticScene
from istc_replay.errors import ExportError
from istc_replay.export.audit import (
    audit_exit_code,
    audit_junit,
    audit_markdown,
    audit_schema,
    audit_summary,
    write_audit,
)
from istc_replay.safety.log_audit import Audit, audit_log
from istc_replay.safety.rules import RULE_NAMES
from istc_replay.states import STATES_SCHEMA, conform

ROOT = Path(__file__).resolve().parents[2]
NS = 1_000_000_000
T = np.arange(0, 8.01, 0.1)
FILES: list[Any] = ["parquet", "json", "md", "junit", "xqar", "html"]


def vehicle(name: str, **columns: Any) -> pl.DataFrame:
    times = np.round(T * NS).astype(np.int64)
    values = {
        "vehicle_id": name, "time_ns": times, "log_time_ns": times, "y_m": 0.0, "heading_rad": 0.0,
        "length_m": 4.5, "width_m": 1.9, "role": "vehicle", "topic": f"/{name}",
        "message_index": np.arange(times.size), "derived": 0,
    } | columns  # fmt: skip
    wide = {key: np.broadcast_to(np.asarray(value), times.shape) for key, value in values.items()}
    return conform(pl.DataFrame(wide), STATES_SCHEMA)


def log_of(*parts: pl.DataFrame, **changes: Any) -> Log:
    states = pl.concat(parts).sort("vehicle_id", "time_ns", maintain_order=True)
    log = Log(
        path="some/where/made.mcap", sha256="0" * 64, complete=True, messages=1, attachments=0, metadata=0,
        chunks=0, start_ns=0, end_ns=int(T[-1] * NS), channels=(), states=states, scene=StaticScene(),
        problems=(),
    )  # fmt: skip
    return replace(log, **changes)


def audited(*parts: pl.DataFrame, **changes: Any) -> Audit:
    return audit_log(log_of(*parts, **changes), Config())


def calm() -> Audit:
    return audited(vehicle("a", x_m=10 * T, speed_mps=10.0))


def crash(first: str = "a", second: str = "b") -> Audit:
    return audited(
        vehicle(first, x_m=10 * T - 40, speed_mps=10.0),
        vehicle(second, x_m=0.0, y_m=10 * T - 41, heading_rad=np.pi / 2, speed_mps=10.0),
    )


def doubtful() -> Audit:
    return audited(vehicle("a", x_m=10 * T, speed_mps=36.0))


def test_exit_codes_tell_findings_doubt_and_neither() -> None:
    assert audit_exit_code(calm(), "minor") == 0
    assert audit_exit_code(crash(), "critical") == 1
    assert audit_exit_code(doubtful(), "minor") == 3
    audit = calm()
    assert audit_exit_code(replace(audit, log=replace(audit.log, complete=False)), "minor") == 3
    tailgating = audited(
        vehicle("a", x_m=20 * T, speed_mps=20.0), vehicle("b", x_m=20 * T - 40.0, speed_mps=20.0)
    )
    assert audit_exit_code(tailgating, "minor") == 1
    assert audit_exit_code(tailgating, "serious") == 0


def check(value: Any, schema: dict[str, Any], path: str = "$") -> None:
    """As much of JSON Schema as the audit's uses."""
    kinds = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}
    if "const" in schema:
        assert value == schema["const"], path
        return
    if "enum" in schema:
        assert value in schema["enum"], path
        return
    names = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    allowed = tuple(
        kind
        for name in names
        for kind in ({"integer": (int,), "number": (int, float)}.get(name) or (kinds[name],))
    )
    assert isinstance(value, allowed), (path, value)
    if isinstance(value, dict):
        assert set(schema["required"]) == set(value) == set(schema["properties"]), path
        for key, inner in value.items():
            check(inner, schema["properties"][key], f"{path}.{key}")
    elif isinstance(value, list):
        for k, inner in enumerate(value):
            check(inner, schema["items"], f"{path}[{k}]")


@pytest.mark.parametrize("made", [calm, crash, doubtful])
def test_json_follows_its_schema_and_the_schema_is_current(made: Any) -> None:
    audit = made()
    schema = json.loads((ROOT / "schemas" / "audit.schema.json").read_text(encoding="utf-8"))
    assert schema == audit_schema(), "write schemas/audit.schema.json anew: scripts/samples"
    summary = json.loads(json.dumps(audit_summary(audit), allow_nan=False))
    check(summary, schema)
    assert len(summary["findings"]) == audit.findings.height
    assert summary["input"]["path"] == "made.mcap"


def test_junit_has_a_case_a_rule_that_findings_fail_and_doubt_breaks() -> None:
    def cases(audit: Audit) -> tuple[ET.Element, dict[str, set[str]]]:
        root = ET.fromstring(audit_junit(audit, "serious"))  # noqa: S314
        return root, {case.get("name", ""): {child.tag for child in case} for case in root}

    root, of_crash = cases(crash())
    assert list(of_crash) == list(RULE_NAMES)
    assert of_crash["gap"] == {"failure"}
    assert of_crash["speed_limit"] == {"skipped"}
    assert of_crash["braking"] == of_crash["data_gap"] == set()
    assert root.get("tests") == str(len(RULE_NAMES))
    assert int(root.get("failures", "0")) == sum("failure" in tags for tags in of_crash.values())
    _, of_doubt = cases(doubtful())
    assert of_doubt["data_units"] == {"error"}
    assert of_doubt["ttc"] == {"error"}  # nobody to meet, yet in doubt
    assert all(tags in (set(), {"skipped"}) for tags in cases(calm())[1].values())


def test_names_of_a_log_inject_no_markup() -> None:
    evil = "<script>|`x`|\n# [a](b)\x00\x1b ]]>"
    audit = crash(evil, "b")
    text = audit_markdown(audit)
    assert "<script>" not in text
    assert "\\<script\\>\\|\\`x\\`\\|" in text
    assert not any(line.startswith("# [") for line in text.splitlines())
    assert all(line.count(" | ") == 7 for line in text.splitlines() if line.startswith("| critical"))
    root = ET.fromstring(audit_junit(audit, "minor"))  # noqa: S314
    assert {case.tag for case in root} == {"testcase"}
    assert "<script>" in "".join(root.itertext())


def test_markdown_tells_the_worst_first() -> None:
    audit = crash()
    lines = audit_markdown(audit).splitlines()
    assert lines[0] == "# Audit of made.mcap: fail"
    first = next(line for line in lines if line.startswith("| ") and "severity" not in line)
    assert first.startswith("| critical |")
    assert "## In doubt" not in lines
    assert "## In doubt" in audit_markdown(doubtful())


def test_files_are_written_and_repeat_byte_for_byte(tmp_path: Path) -> None:
    audit = crash()
    files = write_audit(audit, tmp_path / "one", FILES, version="1")
    assert [path.name for path in files] == [
        "findings.parquet", "encounters.parquet", "pair_samples.parquet", "vehicle_samples.parquet",
        "coverage.parquet", "audit.json", "audit.md", "audit.junit.xml", "audit.xqar", "audit.html",
    ]  # fmt: skip
    again = write_audit(crash(), tmp_path / "two", FILES, version="1")
    assert [path.read_bytes() for path in files] == [path.read_bytes() for path in again]
    assert pl.read_parquet(files[0]).equals(audit.findings)
    with pytest.raises(ExportError, match="html, md, json"):
        write_audit(audit, tmp_path, ["pdf"], version="1")  # type: ignore[list-item]
