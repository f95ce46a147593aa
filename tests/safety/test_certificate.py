"""Good plans pass, planted faults are found by the right check at the right place, nothing else passes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from istc_replay.config import Config, parse_config
from istc_replay.datatypes import Certificate, Frame, MapBounds, Result, Verdict
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.certificate import certify, overall
from istc_replay.safety.walls import wall_margin

NS = 1_000_000_000
CONFIG = Config()
FAIL, PASS = Verdict.FAIL, Verdict.PASS
INCONCLUSIVE, NOT_APPLICABLE = Verdict.INCONCLUSIVE, Verdict.NOT_APPLICABLE
#: Checks that need a vehicle's trajectory.
OF_MOTION = ("cubes_overlap", "start", "dynamics", "limits", "in_corridor", "separation")


def judge(result: Result, config: Config = CONFIG) -> dict[str, Certificate]:
    return {certificate.check: certificate for certificate in certify(result, config)}


def failed(checks: dict[str, Certificate]) -> set[str]:
    return {name for name, check in checks.items() if check.verdict == FAIL}


def edited(result: Result, table: str, where: pl.Expr, **values: Any) -> Result:
    """The result with columns replaced in the rows where the condition holds."""
    frame: pl.DataFrame = getattr(result, table)
    columns = [
        pl.when(where).then(value if isinstance(value, pl.Expr) else pl.lit(value)).otherwise(pl.col(name))
        .cast(frame.schema[name]).alias(name)
        for name, value in values.items()
    ]  # fmt: skip
    return replace(result, **{table: frame.with_columns(columns)})


def without(result: Result, table: str, where: pl.Expr) -> Result:
    return replace(result, **{table: getattr(result, table).filter(~where)})


def knot(result: Result, vehicle: str, k: int) -> pl.Expr:
    """The planned row of a vehicle's k-th knot (dt = 0.2 s)."""
    start = result.summary["windows"][0]["start_ns"]
    planned = (pl.col("source") == "planned") & (pl.col("vehicle_id") == vehicle)
    return planned & (pl.col("time_ns") == start + k * NS // 5)


def cube(vehicle: str, k: int) -> pl.Expr:
    return (pl.col("vehicle_id") == vehicle) & (pl.col("k") == k)


@pytest.fixture(scope="module")
def scene(kit: SimpleNamespace) -> Any:
    """Three wandering cars over five units, their corridors 0.3 m apart, an obstacle, bounds."""
    rng = np.random.default_rng(5)
    cars = kit.stacked(kit.random_car(rng, name, 25) for name in ("a", "b", "c"))
    return kit.Scene(
        cars,
        obstacles={"wall": np.tile([-60.0, 60.0, -3.0, -0.1], (5, 1))},
        bounds=MapBounds(-100.0, 100.0, -100.0, 100.0),
    )


@pytest.fixture(scope="module")
def good(scene: Any) -> Result:
    return scene.result()


# --- good plans -------------------------------------------------------------------------------


def test_a_good_plan_passes_every_check(good: Result) -> None:
    checks = judge(good)
    # The scene itself has no obstacle that the plan could have left out.
    assert checks.pop("obstacles_known").verdict == NOT_APPLICABLE
    assert checks.pop("seam").verdict == NOT_APPLICABLE  # nothing was handed over
    assert checks.pop("lateral").verdict == NOT_APPLICABLE  # a scene
    assert {check.verdict for check in checks.values()} == {PASS}
    assert overall(checks.values()) == PASS
    assert checks["dynamics"].margin == pytest.approx(0.05, abs=1e-7)
    assert checks["in_corridor"].margin == pytest.approx(0.05, abs=1e-3)
    assert checks["start"].margin == pytest.approx(0.05, abs=1e-7)


def test_a_single_vehicle_has_no_pair_and_no_obstacle(kit: SimpleNamespace) -> None:
    checks = judge(kit.Scene([kit.straight_car("a", 0, 0, 0.3, 5.0, 10)]).result())
    absent = {name for name, check in checks.items() if check.verdict == NOT_APPLICABLE}
    pairs = {"cubes_disjoint", "separation", "seam", "lateral"}
    assert absent == pairs | {"obstacles_clear", "obstacles_known", "obstacle_separation", "in_bounds"}
    assert overall(checks.values()) == PASS


@pytest.mark.parametrize("seed", range(100))
def test_random_good_plans_raise_no_false_alarm(kit: SimpleNamespace, seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    unit_s, dt = [(1.0, 0.2), (0.5, 0.25), (0.25, 0.125), (1.0, 0.1)][seed % 4]
    per_unit = round(unit_s / dt)
    cars = [
        kit.random_car(rng, f"v{i}", int(rng.integers(1, 6)) * per_unit, dt, int(rng.integers(0, 3)))
        for i in range(rng.integers(1, 5))
    ]
    origin = rng.uniform(-1, 1, 2) * [7e5, 6e6] if seed % 2 else np.zeros(2)
    frame = Frame(*origin, rng.uniform(-np.pi, np.pi))
    # Next to no margin: the corners touch the cubes' walls but for what the hull's samples miss.
    scene = kit.Scene(kit.stacked(cars, pad=5e-5), unit_s=unit_s, frame=frame, pad=5e-5)
    scene.obstacles = {"below": np.tile([-500.0, 500.0, -5.0, 0.1], (9, 1))}
    checks = judge(scene.result())
    assert overall(checks.values()) == PASS, checks


def test_vehicles_of_different_steps_and_spans_are_judged_together(kit: SimpleNamespace) -> None:
    rng = np.random.default_rng(8)
    cars = [kit.random_car(rng, "a", 30, 0.1), kit.random_car(rng, "b", 14, 1 / 7, 1)]
    checks = judge(kit.Scene(kit.stacked(cars)).result())
    assert overall(checks.values()) == PASS, checks


def test_an_absent_obstacle_does_not_count(scene: Any) -> None:
    boxes = np.tile([-60.0, 60.0, -3.0, -0.1], (5, 1))
    boxes[1:] = np.nan
    boxes[0] = [500.0, 501.0, 0.0, 1.0]
    checks = judge(replace(scene, obstacles={"gone": boxes}).result())
    assert checks["obstacles_clear"].verdict == PASS
    assert checks["obstacle_separation"].verdict == PASS
    boxes[:] = np.nan
    checks = judge(replace(scene, obstacles={"gone": boxes}).result())
    assert checks["obstacle_separation"].verdict == NOT_APPLICABLE


@pytest.mark.parametrize("status", ["conflict_left", "no_corridors", "not_drivable", "nothing_to_plan"])
def test_a_window_without_a_plan_has_no_certificates(good: Result, status: str) -> None:
    empty = without(good, "states", pl.col("source") == "planned")
    empty.summary["windows"][0]["status"], before = status, empty.summary["windows"][0]["status"]
    try:
        assert certify(empty, CONFIG) == ()
    finally:
        empty.summary["windows"][0]["status"] = before
    assert overall(()) == NOT_APPLICABLE


def test_windows_are_judged_one_by_one(kit: SimpleNamespace, good: Result) -> None:
    later = kit.Scene([kit.straight_car("a", 0, 0, 0.0, 5.0, 10)], window=3, start_ns=2_000_000_000 * NS)
    other = edited(later.result(), "corridors", cube("a", 1), x_max_m=pl.col("x_max_m") - 0.1)
    both = replace(
        good,
        states=pl.concat([good.states, other.states]),
        corridors=pl.concat([good.corridors, other.corridors]),
        summary={"windows": good.summary["windows"] + other.summary["windows"]},
    )
    certificates = certify(both, CONFIG)
    assert overall(c for c in certificates if c.window == 0) == PASS
    assert {c.check for c in certificates if c.window == 3 and c.verdict == FAIL} == {"in_corridor"}


# --- planted faults ---------------------------------------------------------------------------


def test_a_cube_moved_into_anothers_is_found(good: Result) -> None:
    a = good.corridors.filter(cube("a", 3)).row(0, named=True)
    hull = {name: pl.min_horizontal(name, pl.lit(a[name])) for name in ("x_min_m", "y_min_m")}
    hull |= {name: pl.max_horizontal(name, pl.lit(a[name])) for name in ("x_max_m", "y_max_m")}
    checks = judge(edited(good, "corridors", cube("b", 3), **hull))
    check = checks["cubes_disjoint"]
    assert failed(checks) == {"cubes_disjoint"}
    assert (check.verdict, check.time_s, check.vehicles) == (FAIL, 3.0, ("a", "b"))
    assert check.margin is not None
    assert check.margin < 0.0


@pytest.mark.parametrize("moved_m", [0.05, -0.05])
def test_a_cube_moved_by_five_centimetres_is_found(kit: SimpleNamespace, moved_m: float) -> None:
    # Cubes exactly the promised gap apart, each with 2 cm to spare about its box.
    rng = np.random.default_rng(4)
    cars = kit.stacked([kit.random_car(rng, name, 20) for name in "abc"], pad=0.02)
    result = kit.Scene(cars, pad=0.02).result()
    assert overall(judge(result).values()) == PASS
    y = {name: pl.col(name) + moved_m for name in ("y_min_m", "y_max_m")}
    checks = judge(edited(result, "corridors", cube("b", 2), **y))
    found = failed(checks)
    assert "in_corridor" in found
    for name in found:
        margin, time_s = checks[name].margin, checks[name].time_s
        assert "b" in checks[name].vehicles
        assert margin is not None
        assert -0.05 - 1e-6 <= margin < 0.0
        assert time_s is not None
        assert 2.0 <= time_s <= 3.0


@pytest.mark.slow
def test_a_thousand_random_good_plans_raise_no_false_alarm(kit: SimpleNamespace) -> None:
    for seed in range(1000):
        rng = np.random.default_rng(50_000 + seed)
        unit_s, dt = [(1.0, 0.2), (0.5, 0.25), (0.25, 0.125), (1.0, 0.1)][seed % 4]
        cars = [
            kit.random_car(rng, f"v{i}", int(rng.integers(1, 6)) * round(unit_s / dt), dt)
            for i in range(rng.integers(2, 5))
        ]
        frame = Frame(*rng.uniform(-1, 1, 2) * [7e5, 6e6], rng.uniform(-np.pi, np.pi))
        scene = kit.Scene(kit.stacked(cars, pad=5e-5), unit_s=unit_s, frame=frame, pad=5e-5)
        checks = judge(scene.result())
        assert overall(checks.values()) == PASS, (seed, checks)


@pytest.mark.parametrize("seeds", [range(30), pytest.param(range(1000), marks=pytest.mark.slow)])
def test_what_passes_is_never_contradicted_by_dense_sampling(kit: SimpleNamespace, seeds: range) -> None:
    passed = failing = 0
    unit = 5 * kit.dense  # samples
    for seed in seeds:
        rng = np.random.default_rng(90_000 + seed)
        cars = [kit.random_car(rng, f"v{i}", 15).moved(*rng.uniform(-9, 9, 2)) for i in range(2)]
        # Cubes that the truth grazes from either side, and cars that may meet.
        cubes = {car.name: car.hulls(1.0, 0.0) + rng.normal(0, 2e-5, (3, 4)) for car in cars}
        checks = judge(kit.Scene(cars, cubes=cubes).result())
        gap = box_gap(cars[0].boxes(), cars[1].boxes()).min()
        inside = min(
            wall_margin(car.boxes()[unit * k : unit * (k + 1) + 1], cubes[car.name][k]).min()
            for car in cars
            for k in range(3)
        )
        if checks["separation"].verdict == PASS:
            assert gap > 0.0, seed
        if checks["in_corridor"].verdict == PASS:
            assert inside >= -1e-6 - 1e-9, seed
        passed += checks["separation"].verdict == PASS
        failing += checks["separation"].verdict == FAIL
    assert passed > len(seeds) / 4
    assert failing > 0


@pytest.mark.parametrize(("short_m", "verdict"), [(0.0, PASS), (5e-7, PASS), (1e-5, FAIL)])
def test_the_promised_gap_is_held_to_the_tolerance(
    kit: SimpleNamespace, short_m: float, verdict: Verdict
) -> None:
    cars = [kit.straight_car("a", 0, 0, 0.0, 5.0, 5), kit.straight_car("b", 0, 4, 0.0, 5.0, 5)]
    cubes = {"a": [[-5.0, 10.0, -2.0, 1.5]], "b": [[-5.0, 10.0, 1.8 - short_m, 6.0]]}
    result = kit.Scene(cars, cubes={name: np.array(rows) for name, rows in cubes.items()}).result()
    check = judge(result)["cubes_disjoint"]
    assert check.verdict == verdict
    assert check.margin == pytest.approx(-short_m, abs=1e-12)


def test_a_corner_out_between_knots_is_found(kit: SimpleNamespace) -> None:
    # The rear corner of a turning car swings out furthest between two knots.
    cars = [
        kit.Car("a", np.array([0.0, 0.0, heading, 0.5, 5.0, 0.0]), np.zeros((5, 2)), 0.2)
        for heading in np.linspace(-1.0, 0.0, 21)
    ]
    lowest = [car.corners()[..., 1] for car in cars]
    car, y = max(zip(cars, lowest, strict=True), key=lambda pair: pair[1][:: kit.dense].min() - pair[1].min())
    at_knots, always = y[:: kit.dense].min(), y.min()
    assert at_knots - always > 0.01  # else the test tests nothing
    walls = car.hulls(1.0, 1.0)
    walls[0, 2] = at_knots - 1e-4
    checks = judge(kit.Scene([car], cubes={"a": walls}).result())
    check = checks["in_corridor"]
    assert failed(checks) == {"in_corridor"}
    assert check.vehicles == ("a",)
    assert check.time_s is not None
    assert check.margin == pytest.approx(always - walls[0, 2], abs=1e-4)
    worst = y.min(axis=1).argmin() * 0.2 / kit.dense
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


def test_the_papers_euler_knots_drift_from_the_motion(kit: SimpleNamespace) -> None:
    first, controls = np.array([0.0, 0.0, 0.0, 0.0, 5.0, 0.0]), np.zeros((40, 2))
    controls[:, 0] = 0.25 * np.cos(np.arange(40) * 0.3)
    car = kit.Car("a", first, controls, 0.2)
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
    result = kit.Scene([car]).result()
    x, y, heading = np.array(knots)[:, :3].T
    centre = {"x_m": x + 1.35 * np.cos(heading), "y_m": y + 1.35 * np.sin(heading), "heading_rad": heading}
    planned = result.states.filter(pl.col("source") == "planned").with_columns(
        pl.Series(name, values) for name, values in centre.items()
    )
    recorded = result.states.filter(pl.col("source") == "recorded")
    check = judge(replace(result, states=pl.concat([planned, recorded])))["dynamics"]
    assert check.verdict == FAIL
    truth = np.hypot(
        *(np.column_stack(list(centre.values()))[:, :2] - car.centres()[:: kit.dense, :2]).T
    ).max()
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


def test_a_speed_peak_between_knots_is_found(kit: SimpleNamespace) -> None:
    first = np.array([0.0, 0.0, 0.0, 0.0, 9.9, 1.6])
    car = kit.Car("a", first, np.array([[0.0, -8.0], [0.0, 0.0]]), 0.4)
    result = without(kit.Scene([car], unit_s=0.8).result(), "states", pl.col("source") == "recorded")
    check = judge(result)["limits"]
    assert car.dense[:: kit.dense, 4].max() < 10.0 < car.dense[:, 4].max()
    assert (check.verdict, check.unit, check.vehicles) == (FAIL, "m/s", ("a",))
    assert check.time_s == pytest.approx(0.2)
    assert check.margin == pytest.approx(10.0 - 10.06)


def test_the_speed_limit_rises_with_the_recorded_speed(kit: SimpleNamespace) -> None:
    fast = kit.Scene([kit.straight_car("a", 0, 0, 0, 12.0, 10)]).result()
    assert judge(fast)["limits"].verdict == PASS
    slow = edited(fast, "states", pl.col("source") == "recorded", speed_mps=9.0)
    check = judge(slow)["limits"]  # the limit is 1.15 * 9 + 1
    assert check.verdict == FAIL
    assert check.margin == pytest.approx(11.35 - 12.0)


def test_driving_backwards_is_found(kit: SimpleNamespace) -> None:
    checks = judge(kit.Scene([kit.straight_car("a", 0, 0, 0, -0.1, 10)]).result())
    assert failed(checks) == {"limits"}


def test_swapped_vehicles_are_found(good: Result) -> None:
    planned, name = pl.col("source") == "planned", pl.col("vehicle_id")
    other = pl.when(name == "a").then(pl.lit("b")).when(name == "b").then(pl.lit("a")).otherwise(name)
    checks = judge(edited(good, "states", planned, vehicle_id=other))
    assert {"in_corridor", "cubes_overlap", "start"} <= failed(checks)
    assert set(checks["in_corridor"].vehicles) <= {"a", "b"}
    assert set(checks["start"].vehicles) <= {"a", "b"}


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
    window["vehicles"] = [{"id": "a", "first_unit": 0, "units": 4}]
    assert judge(replace(good, summary={"windows": [window]}))["complete"].vehicles == ("a",)
    window["vehicles"] = [{"id": "a", "first_unit": 0, "units": 5}]
    assert judge(replace(good, summary={"windows": [window]}))["complete"].verdict == PASS


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
    assert checks["cubes_disjoint"].verdict == INCONCLUSIVE
    assert checks["in_corridor"].verdict == INCONCLUSIVE


def test_cubes_that_do_not_overlap_enough_are_found(kit: SimpleNamespace) -> None:
    car = kit.straight_car("a", 0, 0, 0.0, 5.0, 10)
    walls = car.hulls(1.0, 0.0)
    walls[1, 0] += 0.5  # the box's rear is outside of the second cube at the switch
    checks = judge(kit.Scene([car], cubes={"a": walls}).result())
    assert failed(checks) == {"cubes_overlap", "in_corridor"}
    assert checks["cubes_overlap"].time_s == pytest.approx(1.0)
    assert checks["cubes_overlap"].margin == pytest.approx(-0.5, abs=1e-9)


def test_an_overlapped_obstacle_is_found(kit: SimpleNamespace) -> None:
    car = kit.straight_car("a", 0, 0, 0.0, 5.0, 25)
    boxes = np.full((5, 4), np.nan)
    boxes[3] = [18.5, 19.0, 0.9, 4.0]  # grazes the car's left side, only in unit 3
    checks = judge(kit.Scene([car], obstacles={"block": boxes}).result())
    assert failed(checks) == {"obstacles_clear", "obstacle_separation"}
    assert checks["obstacles_clear"].time_s == 3.0
    check = checks["obstacle_separation"]
    assert check.time_s is not None
    assert 3.0 <= check.time_s <= 4.0
    assert check.margin == pytest.approx(-0.05, abs=1e-3)
    assert "'block'" in check.detail
    boxes = np.roll(boxes, -2, axis=0)  # the same box while the car is elsewhere
    assert judge(kit.Scene([car], obstacles={"block": boxes}).result())["obstacle_separation"].verdict == PASS


def test_an_obstacle_that_cannot_be_read_is_not_passed(good: Result) -> None:
    second = pl.col("k") == 2
    for values in (
        {"x_min_m": np.nan},
        {"x_max_m": -99.0},
        {"frame_x_m": 1.0},
        {"end_ns": pl.col("end_ns") + 5},
    ):
        checks = judge(edited(good, "obstacles", second, **values))
        for name in ("obstacles_clear", "obstacle_separation"):
            assert checks[name].verdict == INCONCLUSIVE
            assert checks[name].vehicles == ("wall",)


def test_crossing_vehicles_are_found_whatever_their_cubes(kit: SimpleNamespace) -> None:
    cars = [
        kit.straight_car("a", -10.0, 0.0, 0.0, 5.0, 20),
        kit.straight_car("b", 0.0, -10.0, np.pi / 2, 5.0, 20),
        kit.straight_car("c", 0.0, 30.0, 0.0, 5.0, 20),
    ]
    checks = judge(kit.Scene(cars).result())
    assert failed(checks) == {"cubes_disjoint", "separation"}
    check = checks["separation"]
    assert check.vehicles == ("a", "b")
    assert check.time_s == pytest.approx(2.0, abs=0.3)
    assert check.margin is not None
    assert check.margin < -1.0


def test_the_least_separation_asked_for_is_held(kit: SimpleNamespace) -> None:
    cars = [kit.straight_car("a", 0, 0, 0.1, 5.0, 10), kit.straight_car("b", 0, 2.5, 0.1, 5.0, 10)]
    result = kit.Scene(cars).result()
    apart = 2.5 * np.cos(0.1) - 1.9
    for asked, verdict in ((0.0, PASS), (apart - 1e-6, PASS), (apart + 1e-6, FAIL)):
        check = judge(result, parse_config(f"[certificate]\nseparation_m = {asked}"))["separation"]
        assert check.verdict == verdict
        assert check.margin == pytest.approx(apart - asked, abs=1e-9)


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2, -np.pi, 0.4])
def test_leaving_the_map_is_found(kit: SimpleNamespace, yaw: float) -> None:
    frame = Frame(500.0, -300.0, yaw)
    car = kit.straight_car("a", 0, 0, -yaw, 5.0, 10)  # drives east in the map: x up to 500 + 10 + 2.25
    for x_max, verdict in ((512.5, PASS), (512.0, FAIL)):
        bounds = MapBounds(490.0, x_max, -310.0, np.inf)
        check = judge(kit.Scene([car], frame=frame, bounds=bounds).result())["in_bounds"]
        assert check.verdict == verdict
        assert check.vehicles == ("a",)
        if verdict == FAIL:
            assert check.margin == pytest.approx(-0.25 - (0.0 if yaw == 0.4 else 0.05), abs=1e-6)


# --- what cannot be judged --------------------------------------------------------------------


def test_what_is_too_large_to_judge_is_inconclusive(good: Result) -> None:
    checks = judge(good, parse_config("[certificate]\nstep_s = 1e-9"))
    assert checks.pop("complete").verdict == PASS
    assert {check.verdict for check in checks.values()} == {INCONCLUSIVE}


@pytest.mark.parametrize("steering", [1.5, np.pi / 2, 2.0, 1e300])
def test_steering_beyond_sense_fails_its_limit_and_passes_nothing(good: Result, steering: float) -> None:
    planned = (pl.col("source") == "planned") & (pl.col("vehicle_id") == "b")
    checks = judge(edited(good, "states", planned, steering_rad=steering))
    assert checks["limits"].verdict == FAIL
    assert checks["limits"].vehicles == ("b",)
    assert not any(checks[name].verdict == PASS for name in OF_MOTION if name != "start")


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


# --- the same plan, written otherwise ---------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("fault", [None, "cube", "knot", "crossing"])
def test_a_moved_and_turned_result_gets_the_same_verdicts(
    scene: Any, kit: SimpleNamespace, seed: int, fault: str | None
) -> None:
    rng = np.random.default_rng(seed)
    frame = Frame(rng.uniform(-8e5, 8e5), rng.uniform(-6e6, 6e6), rng.uniform(-np.pi, np.pi))
    moved = replace(scene, frame=frame, bounds=None, start_ns=int(rng.integers(0, 2**60)))
    plain = replace(scene, bounds=None)
    if fault == "crossing":
        extra = [kit.straight_car("d", 0.0, -5.0, 1.2, 6.0, 25)]
        moved, plain = replace(moved, cars=scene.cars + extra), replace(plain, cars=scene.cars + extra)
    judged = []
    for result in (plain.result(), moved.result()):
        if fault == "cube":
            result = edited(result, "corridors", cube("b", 3), y_max_m=pl.col("y_max_m") - 0.2)
        elif fault == "knot":
            result = edited(result, "states", knot(result, "b", 7), speed_mps=pl.col("speed_mps") + 0.2)
        judged.append(judge(result))
    for name, check in judged[0].items():
        other = judged[1][name]
        assert (other.verdict, other.unit) == (check.verdict, check.unit)
        assert check.verdict != FAIL or other.vehicles == check.vehicles
        tolerance = 2e-3 if "separation" in name else 1e-6
        assert other.margin == (None if check.margin is None else pytest.approx(check.margin, abs=tolerance))


def test_row_order_and_names_do_not_matter(good: Result) -> None:
    shuffled = replace(
        good,
        states=good.states.sample(fraction=1.0, shuffle=True, seed=1),
        corridors=good.corridors.sample(fraction=1.0, shuffle=True, seed=2),
        obstacles=good.obstacles.sample(fraction=1.0, shuffle=True, seed=3),
    )
    assert certify(shuffled, CONFIG) == certify(good, CONFIG)
    rename = pl.col("vehicle_id").replace({"a": "z", "b": "y\n<b>", "c": "x"})
    renamed = judge(
        replace(
            good,
            states=good.states.with_columns(rename),
            corridors=good.corridors.with_columns(rename),
        )
    )
    assert {name: check.verdict for name, check in renamed.items()} == {
        name: check.verdict for name, check in judge(good).items()
    }
    assert not any("\n" in check.detail for check in renamed.values())


def test_the_same_result_gets_the_same_certificates(good: Result) -> None:
    assert certify(good, CONFIG) == certify(good, CONFIG)


def test_fail_goes_before_inconclusive_before_pass() -> None:
    def some(*verdicts: Verdict) -> list[Certificate]:
        return [Certificate(0, "c", verdict, None, "m") for verdict in verdicts]

    assert overall(some(PASS, INCONCLUSIVE, FAIL)) == FAIL
    assert overall(some(PASS, INCONCLUSIVE, NOT_APPLICABLE)) == INCONCLUSIVE
    assert overall(some(PASS, NOT_APPLICABLE)) == PASS
    assert overall(some(NOT_APPLICABLE)) == NOT_APPLICABLE
