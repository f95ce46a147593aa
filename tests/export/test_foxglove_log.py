"""The log panel's lines: verdicts, who is left out, failed checks, findings."""

from __future__ import annotations

from dataclasses import replace

import polars as pl
import pytest

from istc_replay.datatypes import Certificate, Exclusion, Log, Verdict, WindowPlan, WindowStatus
from istc_replay.export.foxglove_log import log_messages
from istc_replay.states import FINDINGS_SCHEMA

Plan = tuple[Log, list[WindowPlan]]
INFO, WARNING, ERROR = 2, 3, 4


def findings(**columns: object) -> pl.DataFrame:
    """One finding."""
    row = {
        **dict.fromkeys(FINDINGS_SCHEMA),
        "rule": "ttc",
        "verdict": "fail",
        "severity": "critical",
        "vehicles": ["a", "b"],
        "worst_ns": 1_500_000_000,
        "value": 0.42,
        "unit": "s",
        "topic": "/odom/a",
        "message_index": 17,
    }
    return pl.DataFrame([row | columns], schema=FINDINGS_SCHEMA)


@pytest.mark.parametrize(
    ("status", "level"),
    [
        (WindowStatus.CERTIFIED, INFO),
        (WindowStatus.PARTIAL, WARNING),
        (WindowStatus.GOAL_NOT_REACHED, WARNING),
        (WindowStatus.CONFLICT_LEFT, ERROR),
        (WindowStatus.NO_CORRIDORS, ERROR),
    ],
)
def test_a_windows_verdict_stands_at_its_start(
    synthetic_plan: Plan, status: WindowStatus, level: int
) -> None:
    plan = replace(synthetic_plan[1][0], status=status, reason="so it is")
    time_ns, topic, message = next(iter(log_messages([plan], {}, [], None)))
    assert (time_ns, topic) == (plan.scenario.window.start_ns, "/istc/log")
    assert message.timestamp.ToNanoseconds() == time_ns
    assert (message.level, message.name) == (level, "window 0")
    assert message.message == f"{str(status).replace('_', ' ')}: so it is"


def test_who_is_left_out_is_told_with_the_reason(synthetic_plan: Plan) -> None:
    plan = synthetic_plan[1][0]
    left = (Exclusion("x <b>\n", "no_heading", "its heading is unknown"),)
    plan = replace(plan, scenario=replace(plan.scenario, excluded=left))
    messages = [message for _, _, message in log_messages([plan], {}, [], None)]
    assert messages[1].level == WARNING
    assert messages[1].message == "x <b>\\n has no plan: no_heading: its heading is unknown"


def test_checks_that_fail_stand_at_their_witness_and_those_that_pass_are_quiet(synthetic_plan: Plan) -> None:
    plan = synthetic_plan[1][0]
    certificates = [
        Certificate(0, "separation", Verdict.FAIL, -0.25, "m", 1.5, ("a", "b"), "too near"),
        Certificate(0, "limits", Verdict.INCONCLUSIVE, None, "m"),
        Certificate(0, "complete", Verdict.PASS, 1.0, "m"),
    ]
    (_, (_, _, doubtful), (failed_ns, _, failed)) = log_messages(
        [plan], {0: plan.scenario.window.start_ns}, certificates, None
    )
    assert failed_ns == plan.scenario.window.start_ns + 1_500_000_000
    assert (failed.level, failed.message) == (ERROR, "separation: fail by -0.25 m, a and b: too near")
    assert (doubtful.level, doubtful.message) == (WARNING, "limits: inconclusive")


@pytest.mark.parametrize(
    ("severity", "level"), [("critical", ERROR), ("serious", WARNING), ("minor", INFO), (None, INFO)]
)
def test_a_finding_leads_to_the_message_that_it_rests_on(severity: str | None, level: int) -> None:
    ((time_ns, _, message),) = log_messages([], {}, [], findings(severity=severity))
    assert time_ns == 1_500_000_000
    assert (message.level, message.name) == (level, "audit")
    assert (message.file, message.line) == ("/odom/a", 17)
    assert message.message == f"{severity or 'fail'}: ttc 0.42 s, a and b"


def test_names_of_any_kind_are_short_printable_text() -> None:
    hostile = findings(
        vehicles=["\u202e" + "x" * 10_000], detail="<script>\x00", message_index=-3, topic=None
    )
    ((_, _, message),) = log_messages([], {}, [], hostile)
    assert message.message.isprintable()
    assert len(message.message) < 200
    assert "<script>" in message.message  # as text: the panel shows no markup
    assert message.line == 0
