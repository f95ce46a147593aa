"""One finding, found in whatever an audit has written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from istc_replay.errors import LogError, UsageError
from istc_replay.export.result_mcap import Contents, result_bytes
from istc_replay.ingest.finding_file import FoundSpan, read_finding
from istc_replay.states import FINDINGS_SCHEMA, conform

FINDINGS = conform(
    pl.DataFrame(
        {
            "finding_id": ["f1", "f2"],
            "rule": ["gap", "ttc"],
            "verdict": ["fail", "fail"],
            "vehicles": [["car 1", "car 2"], ["ü"]],
            "start_ns": [10, 30],
            "worst_ns": [15, 30],
            "end_ns": [20, 31],
            "x_m": [0.0, 1.0],
            "y_m": [0.0, 1.0],
            "value": [-0.5, 0.1],
            "unit": ["m", "s"],
            "threshold": [0.0, 1.0],
            "threshold_source": ["contact", "x"],
            "topic": ["/a", "/b"],
            "message_index": [1, 2],
            "detail": ["", ""],
        }
    ),
    FINDINGS_SCHEMA,
)


@pytest.mark.parametrize("kind", ["json", "json folder", "parquet", "result", "result folder"])
def test_a_finding_is_found_in_every_form_of_an_audit(kind: str, synthetic_plan: Any, tmp_path: Path) -> None:
    sha256 = "0" * 64
    file = {"json": "audit.json", "parquet": "findings.parquet", "result": "result.mcap"}[kind.split()[0]]
    path = tmp_path / file
    if file == "audit.json":
        path.write_text(json.dumps({"input": {"sha256": sha256}, "findings": FINDINGS.to_dicts()}))
    elif file == "findings.parquet":
        FINDINGS.write_parquet(path)
        sha256 = ""
    else:
        summary = {"input": {"sha256": sha256}}
        log = synthetic_plan[0]
        path.write_bytes(result_bytes(Contents(log, [], [], summary, "", {}, findings=FINDINGS)))
    source = tmp_path if kind.endswith("folder") else path
    assert read_finding(source, "f1") == FoundSpan(("car 1", "car 2"), 10, 20, sha256)
    assert read_finding(source, "f2") == FoundSpan(("ü",), 30, 31, sha256)
    with pytest.raises(UsageError, match=r"no finding 'f9'.*it lists f1, f2"):
        read_finding(source, "f9")


@pytest.mark.parametrize("name", ["audit.json", "findings.parquet", "result.mcap", "else"])
@pytest.mark.parametrize(
    "data", [b"", b"{}", b"[1]", b"\xff" * 50, b'{"findings": [{}], "input": {"sha256": 1}}']
)
def test_what_is_no_audit_is_refused_in_a_line(name: str, data: bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(LogError) as error:
        read_finding(tmp_path / name, "f1")
    assert "\n" not in str(error.value)
    with pytest.raises(LogError):
        read_finding(tmp_path / "missing", "f1")
