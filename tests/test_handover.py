"""Windows that start where the plan before has led: the seam is continuous, and certified."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.bench import recorded_log
from istc_replay.config import Config, parse_config
from istc_replay.datatypes import Log, Verdict, WindowPlan, WindowStatus
from istc_replay.errors import ScenarioError
from istc_replay.handover import handed_over
from istc_replay.pipeline.assembly import Replay
from istc_replay.pipeline.replay import replay_read
from istc_replay.pipeline.windows import plan_windows
from istc_replay.safety.certificate import certify
from istc_replay.samples.scenes import find_sample
from istc_replay.windows import window_spans

from .support.tracks import driver, log_of

CONFIG = """
corridors.mode = "fast"
window = {{ horizon_s = 3.0, stride_s = {stride}, unit_s = 0.5, start = "{start}" }}
"""
MOTION = ("x_m", "y_m", "heading_rad", "speed_mps", "acceleration_mps2", "steering_rad")


def config(stride: float = 3.0, start: str = "handed_over") -> Config:
    """Windows of three seconds."""
    return parse_config(CONFIG.format(stride=stride, start=start))


@pytest.fixture(scope="module")
def log() -> Log:
    """A car that comes close to a slower one, which leaves after 5.9 s, and one that stays apart."""
    return log_of(
        driver("1", 0.0, 0.0, 12.0, 9.0), driver("2", 0.3, 16.0, 10.6, 5.9), driver("3", 7.0, -3.0, 13.0, 9.0)
    )


@pytest.fixture(scope="module")
def chained(log: Log) -> Replay:
    """The log, each window from the plan before."""
    return replay_read(log, config())


def starts(done: Replay) -> dict[tuple[int, str], str]:
    """From where each vehicle of each window starts."""
    windows = done.summary["windows"]
    return {(w["index"], v["id"]): v["start"] for w in windows for v in w["vehicles"]}


def test_every_vehicle_goes_on_where_the_plan_before_has_led_it(chained: Replay) -> None:
    planned = chained.result.states.filter(pl.col("source") == "planned")
    assert {w["status"] for w in chained.summary["windows"]} == {"certified"}
    told, moved = starts(chained), []
    for (window, vehicle), start in told.items():
        assert start == ("recording" if window == 0 else "handed_over")
        if window == 0:
            continue
        own = planned.filter(pl.col("vehicle_id") == vehicle)
        before = own.filter(pl.col("window") == window - 1).sort("time_ns").tail(1)
        after = own.filter(pl.col("window") == window).sort("time_ns").head(1)
        assert before["time_ns"].item() == after["time_ns"].item()
        np.testing.assert_allclose(after.select(MOTION).row(0), before.select(MOTION).row(0), atol=1e-4)
        recorded = 12.0 * after["time_ns"].item() / 1e9
        moved += [abs(after["x_m"].item() - recorded)] if vehicle == "1" else []
    assert max(moved) > 0.05  # it is not where it was recorded: the seam is the plan's, not the recording's


def test_the_seam_is_certified(chained: Replay) -> None:
    checks: dict[int, dict[str, Any]] = {
        w["index"]: {c["check"]: c for c in w["certificate"]["checks"]} for w in chained.summary["windows"]
    }
    assert checks[0]["seam"]["verdict"] == "not_applicable"
    for window in (1, 2):
        assert checks[window]["seam"]["verdict"] == "pass"
        assert 0.0 < checks[window]["seam"]["margin"] <= 1e-3
        assert checks[window]["start"]["verdict"] == "not_applicable"


@pytest.mark.parametrize(("column", "by"), [("x_m", 0.02), ("speed_mps", 0.02), ("acceleration_mps2", 0.02)])
def test_a_torn_seam_fails(chained: Replay, column: str, by: float) -> None:
    torn = (pl.col("source") == "planned") & (pl.col("window") == 1) & (pl.col("vehicle_id") == "1")
    states = chained.result.states.with_columns(
        pl.when(torn).then(pl.col(column) + by).otherwise(column).alias(column)
    )
    found = certify(replace(chained.result, states=states), parse_config(chained.result.config_toml))
    seams = {c.window: c for c in found if c.check == "seam"}
    assert seams[1].verdict is Verdict.FAIL
    assert seams[1].vehicles == ("1",)


def test_a_seam_whose_plan_before_is_missing_is_not_judged(chained: Replay) -> None:
    states = chained.result.states.filter(~((pl.col("source") == "planned") & (pl.col("window") == 0)))
    found = certify(replace(chained.result, states=states), parse_config(chained.result.config_toml))
    assert next(c for c in found if c.check == "seam" and c.window == 1).verdict is Verdict.INCONCLUSIVE


def test_windows_that_overlap_are_handed_over_in_the_midst_of_a_plan(log: Log) -> None:
    done = replay_read(log, config(stride=2.2))
    assert all(w["certificate"]["verdict"] == "pass" for w in done.summary["windows"])
    assert list(starts(done).values()).count("handed_over") > 3


def test_from_the_recording_every_window_starts_anew(log: Log) -> None:
    done = replay_read(log, config(start="recording"))
    assert set(starts(done).values()) == {"recording"}


def test_a_chain_is_planned_from_its_first_window_on(log: Log) -> None:
    with pytest.raises(ScenarioError, match="from the first on"):
        plan_windows(log, config(), [1])


def test_what_lies_ahead_begins_at_the_instant_and_goes_on_in_time(
    synthetic_plan: tuple[Log, list[WindowPlan]],
) -> None:
    plan = synthetic_plan[1][0]
    own = plan.trajectories[0]
    knots = own.times_s.tolist()
    for at_s in (knots[0], knots[3], (knots[3] + knots[4]) / 2.0, knots[-1]):
        handed = handed_over(plan, plan.scenario.window.start_ns + round(at_s * 1e9))[own.vehicle_id]
        np.testing.assert_array_equal(handed.ahead[0], [0.0, *handed.pose])
        assert (np.diff(handed.ahead[:, 0]) > 1e-6).all()
        assert handed.ahead[-1, 0] == pytest.approx(knots[-1] - at_s)


@pytest.mark.parametrize("status", list(WindowStatus))
def test_a_plan_that_does_not_hold_hands_nobody_over(
    synthetic_plan: tuple[Log, list[WindowPlan]], status: WindowStatus
) -> None:
    plan = replace(synthetic_plan[1][0], status=status)
    handed = handed_over(plan, plan.scenario.window.start_ns)
    holds = status in (WindowStatus.CERTIFIED, WindowStatus.PARTIAL, WindowStatus.GOAL_NOT_REACHED)
    there = {own.vehicle_id for own in plan.trajectories if own.times_s[0] == 0.0}
    assert set(handed) == (there if holds else set())
    assert not handed_over(None, 0)


# --- a scene planned in steps ----------------------------------------------------------------


@pytest.fixture(scope="module")
def in_steps() -> Replay:
    """Eight vehicles that cross, seven seconds at a time, whose goals lie beyond the first of them."""
    window = 'window = { whole_log_s = 7.0, horizon_s = 7.0, stride_s = 3.0, start = "handed_over" }'
    text = f'corridors.mode = "fast"\n{window}'
    return replay_read(recorded_log(find_sample("dense_8").record()), parse_config(text))


def test_a_scene_in_steps_is_certified_all_along_and_all_arrive_in_the_end(in_steps: Replay) -> None:
    windows = in_steps.summary["windows"]
    assert [w["status"] for w in windows] == ["certified"] * 3
    assert [w["end_ns"] - w["start_ns"] for w in windows] == [7_000_000_000] * 3
    assert {v["start"] for w in windows[1:] for v in w["vehicles"]} == {"handed_over"}
    assert all(v["arrived"] is None for v in windows[0]["vehicles"])  # it is on its way
    assert all(v["arrived"] for v in windows[-1]["vehicles"])
    assert not any(w["reason"] for w in windows)


def test_its_steps_make_one_motion_without_a_jump(in_steps: Replay) -> None:
    planned = in_steps.result.states.filter(pl.col("source") == "planned").sort("window", "time_ns")
    moved = 0.0
    for window in (1, 2):
        for vehicle in planned["vehicle_id"].unique():
            own = planned.filter(pl.col("vehicle_id") == vehicle)
            after = own.filter(pl.col("window") == window).head(1)
            before = own.filter(pl.col("window") == window - 1, pl.col("time_ns") == after["time_ns"].item())
            np.testing.assert_allclose(after.select(MOTION).row(0), before.select(MOTION).row(0), atol=1e-4)
            recorded = in_steps.result.states.filter(
                pl.col("source") == "recorded",
                pl.col("vehicle_id") == vehicle,
                (pl.col("time_ns") - after["time_ns"].item()).abs() < 60_000_000,
            )
            moved = max(moved, abs(recorded["x_m"].mean() - after["x_m"].item()))
    assert moved > 0.3  # the plan, not the recording, goes on


def test_windows_end_with_the_log_and_none_lies_within_another(log: Log) -> None:
    spans = window_spans(log, config(stride=1.0))
    ends = [start + length for start, length, _ in spans]
    assert ends[-1] == max(ends)
    assert len(set(ends)) == len(ends)
