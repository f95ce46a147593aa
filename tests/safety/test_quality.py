"""Planted defects of the data: each is found as what it is, and what it touches is inconclusive."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

from istc_replay.config import Config
from istc_replay.datatypes import Verdict
from istc_replay.safety.issues import Issue, doubtful_spans, is_doubtful
from istc_replay.safety.log_audit import Audit, audit_log

from ..support.encounters import recorded
from ..support.tracks import log_of

Array = NDArray[np.float64]
NS = 1_000_000_000
T = np.arange(0, 10.01, 0.1)


def car(name: str = "a", **columns: object) -> pl.DataFrame:
    return recorded(name, T, **({"x_m": 8.0 * T, "speed_mps": 8.0} | columns))


def data(audit: Audit) -> list[str]:
    """Rules of data quality that have findings."""
    rules = audit.findings.filter(pl.col("rule").str.starts_with("data_"))
    assert set(rules["verdict"]) <= {"inconclusive"}
    assert rules["severity"].null_count() == rules.height
    return sorted(set(rules["rule"]))


def audited(*parts: pl.DataFrame) -> Audit:
    return audit_log(log_of(*parts), Config())


def test_sound_data_have_no_finding() -> None:
    noisy = 8.0 * T + np.random.default_rng(1).normal(0, 0.03, T.size)
    assert data(audited(car(x_m=noisy), car("b", y_m=30.0))) == []


def test_a_gap_is_told_and_its_span_not_judged() -> None:
    audit = audited(car().filter(~pl.int_range(pl.len()).is_between(40, 60)))
    assert data(audit) == ["data_gap"]
    row = audit.findings.row(0, named=True)
    assert row["value"] == pytest.approx(2.2)
    assert audit.verdict == Verdict.INCONCLUSIVE
    judged = audit.coverage.filter(pl.col("rule") == "ttc").row(0, named=True)
    assert (judged["verdict"], judged["recorded_s"]) == ("inconclusive", pytest.approx(10.0))
    assert judged["judged_s"] == pytest.approx(10.0 - 2.2 + 0.1)


def test_a_teleport_is_found_whether_the_speed_is_recorded_or_derived() -> None:
    jumping = 8.0 * T + np.where(T > 5.0, 6.0, 0.0)
    assert data(audited(car(x_m=jumping))) == ["data_teleport"]
    derived = np.gradient(jumping, T)
    assert "data_teleport" in data(audited(car(x_m=jumping, speed_mps=derived, derived=2)))
    assert data(audited(car(speed_mps=np.gradient(8 * T, T), derived=2))) == []


def test_vehicles_that_exchange_names_are_found() -> None:
    switched = T > 5.0
    one, two = np.where(switched, 12.0, 0.0), np.where(switched, 0.0, 12.0)
    audit = audited(car(y_m=one), car("b", y_m=two))
    assert data(audit) == ["data_id_switch"]
    assert audit.findings["vehicles"].to_list() == [["a", "b"]]


@pytest.mark.parametrize("off", [np.pi, np.pi / 2])
def test_a_heading_against_the_course_is_found(off: float) -> None:
    assert data(audited(car(heading_rad=off - 2 * np.pi * (off >= np.pi)))) == ["data_heading"]


def test_driving_backwards_is_no_contradiction() -> None:
    assert data(audited(car(heading_rad=-np.pi, speed_mps=-8.0))) == []


def test_a_frozen_pose_is_found_and_a_standing_one_is_not() -> None:
    x = 8.0 * T
    x[50:60] = x[50]
    assert "data_frozen" in data(audited(car(x_m=x)))
    assert data(audited(car(x_m=3.0, speed_mps=0.0))) == []


@pytest.mark.parametrize(
    "columns",
    [
        {"speed_mps": 8.0 * 3.6},
        {"speed_mps": 8.0 / 3.6},
        {"length_m": 450.0},
        {"length_m": 0.045},
        {"speed_mps": 800.0},
    ],
)
def test_values_in_another_unit_are_found(columns: dict[str, float]) -> None:
    audit = audited(car(**columns))
    assert "data_units" in data(audit)
    assert set(audit.findings["verdict"]) == {"inconclusive"}


def test_a_changing_size_is_found() -> None:
    assert data(audited(car(length_m=np.where(T > 4, 4.5, 4.2)))) == ["data_dimensions"]
    assert data(audited(car(length_m=np.where(T > 4, 4.5, 4.45)))) == []


def test_boxes_that_overlap_from_the_first_state_on_are_no_collision() -> None:
    audit = audited(car(), car("b", x_m=8.2 * T + 4.0, speed_mps=8.2))
    assert "data_overlap" in data(audit)
    gap = audit.findings.filter(pl.col("rule") == "gap")
    assert set(gap["verdict"]) == {"inconclusive"}
    assert "data in doubt: a, b" in gap["detail"][0]


def test_stamps_that_go_back_or_repeat_are_found_in_the_files_order() -> None:
    times = pl.col("time_ns")
    late = pl.col("message_index") >= 50
    backwards = car().with_columns(time_ns=pl.when(late).then(times - NS).otherwise(times))
    audit = audited(backwards)
    assert "data_stamps" in data(audit)
    row = audit.findings.filter(pl.col("rule") == "data_stamps").row(0, named=True)
    assert row["value"] == pytest.approx(0.9)
    again = car().with_columns(
        time_ns=pl.when(pl.col("message_index") == 50).then(times - NS // 10).otherwise(times)
    )
    assert "data_stamps" in data(audited(again))


def test_steps_and_drift_of_clocks_are_found_and_latency_is_not() -> None:
    def logged(offset_s: Array) -> pl.DataFrame:
        late = pl.Series(np.round(offset_s * NS).astype(np.int64))
        return car().with_columns(log_time_ns=pl.col("log_time_ns") + late)

    jitter = np.abs(np.random.default_rng(2).normal(0.02, 0.02, T.size))
    jitter[[30, 70]] = 0.8  # two late messages
    assert data(audited(logged(jitter))) == []
    stepped = audited(logged(jitter + np.where(T > 5.05, 0.5, 0.0)))
    assert data(stepped) == ["data_clock_step"]
    row = stepped.findings.row(0, named=True)
    assert row["value"] == pytest.approx(0.5, abs=0.05)
    assert (row["topic"], row["message_index"]) == ("/a", 51)
    drifting = audited(logged(0.03 * T))
    assert data(drifting) == ["data_clock_drift"]
    assert drifting.findings["value"][0] == pytest.approx(30_000, rel=0.01)


def test_what_defects_touch_is_inconclusive_and_the_rest_is_not() -> None:
    # Two brake hard; the pose of one of them freezes while it does.
    speed = np.clip(20 - 7 * (T - 4), 0, 20)
    x = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 20)])
    frozen = x.copy()
    frozen[45:50] = frozen[45]
    audit = audited(car(x_m=x, speed_mps=speed), car("b", x_m=frozen, speed_mps=speed, y_m=50.0))
    braking = audit.findings.filter(pl.col("rule") == "braking")
    assert dict(zip(braking["vehicles"].list.first(), braking["verdict"], strict=True)) == {
        "a": "fail",
        "b": "inconclusive",
    }
    affected = audit.vehicle_samples.filter(pl.col("affected"))
    assert set(affected["vehicle_id"]) == {"b"}


def test_what_is_in_doubt_does_not_count_as_judged() -> None:
    frozen = 8.0 * T
    frozen[45:50] = frozen[45]
    coverage = audited(car(), car("b", x_m=frozen, y_m=50.0)).coverage.filter(pl.col("rule") == "ttc")
    sound, doubtful = coverage.sort("vehicle_id").iter_rows(named=True)
    assert (sound["affected_s"], sound["judged_s"]) == (0.0, pytest.approx(sound["recorded_s"], abs=0.11))
    assert doubtful["affected_s"] > 0.3
    total = doubtful["judged_s"] + doubtful["affected_s"]
    assert total == pytest.approx(doubtful["recorded_s"], abs=0.11)
    assert (sound["verdict"], doubtful["verdict"]) == ("pass", "inconclusive")


def test_spans_in_doubt_are_merged_and_closed() -> None:
    def issue(start: int, end: int, *, doubtful: bool = True) -> Issue:
        return Issue("data_x", (0,), start, start, end, 0.0, "", 0.0, "", "", doubtful)

    spans = doubtful_spans([issue(10, 20), issue(30, 40), issue(15, 25), issue(50, 60, doubtful=False)], 2)
    assert spans[0].tolist() == [[10, 25], [30, 40]]
    assert spans[1].shape == (0, 2)
    starts, ends = np.array([0, 0, 25, 26, 41, 55]), np.array([9, 10, 26, 29, 49, 56])
    assert is_doubtful(spans[0], starts, ends).tolist() == [False, True, True, False, False, False]
    assert not is_doubtful(spans[1], starts, ends).any()
