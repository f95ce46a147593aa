"""Good plans pass every check, what is planted is found, and nothing else passes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.config import parse_config
from istc_replay.datatypes import Certificate, Frame, Result, Verdict
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.certificate import certify, overall
from istc_replay.safety.walls import wall_margin

from ..support.bicycles import DENSE, random_car, stacked, straight_car
from ..support.judged import (
    CONFIG,
    FAIL,
    INCONCLUSIVE,
    NOT_APPLICABLE,
    NS,
    PASS,
    cube,
    edited,
    failed,
    judge,
    knot,
    without,
)
from ..support.written import Scene


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


def test_a_single_vehicle_has_no_pair_and_no_obstacle() -> None:
    checks = judge(Scene([straight_car("a", 0, 0, 0.3, 5.0, 10)]).result())
    absent = {name for name, check in checks.items() if check.verdict == NOT_APPLICABLE}
    pairs = {"cubes_disjoint", "separation", "seam", "lateral"}
    assert absent == pairs | {"obstacles_clear", "obstacles_known", "obstacle_separation", "in_bounds"}
    assert overall(checks.values()) == PASS


@pytest.mark.parametrize("seed", range(100))
def test_random_good_plans_raise_no_false_alarm(seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    unit_s, dt = [(1.0, 0.2), (0.5, 0.25), (0.25, 0.125), (1.0, 0.1)][seed % 4]
    per_unit = round(unit_s / dt)
    cars = [
        random_car(rng, f"v{i}", int(rng.integers(1, 6)) * per_unit, dt, int(rng.integers(0, 3)))
        for i in range(rng.integers(1, 5))
    ]
    origin = rng.uniform(-1, 1, 2) * [7e5, 6e6] if seed % 2 else np.zeros(2)
    frame = Frame(*origin, rng.uniform(-np.pi, np.pi))
    # Next to no margin: the corners touch the cubes' walls but for what the hull's samples miss.
    scene = Scene(stacked(cars, pad=5e-5), unit_s=unit_s, frame=frame, pad=5e-5)
    scene.obstacles = {"below": np.tile([-500.0, 500.0, -5.0, 0.1], (9, 1))}
    checks = judge(scene.result())
    assert overall(checks.values()) == PASS, checks


def test_vehicles_of_different_steps_and_spans_are_judged_together() -> None:
    rng = np.random.default_rng(8)
    cars = [random_car(rng, "a", 30, 0.1), random_car(rng, "b", 14, 1 / 7, 1)]
    checks = judge(Scene(stacked(cars)).result())
    assert overall(checks.values()) == PASS, checks


@pytest.mark.parametrize("status", ["conflict_left", "no_corridors", "not_drivable", "nothing_to_plan"])
def test_a_window_without_a_plan_has_no_certificates(good: Result, status: str) -> None:
    window = good.summary["windows"][0] | {"status": status}
    empty = replace(without(good, "states", pl.col("source") == "planned"), summary={"windows": [window]})
    assert certify(empty, CONFIG) == ()
    assert overall(()) == NOT_APPLICABLE
    # A plan that stands there all the same is judged, whatever the status says.
    assert overall(certify(replace(good, summary={"windows": [window]}), CONFIG)) == PASS


def test_windows_are_judged_one_by_one(good: Result) -> None:
    later = Scene([straight_car("a", 0, 0, 0.0, 5.0, 10)], window=3, start_ns=2_000_000_000 * NS)
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


@pytest.mark.slow
def test_a_thousand_random_good_plans_raise_no_false_alarm() -> None:
    for seed in range(1000):
        rng = np.random.default_rng(50_000 + seed)
        unit_s, dt = [(1.0, 0.2), (0.5, 0.25), (0.25, 0.125), (1.0, 0.1)][seed % 4]
        cars = [
            random_car(rng, f"v{i}", int(rng.integers(1, 6)) * round(unit_s / dt), dt)
            for i in range(rng.integers(2, 5))
        ]
        frame = Frame(*rng.uniform(-1, 1, 2) * [7e5, 6e6], rng.uniform(-np.pi, np.pi))
        scene = Scene(stacked(cars, pad=5e-5), unit_s=unit_s, frame=frame, pad=5e-5)
        checks = judge(scene.result())
        assert overall(checks.values()) == PASS, (seed, checks)


@pytest.mark.parametrize("seeds", [range(30), pytest.param(range(1000), marks=pytest.mark.slow)])
def test_what_passes_is_never_contradicted_by_dense_sampling(seeds: range) -> None:
    passed = failing = 0
    unit = 5 * DENSE  # samples
    for seed in seeds:
        rng = np.random.default_rng(90_000 + seed)
        cars = [random_car(rng, f"v{i}", 15).moved(*rng.uniform(-9, 9, 2)) for i in range(2)]
        # Cubes that the truth grazes from either side, and cars that may meet.
        cubes = {car.name: car.hulls(1.0, 0.0) + rng.normal(0, 2e-5, (3, 4)) for car in cars}
        checks = judge(Scene(cars, cubes=cubes).result())
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


def test_swapped_vehicles_are_found(good: Result) -> None:
    planned, name = pl.col("source") == "planned", pl.col("vehicle_id")
    other = pl.when(name == "a").then(pl.lit("b")).when(name == "b").then(pl.lit("a")).otherwise(name)
    checks = judge(edited(good, "states", planned, vehicle_id=other))
    assert {"in_corridor", "cubes_overlap", "start"} <= failed(checks)
    assert set(checks["in_corridor"].vehicles) <= {"a", "b"}
    assert set(checks["start"].vehicles) <= {"a", "b"}


def test_what_is_too_large_to_judge_is_inconclusive(good: Result) -> None:
    checks = judge(good, parse_config("[certificate]\nstep_s = 1e-9"))
    assert checks.pop("complete").verdict == PASS
    assert {check.verdict for check in checks.values()} == {INCONCLUSIVE}


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("fault", [None, "cube", "knot", "crossing"])
def test_a_moved_and_turned_result_gets_the_same_verdicts(scene: Any, seed: int, fault: str | None) -> None:
    rng = np.random.default_rng(seed)
    frame = Frame(rng.uniform(-8e5, 8e5), rng.uniform(-6e6, 6e6), rng.uniform(-np.pi, np.pi))
    moved = replace(scene, frame=frame, bounds=None, start_ns=int(rng.integers(0, 2**60)))
    plain = replace(scene, bounds=None)
    if fault == "crossing":
        extra = [straight_car("d", 0.0, -5.0, 1.2, 6.0, 25)]
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
