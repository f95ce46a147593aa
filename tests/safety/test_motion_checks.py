"""Motions that are not the bicycle's, break a limit, leave a cube or start elsewhere are found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from istc_replay.config import parse_config
from istc_replay.datatypes import Result

from ..support.bicycles import DENSE, Car, straight_car
from ..support.judged import FAIL, INCONCLUSIVE, NS, OF_MOTION, PASS, edited, failed, judge, knot, without
from ..support.written import Scene


def test_a_corner_out_between_knots_is_found() -> None:
    # The rear corner of a turning car swings out furthest between two knots.
    cars = [
        Car("a", np.array([0.0, 0.0, heading, 0.5, 5.0, 0.0]), np.zeros((5, 2)), 0.2)
        for heading in np.linspace(-1.0, 0.0, 21)
    ]
    lowest = [car.corners()[..., 1] for car in cars]
    car, y = max(zip(cars, lowest, strict=True), key=lambda pair: pair[1][::DENSE].min() - pair[1].min())
    at_knots, always = y[::DENSE].min(), y.min()
    assert at_knots - always > 0.01  # else the test tests nothing
    walls = car.hulls(1.0, 1.0)
    walls[0, 2] = at_knots - 1e-4
    checks = judge(Scene([car], cubes={"a": walls}).result())
    check = checks["in_corridor"]
    assert failed(checks) == {"in_corridor"}
    assert check.vehicles == ("a",)
    assert check.time_s is not None
    assert check.margin == pytest.approx(always - walls[0, 2], abs=1e-4)
    worst = y.min(axis=1).argmin() * 0.2 / DENSE
    assert check.time_s == pytest.approx(worst, abs=0.02)


@pytest.mark.parametrize(
    ("column", "change", "unit"),
    [
        ("x_m", 0.2, "m"),
        ("y_m", -0.2, "m"),
        ("heading_rad", 0.1, "rad"),
        ("speed_mps", 0.1, "m/s"),
        ("acceleration_mps2", -0.1, "m/s^2"),
        ("steering_rad", 0.08, "rad"),
    ],
)
def test_an_altered_knot_is_found(good: Result, column: str, change: float, unit: str) -> None:
    check = judge(edited(good, "states", knot(good, "b", 7), **{column: pl.col(column) + change}))["dynamics"]
    assert (check.verdict, check.vehicles, check.unit) == (FAIL, ("b",), unit)
    assert check.time_s == pytest.approx(1.4)
    assert check.margin == pytest.approx(0.05 - abs(change), abs=1e-6)


@pytest.mark.parametrize(("column", "change"), [("steering_rate_radps", 0.2), ("jerk_mps3", 2.0)])
def test_an_altered_control_is_found(good: Result, column: str, change: float) -> None:
    check = judge(edited(good, "states", knot(good, "c", 4), **{column: pl.col(column) + change}))["dynamics"]
    assert (check.verdict, check.vehicles) == (FAIL, ("c",))
    assert check.time_s is not None
    assert check.time_s > 0.8


def test_the_papers_euler_knots_drift_from_the_motion() -> None:
    first, controls = np.array([0.0, 0.0, 0.0, 0.0, 5.0, 0.0]), np.zeros((40, 2))
    controls[:, 0] = 0.25 * np.cos(np.arange(40) * 0.3)
    car = Car("a", first, controls, 0.2)
    knots = [first]
    for rate, jerk in controls:
        x, y, heading, steering, speed, a = knots[-1]
        change = [
            speed * np.cos(heading),
            speed * np.sin(heading),
            speed * np.tan(steering) / 2.7,
            rate,
            a,
            jerk,
        ]
        knots.append(knots[-1] + 0.2 * np.array(change))
    result = Scene([car]).result()
    x, y, heading = np.array(knots)[:, :3].T
    centre = {"x_m": x + 1.35 * np.cos(heading), "y_m": y + 1.35 * np.sin(heading), "heading_rad": heading}
    planned = result.states.filter(pl.col("source") == "planned").with_columns(
        pl.Series(name, values) for name, values in centre.items()
    )
    recorded = result.states.filter(pl.col("source") == "recorded")
    check = judge(replace(result, states=pl.concat([planned, recorded])))["dynamics"]
    assert check.verdict == FAIL
    truth = np.hypot(*(np.column_stack(list(centre.values()))[:, :2] - car.centres()[::DENSE, :2]).T).max()
    assert check.margin == pytest.approx(0.05 - truth, abs=1e-6)


@pytest.mark.parametrize(
    ("limits", "unit", "what"),
    [
        ("steering_max_rad = 0.1", "rad", "steering near"),
        ("steering_rate_max_radps = 0.05", "rad/s", "steering rate"),
        ("acceleration_max_mps2 = 0.3", "m/s^2", "acceleration"),
        ("deceleration_max_mps2 = 0.3", "m/s^2", "acceleration"),
        ("jerk_max_mps3 = 0.5", "m/s^3", "jerk"),
    ],
)
def test_an_exceeded_limit_is_found(good: Result, limits: str, unit: str, what: str) -> None:
    checks = judge(good, parse_config(f"[trajectories]\n{limits}"))
    assert failed(checks) == {"limits"}
    assert checks["limits"].unit == unit
    assert checks["limits"].detail.startswith(what)


def test_a_speed_peak_between_knots_is_found() -> None:
    first = np.array([0.0, 0.0, 0.0, 0.0, 9.9, 1.6])
    car = Car("a", first, np.array([[0.0, -8.0], [0.0, 0.0]]), 0.4)
    result = without(Scene([car], unit_s=0.8).result(), "states", pl.col("source") == "recorded")
    check = judge(result)["limits"]
    assert car.dense[::DENSE, 4].max() < 10.0 < car.dense[:, 4].max()
    assert (check.verdict, check.unit, check.vehicles) == (FAIL, "m/s", ("a",))
    assert check.time_s == pytest.approx(0.2)
    assert check.margin == pytest.approx(10.0 - 10.06)


def test_the_speed_limit_rises_with_the_recorded_speed() -> None:
    fast = Scene([straight_car("a", 0, 0, 0, 12.0, 10)]).result()
    assert judge(fast)["limits"].verdict == PASS
    slow = edited(fast, "states", pl.col("source") == "recorded", speed_mps=9.0)
    check = judge(slow)["limits"]  # the limit is 1.15 * 9 + 1
    assert check.verdict == FAIL
    assert check.margin == pytest.approx(11.35 - 12.0)


def test_of_limits_in_different_units_that_which_is_nearest_in_its_parts_is_told() -> None:
    # 0.3 rad of 0.6 are half of the steering; 0.5 m/s of 10 are a twentieth of the speed.
    first = np.array([0.0, 0.0, 0.0, 0.3, 9.5, 0.0])
    result = Scene([Car("a", first, np.zeros((5, 2)), 0.2)]).result()
    check = judge(without(result, "states", pl.col("source") == "recorded"))["limits"]
    assert (check.verdict, check.unit) == (PASS, "m/s")
    assert check.margin == pytest.approx(0.5)
    assert check.detail.startswith("speed nearest its limits 0 to 10 m/s")


def test_who_was_recorded_fast_before_the_window_may_not_be_fast_in_it() -> None:
    fast = Scene([straight_car("a", 0, 0, 0, 12.0, 10)]).result()
    slow = edited(fast, "states", pl.col("source") == "recorded", speed_mps=9.0)
    start_ns = fast.summary["windows"][0]["start_ns"]
    earlier = slow.states.filter(pl.col("source") == "recorded").head(1)
    earlier = earlier.with_columns(time_ns=pl.lit(start_ns - NS), speed_mps=pl.lit(20.0))
    check = judge(replace(slow, states=pl.concat([slow.states, earlier])))["limits"]
    assert check.verdict == FAIL
    assert check.margin == pytest.approx(11.35 - 12.0)


def test_driving_backwards_is_found() -> None:
    checks = judge(Scene([straight_car("a", 0, 0, 0, -0.1, 10)]).result())
    assert failed(checks) == {"limits"}


def test_a_start_away_from_the_recording_is_found(good: Result) -> None:
    recorded = (pl.col("source") == "recorded") & (pl.col("vehicle_id") == "b")
    checks = judge(edited(good, "states", recorded, x_m=pl.col("x_m") + 0.06))
    assert failed(checks) == {"start"}
    assert checks["start"].vehicles == ("b",)
    assert checks["start"].margin == pytest.approx(-0.01)


def test_a_start_between_samples_is_judged_as_far_as_they_tell(good: Result) -> None:
    start = good.summary["windows"][0]["start_ns"]
    b = (pl.col("source") == "recorded") & (pl.col("vehicle_id") == "b")
    # Samples 0.1 s before and after: the position between is known to 50 mm.
    before = good.states.filter(b & (pl.col("time_ns") == start + NS // 10)).with_columns(
        time_ns=pl.lit(start - NS // 10), x_m=2 * pl.col("x_m")
    )
    first = good.states.filter(b & (pl.col("time_ns") == start))["x_m"][0]
    after = good.states.filter(b & (pl.col("time_ns") == start + NS // 10))["x_m"][0]
    for away, verdict in ((0.03, PASS), (0.08, INCONCLUSIVE), (0.12, FAIL)):
        sample = before.with_columns(x_m=pl.lit(2 * (first + away) - after), y_m=pl.lit(0.0))
        y = good.states.filter(b & (pl.col("time_ns") <= start + NS // 10)).sort("time_ns")["y_m"]
        sample = sample.with_columns(y_m=pl.lit(2 * y[0] - y[1]))
        states = pl.concat([good.states.filter(~(b & (pl.col("time_ns") == start))), sample])
        assert judge(replace(good, states=states))["start"].verdict == verdict


def test_a_vehicle_that_was_not_recorded_is_not_judged_at_its_start(good: Result) -> None:
    recorded = (pl.col("source") == "recorded") & (pl.col("vehicle_id") == "b")
    check = judge(without(good, "states", recorded))["start"]
    assert (check.verdict, check.vehicles) == (INCONCLUSIVE, ("b",))


def test_the_least_separation_asked_for_is_held() -> None:
    cars = [straight_car("a", 0, 0, 0.1, 5.0, 10), straight_car("b", 0, 2.5, 0.1, 5.0, 10)]
    result = Scene(cars).result()
    apart = 2.5 * np.cos(0.1) - 1.9
    for asked, verdict in ((0.0, PASS), (apart - 1e-6, PASS), (apart + 1e-6, FAIL)):
        check = judge(result, parse_config(f"[certificate]\nseparation_m = {asked}"))["separation"]
        assert check.verdict == verdict
        assert check.margin == pytest.approx(apart - asked, abs=1e-9)


@pytest.mark.parametrize("steering", [1.5, np.pi / 2, 2.0, 1e300])
def test_steering_beyond_sense_fails_its_limit_and_passes_nothing(good: Result, steering: float) -> None:
    planned = (pl.col("source") == "planned") & (pl.col("vehicle_id") == "b")
    checks = judge(edited(good, "states", planned, steering_rad=steering))
    assert checks["limits"].verdict == FAIL
    assert checks["limits"].vehicles == ("b",)
    assert not any(checks[name].verdict == PASS for name in OF_MOTION if name != "start")
