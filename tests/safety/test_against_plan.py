"""What was recorded against what was planned: plans whose recordings are known to differ, and by how much."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config, parse_config
from istc_replay.datatypes import Frame, Result
from istc_replay.safety.against_plan import against_plan
from istc_replay.safety.result_audit import audit_result
from istc_replay.states import AGAINST_PLAN_SCHEMA

from ..support.bicycles import random_car, stacked, straight_car
from ..support.written import Scene

NS = 1_000_000_000
RECORDED = pl.col("source") == "recorded"


def recorded_as(result: Result, **changes: Any) -> Result:
    """The result with other recorded values."""
    columns = {n: pl.when(RECORDED).then(value).otherwise(pl.col(n)) for n, value in changes.items()}
    return replace(result, states=result.states.with_columns(**columns))


@pytest.fixture(scope="module")
def scene() -> Any:
    rng = np.random.default_rng(11)
    cars = stacked([random_car(rng, name, 30) for name in ("a", "b")])
    return Scene(cars, frame=Frame(449_000.0, 5_411_000.0, 0.7))


def test_who_drives_as_planned_deviates_by_nothing(scene: Any) -> None:
    table = against_plan(scene.result(), Config())
    assert table.schema == AGAINST_PLAN_SCHEMA
    assert table["vehicle_id"].to_list() == ["a", "b"]
    for name in ("deviation_most_m", "deviation_end_m", "delay_most_s", "outside_s"):
        assert table[name].abs().max() < 1e-6, name  # type: ignore[operator]
    assert table["first_exit_ns"].null_count() == 2
    assert (table["deepest_m"] < 0.0).all()
    for name in ("braking_mps2", "lateral_mps2", "jerk_mps3"):
        assert table[f"recorded_{name}"].null_count() == 0
        np.testing.assert_allclose(table[f"recorded_{name}"], table[f"planned_{name}"], rtol=1e-5, atol=1e-6)
    assert set(table["estimate"]) == {"counterfactual estimate"}


def test_a_constant_offset_is_the_deviation_and_no_delay(scene: Any) -> None:
    moved = recorded_as(scene.result(), x_m=pl.col("x_m") + 3.0, y_m=pl.col("y_m") - 4.0)
    table = against_plan(moved, Config())
    np.testing.assert_allclose(table["deviation_most_m"], 5.0, atol=1e-5)
    np.testing.assert_allclose(table["deviation_mean_m"], 5.0, atol=1e-5)
    np.testing.assert_allclose(table["delay_most_s"], 0.0, atol=1e-5)


def test_who_drives_faster_than_planned_shows_as_the_plans_delay() -> None:
    scene = Scene([straight_car("a", 0, 0, 0.0, 4.0, 25)])
    t = (pl.col("time_ns") - scene.start_ns) / NS
    faster = recorded_as(scene.result(), x_m=5.0 * t, speed_mps=pl.lit(5.0))
    row = against_plan(faster, Config()).row(0, named=True)
    # The plan drives 20 m in 5 s, the recording in 4.
    assert row["compared_m"] == pytest.approx(20.0)
    assert row["delay_end_s"] == pytest.approx(1.0, abs=1e-6)
    assert row["deviation_end_m"] == pytest.approx(5.0, abs=1e-6)


def test_comfort_is_the_most_of_what_was_driven_and_of_what_was_planned() -> None:
    scene = Scene([straight_car("a", 0, 0, 0.0, 8.0, 25)])
    t = (pl.col("time_ns") - scene.start_ns) / NS
    # It brakes with 3 m/s^2 from 2 s on, while the plan keeps its speed.
    braking = recorded_as(
        scene.result(), speed_mps=8.0 - 3.0 * (t - 2.0).clip(lower_bound=0.0, upper_bound=2.5)
    )
    row = against_plan(braking, Config()).row(0, named=True)
    assert row["recorded_braking_mps2"] == pytest.approx(3.0, abs=0.05)
    assert row["planned_braking_mps2"] == pytest.approx(0.0, abs=1e-6)
    assert row["recorded_jerk_mps3"] > 3.0
    assert row["recorded_lateral_mps2"] == pytest.approx(0.0, abs=1e-6)


def test_the_first_exit_from_the_corridor_is_told_with_its_depth_and_is_a_finding() -> None:
    scene = Scene([straight_car("a", 0, 0, 0.0, 5.0, 25)], pad=0.4)
    t = (pl.col("time_ns") - scene.start_ns) / NS
    # Drifts to the left with 0.5 m/s from 2 s on; it is out by 0.1 m at 3.0 s, and by 1.1 m at the end.
    drifting = recorded_as(scene.result(), y_m=0.5 * (t - 2.0).clip(lower_bound=0.0))
    row = against_plan(drifting, Config()).row(0, named=True)
    assert (row["first_exit_ns"] - scene.start_ns) / NS == pytest.approx(3.1, abs=0.101)
    assert row["deepest_m"] == pytest.approx(1.1, abs=1e-6)
    assert row["deepest_ns"] == row["last_out_ns"] == scene.start_ns + 5 * NS
    assert row["outside_s"] == pytest.approx(1.9, abs=0.11)
    audit = audit_result(drifting, Config())
    found = audit.findings.filter(pl.col("rule") == "off_corridor").row(0, named=True)
    assert (found["severity"], found["vehicles"]) == ("minor", ["a"])
    assert found["value"] == pytest.approx(1.1, abs=1e-6)
    assert (found["start_ns"], found["worst_ns"]) == (row["first_exit_ns"], row["deepest_ns"])
    assert "counterfactual estimate" in found["detail"]
    severe = audit_result(drifting, parse_config("[audit]\noff_corridor_serious_m = 1.0"))
    assert "serious" in severe.findings["severity"].to_list()
    judged = audit.coverage.filter(pl.col("rule") == "off_corridor").row(0, named=True)
    assert (judged["verdict"], judged["judged_s"]) == ("fail", pytest.approx(5.0, abs=0.2))


def test_at_a_boundary_of_units_either_cube_will_do() -> None:
    car = straight_car("a", 0, 0, 0.0, 5.0, 10)
    assert against_plan(Scene([car], pad=1e-6).result(), Config())["first_exit_ns"].null_count() == 1


def test_rejected_trajectories_are_no_plan_and_what_was_not_recorded_is_not_judged(scene: Any) -> None:
    result = scene.result()
    source = pl.col("source").replace("planned", "rejected")
    rejected = replace(result, states=result.states.with_columns(source))
    assert against_plan(rejected, Config()).is_empty()
    alone = replace(result, states=result.states.filter(~RECORDED | (pl.col("vehicle_id") == "b")))
    row = against_plan(alone, Config()).row(0, named=True)
    assert (row["vehicle_id"], row["samples"], row["deviation_most_m"]) == ("a", 0, None)
