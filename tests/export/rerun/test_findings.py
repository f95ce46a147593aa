"""Findings in the view: lines that lead to their instants, marks at their places, a list."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.datatypes import Result
from istc_replay.states import FINDINGS_SCHEMA, conform

S = 1_000_000_000
Rows = list[dict[str, Any]]


@pytest.fixture
def judged(synthetic_result: Result) -> Result:
    """`synthetic_result` with three findings of one pair, two of them at once, and one of a vehicle."""
    start = synthetic_result.summary["windows"][0]["start_ns"]
    frame = synthetic_result.summary["windows"][0]["frame"]

    def row(name: str, rule: str, severity: str, who: list[str], first: float, last: float) -> dict[str, Any]:
        return {
            "finding_id": name,
            "rule": rule,
            "verdict": "fail",
            "severity": severity,
            "vehicles": who,
            "start_ns": start + int(first * S),
            "worst_ns": start + int((first + last) / 2.0 * S),
            "end_ns": start + int(last * S),
            "x_m": frame["x_m"] + 3.0,
            "y_m": frame["y_m"] - 2.0,
            "value": 0.5,
            "unit": "s",
            "threshold": 0.95,
            "detail": "<b>close</b>",
        }

    pair = ["car 1", "car 2"]
    rows = [
        row("aa", "ttc", "critical", pair, 1.0, 2.0),
        row("bb", "drac", "serious", pair, 1.5, 2.5),
        row("cc", "thw", "minor", pair, 4.0, 5.0),
        row("dd", "jerk", "minor", ["car 3"], 2.0, 2.2),
    ]
    return replace(synthetic_result, findings=conform(pl.DataFrame(rows), FINDINGS_SCHEMA))


def test_each_finding_is_a_line_at_its_worst_instant(
    judged: Result, view_of: Callable[[Result], dict[str, Rows]]
) -> None:
    lines = sorted(view_of(judged)["/events/findings"], key=lambda row: row["time"])
    assert [row["scenario_time"] / S for row in lines] == [1.5, 2.0, 2.1, 4.5]
    assert [row["TextLog:level"][0] for row in lines] == ["CRITICAL", "ERROR", "WARN", "WARN"]
    text = lines[0]["TextLog:text"][0]
    assert text == "critical: ttc 0.5 s (limit 0.95): car 1 and car 2 for 1.0 s, id aa: <b>close</b>"


def test_one_mark_tells_of_findings_of_the_same_vehicles_at_the_same_time(
    judged: Result, view_of: Callable[[Result], dict[str, Rows]]
) -> None:
    entities = view_of(judged)
    (mark,) = (r for r in entities["/now/shared/findings/aa"] if r.get("Points3D:positions"))
    np.testing.assert_allclose(mark["Points3D:positions"][0], [3.0, -2.0, 0.0], atol=1e-5)
    assert mark["Points3D:labels"] == ["critical: ttc + 1"]
    assert mark["scenario_time"] == S
    cleared = [r["scenario_time"] / S for r in entities["/now/shared/findings/aa"] if r not in (mark,)]
    assert cleared == [2.0]
    assert "/now/shared/findings/bb" not in entities
    (lifted,) = (r for r in entities["/space_time/shared/findings/aa"] if r.get("Points3D:positions"))
    assert lifted["Points3D:positions"][0][2] == pytest.approx(3.0)  # two metres a second


def test_minor_findings_are_marked_quietly(
    judged: Result, view_of: Callable[[Result], dict[str, Rows]]
) -> None:
    entities = view_of(judged)
    assert {"/now/quiet/findings/cc", "/now/quiet/findings/dd"} <= set(entities)
    assert "/now/shared/findings/cc" not in entities


def test_the_report_lists_them_worst_first_as_text(
    judged: Result, view_of: Callable[[Result], dict[str, Rows]]
) -> None:
    text = view_of(judged)["/report"][0]["TextDocument:text"][0]
    lines = [line for line in text.splitlines() if line.startswith("| **")]
    assert [line.split("|")[1].strip() for line in lines[:4]] == [
        *("**critical**", "**serious**", "**minor**", "**minor**")
    ]
    assert "car 1, car 2" in lines[0]


def test_vehicles_with_the_worst_findings_lead(
    crowd: Result, view_of: Callable[[Result], dict[str, Rows]]
) -> None:
    """Of fifty-one vehicles twelve are shown in full, those with findings before all others."""
    row = {"finding_id": "aa", "severity": "critical", "vehicles": ["316"], "start_ns": 0, "end_ns": 2**62}
    findings = conform(pl.DataFrame([row | {"worst_ns": 2**60}]), FINDINGS_SCHEMA)
    entities = view_of(replace(crowd, findings=findings))
    root = "/space_time/planned/corridors/"
    full = {path.removeprefix(root) for path in entities if path.startswith(root)}
    assert len(full) == 12
    assert "316" in full
    quiet = [path for path in entities if path.startswith("/space_time/quiet/planned/corridors/")]
    assert len(quiet) == 51 - 12
    assert len([path for path in entities if path.startswith("/now/planned/box/")]) == 51
    assert len([path for path in entities if path.startswith("/plots/speed/planned/")]) == 12
    assert "view" in entities["/report"][0]["TextDocument:text"][0]
    assert "Shown in full" in entities["/report"][0]["TextDocument:text"][0]
