"""What a written plan lacks or says wrongly is found, and nothing that rests on it passes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from istc_replay.datatypes import Result, Verdict
from istc_replay.safety.certificate import certify, overall

from ..support.judged import (
    CONFIG,
    FAIL,
    INCONCLUSIVE,
    NS,
    OF_MOTION,
    PASS,
    cube,
    edited,
    failed,
    judge,
    knot,
    without,
)


@pytest.mark.parametrize(("k", "time_s"), [(0, 0.0), (7, 1.4), (25, 5.0)])
def test_a_missing_sample_is_found_and_nothing_else_passes(good: Result, k: int, time_s: float) -> None:
    checks = judge(without(good, "states", knot(good, "b", k)))
    assert failed(checks) == {"complete"}
    assert checks["complete"].vehicles == ("b",)
    assert checks["complete"].time_s == pytest.approx(time_s)
    for name in (*OF_MOTION, "obstacle_separation"):
        assert checks[name].verdict == INCONCLUSIVE
        assert checks[name].vehicles == ("b",)
    assert checks["cubes_disjoint"].verdict == PASS


def test_a_missing_trajectory_is_found(good: Result) -> None:
    planned = (pl.col("source") == "planned") & (pl.col("vehicle_id") == "c")
    checks = judge(without(good, "states", planned))
    assert checks["complete"].verdict == FAIL
    assert checks["complete"].vehicles == ("c",)
    assert not any(checks[name].verdict == PASS for name in OF_MOTION)
    every = judge(without(good, "states", pl.col("source") == "planned"))  # the summary claims a plan
    assert every["complete"].verdict == FAIL
    assert not any(every[name].verdict == PASS for name in OF_MOTION)


def test_a_trajectory_without_a_corridor_is_found(good: Result) -> None:
    checks = judge(without(good, "corridors", pl.col("vehicle_id") == "c"))
    assert checks["complete"].verdict == FAIL
    assert checks["cubes_disjoint"].verdict == INCONCLUSIVE
    assert overall(judge(without(good, "corridors", pl.lit(True))).values()) == FAIL


def test_a_vehicle_that_only_the_summary_knows_is_found(good: Result) -> None:
    window = good.summary["windows"][0] | {"vehicles": [{"id": "a"}, {"id": "ghost"}]}
    checks = judge(replace(good, summary={"windows": [window]}))
    assert checks["complete"].vehicles == ("ghost",)


@pytest.mark.parametrize(
    ("first_unit", "units", "verdict"),
    [(0, 5, PASS), (0, 4, FAIL), (0, 6, FAIL), (1, 5, FAIL), (-1, 5, FAIL)],
)
def test_a_corridor_has_the_units_that_the_summary_promises(
    good: Result, first_unit: int, units: int, verdict: Verdict
) -> None:
    listed = [{"id": "a", "first_unit": first_unit, "units": units}]
    window = good.summary["windows"][0] | {"vehicles": listed}
    check = judge(replace(good, summary={"windows": [window]}))["complete"]
    assert (check.verdict, check.vehicles) == (verdict, () if verdict == PASS else ("a",))


@pytest.mark.parametrize("value", [None, np.nan, np.inf])
@pytest.mark.parametrize("column", ["x_m", "heading_rad", "steering_rad", "jerk_mps3", "wheelbase_m"])
def test_a_value_that_is_no_number_is_found(good: Result, column: str, value: float | None) -> None:
    checks = judge(edited(good, "states", knot(good, "b", 7), **{column: value}))
    assert failed(checks) == {"complete"}
    assert checks["complete"].time_s == pytest.approx(1.4)
    assert all(checks[name].verdict == INCONCLUSIVE for name in OF_MOTION)


@pytest.mark.parametrize("values", [{"length_m": 1.0}, {"wheelbase_m": 3.0}])
def test_changing_dimensions_are_found(good: Result, values: dict[str, float]) -> None:
    checks = judge(edited(good, "states", knot(good, "b", 7), **values))
    assert checks["complete"].verdict == FAIL
    assert "dimensions change" in checks["complete"].detail


@pytest.mark.parametrize(
    "values",
    [
        {"x_min_m": np.nan},
        {"x_min_m": None},
        {"x_max_m": pl.col("x_min_m") - 1.0},
        {"k": 9},
        {"k": None},
        {"start_ns": None},
        {"end_ns": pl.col("end_ns") + NS // 2},
        {"end_ns": pl.col("start_ns")},
        {"frame_yaw_rad": 0.5},
    ],
)
def test_a_malformed_cube_is_found(good: Result, values: dict[str, Any]) -> None:
    checks = judge(edited(good, "corridors", cube("b", 2), **values))
    assert checks["complete"].verdict == FAIL
    assert "b" in checks["complete"].vehicles
    for name in ("cubes_disjoint", "obstacles_clear", "in_bounds", "in_corridor"):
        assert (name, checks[name].verdict) == (name, INCONCLUSIVE)


CELLS = st.one_of(
    st.none(),
    st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, -1e300, 1e-300]),
    st.floats(-1e4, 1e4),
)


@settings(max_examples=120, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damaged_tables_never_raise_and_never_pass_unseen(good: Result, data: st.DataObject) -> None:
    table = data.draw(st.sampled_from(["states", "corridors", "obstacles"]))
    frame: pl.DataFrame = getattr(good, table)
    names = [name for name, dtype in frame.schema.items() if dtype in (pl.Float64, pl.Int64, pl.Int32)]
    column = data.draw(st.sampled_from(names))
    row = data.draw(st.integers(0, frame.height - 1))
    whole = frame.schema[column] != pl.Float64
    value = data.draw(st.one_of(st.none(), st.integers(-(2**31), 2**31 - 1))) if whole else data.draw(CELLS)
    damaged = edited(good, table, pl.int_range(pl.len()) == row, **{column: value})
    certificates = certify(damaged, CONFIG)
    checked = (
        "pivot" not in column
        and "reference" not in column
        and not (table == "obstacles" and column in ("k", "window"))
    )
    planned = table != "states" or frame["source"][row] == "planned"
    last_knot = table == "states" and frame[column][row] is None  # its controls are not held
    broken = value is None or not np.isfinite(value)
    if checked and planned and broken and not last_knot:
        assert overall(certificates) in (FAIL, INCONCLUSIVE)


@pytest.mark.parametrize(
    "summary",
    [
        {},
        {"windows": None},
        {"windows": [None, 3, {"index": "0"}]},
        {"windows": [{"index": 0, "start_ns": 10**400, "end_ns": 1.5, "vehicles": [1, {"id": None}]}]},
        {"windows": [{"index": 0, "start_ns": -(2**63), "end_ns": 2**63 - 1}]},
    ],
)
def test_a_damaged_summary_never_raises(good: Result, summary: dict[str, Any]) -> None:
    checks = judge(replace(good, summary=summary))
    assert set(checks) == set(judge(good))
