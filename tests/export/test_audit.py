"""The audit as files: whole, of one truth, valid, and without markup from a log."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config
from istc_replay.errors import ExportError
from istc_replay.export.audit import (
    audit_exit_code,
    audit_html,
    audit_junit,
    audit_markdown,
    audit_schema,
    audit_summary,
    audit_xqar,
    write_audit,
)
from istc_replay.export.audit.pictures import draw_timeline, recording_of
from istc_replay.safety.log_audit import Audit, audit_log
from istc_replay.safety.rules import RULE_NAMES
from istc_replay.states import CERTIFICATES_SCHEMA, conform

from ..support.tracks import log_of, track

ROOT = Path(__file__).resolve().parents[2]
NS = 1_000_000_000
T = np.arange(0, 8.01, 0.1)
FILES: list[Any] = ["parquet", "json", "md", "junit", "xqar", "html"]


def vehicle(name: str, **columns: Any) -> pl.DataFrame:
    return track(name, T, **({"length_m": 4.5, "width_m": 1.9} | columns))


def audited(*parts: pl.DataFrame, **changes: Any) -> Audit:
    return audit_log(log_of(*parts, **({"path": "some/where/made.mcap"} | changes)), Config())


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


def test_junit_has_a_case_a_check_that_a_window_fails_or_leaves_undecided() -> None:
    rows = [
        (0, "separation", "pass"), (1, "separation", "fail"), (2, "separation", "inconclusive"),
        (0, "dynamics", "pass"), (1, "dynamics", "inconclusive"),
        (0, "in_bounds", "not_applicable"), (0, "limits", "pass"), (1, "limits", "not_applicable"),
    ]  # fmt: skip
    told = [{"window": w, "check": c, "verdict": v, "detail": f"why {w}\x1b"} for w, c, v in rows]
    certificates = conform(pl.DataFrame(told), CERTIFICATES_SCHEMA)
    root = ET.fromstring(audit_junit(replace(calm(), certificates=certificates), "serious"))  # noqa: S314
    cases = {case.get("name"): case for case in root if case.get("classname") == "istc-replay.certificate"}
    assert {name: [child.tag for child in case] for name, case in cases.items()} == {
        "separation": ["failure"],
        "dynamics": ["error"],
        "in_bounds": ["skipped"],
        "limits": [],
    }
    (failure,), (error,) = cases["separation"], cases["dynamics"]
    assert (failure.get("message"), failure.text) == ("1 windows", "window 1: why 1?")
    assert (error.get("type"), error.text) == ("inconclusive", "window 1: why 1?")
    assert root.get("tests") == str(len(RULE_NAMES) + 4)
    assert (root.get("failures"), root.get("errors")) == ("1", "1")


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


def identifiers(html: str) -> list[str]:
    return re.findall(r' id="([^"]*)"', html)


def test_the_html_report_shows_every_serious_encounter_and_repeats() -> None:
    audit = crash()
    text = audit_html(audit)
    assert text == audit_html(crash())
    assert "12.7 m/s² or more" in text
    assert text.startswith("<!DOCTYPE html>")
    assert "<script" not in text
    assert not re.search(r'(?:src|href)="(?:https?:)?//', text)
    assert len(identifiers(text)) == len(set(identifiers(text)))
    severe = audit.encounters.filter(pl.col("severity").is_in(["serious", "critical"]))
    assert text.count('<section class="window"') == severe.height == 1
    assert text.count("<svg") == 1 + severe.height  # the timeline, and a picture each
    for heading in ("Timeline", "Serious encounters", "Coverage", "Thresholds"):
        assert f"<h2>{heading}</h2>" in text
    assert "✗ Findings: " in text
    assert "Nothing was found in what was judged" in audit_html(calm())
    assert "Data quality" in audit_html(doubtful())


def test_names_of_a_log_are_text_in_the_html_report() -> None:
    evil = '"><script>alert(1)</script>&\u202e'
    text = audit_html(crash(evil, "b"))
    assert "<script" not in text
    assert "\u202e" not in text
    assert "&lt;script&gt;" in text


def test_the_report_leads_to_clips_and_to_the_view_of_a_result() -> None:
    audit = crash()
    encounter = audit.encounters["encounter_id"][0]
    text = audit_html(audit, {encounter: Path("clips/a b.mcap")})
    assert 'href="clips/a%20b.mcap"' in text
    assert "view/index.html" not in text  # a log has no view
    viewed = audit_html(replace(audit, origin_ns=1_000_000_000))
    finding = audit.findings.filter(pl.col("encounter_id") == encounter).row(0, named=True)
    assert f'href="view/index.html#ns={finding["worst_ns"] - 1_000_000_000}"' in viewed
    assert f"istc-replay view RESULT --finding {finding['finding_id']}" in viewed


@pytest.mark.parametrize("made", [calm, crash, doubtful])
def test_the_reference_library_reads_the_xqar_file(made: Any, tmp_path: Path) -> None:
    qc = pytest.importorskip("qc_baselib")
    audit = made()
    path = tmp_path / "audit.xqar"
    path.write_bytes(audit_xqar(audit, "1.2"))
    read = qc.Result()
    read.load_from_file(str(path))
    (bundle,) = read.get_checker_bundle_names()
    assert read.get_checker_ids(bundle) == [f"istc_{rule}" for rule in RULE_NAMES]
    found = 0
    for rule in RULE_NAMES:
        issues = read.get_issues(bundle, f"istc_{rule}")
        rows = audit.findings.filter(pl.col("rule") == rule)
        assert len(issues) == rows.height
        found += len(issues)
        assert {issue.rule_uid for issue in issues} <= {f"istc.replay:audit:1.0.0:{rule}"}
        told = {(place.message_location[0].channel, place.message_location[0].index)
                for issue in issues for place in issue.locations}  # fmt: skip
        assert told == set(rows.select("topic", "message_index").rows())
        levels = {"critical": 1, "serious": 1, "minor": 2, None: 3}
        doubt = rows["verdict"] == "inconclusive"
        expected = [3 if d else levels[s] for d, s in zip(doubt, rows["severity"], strict=True)]
        assert sorted(int(issue.level) for issue in issues) == sorted(expected)
    assert found == audit.findings.height


def test_the_timeline_shows_the_first_and_the_last_of_very_many_findings_and_stays_small() -> None:
    audit = crash()
    many = pl.concat([audit.findings.head(1)] * 6000).with_columns(
        worst_ns=pl.int_range(6000) * int(T[-1] * NS / 5999), severity=pl.lit("critical")
    )
    figure = draw_timeline(recording_of(replace(audit, findings=many)))
    marks = next(line.get_xdata() for line in figure.axes[0].lines if len(line.get_xdata()) > 2)
    assert np.min(marks) == 0.0
    assert np.max(marks) == pytest.approx(T[-1], abs=0.02)
    assert 500 < len(marks) <= 601
