"""Cubes too near, too little in common, in an obstacle or off the map are found."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.datatypes import Frame, MapBounds, Result, Verdict
from istc_replay.safety.certificate import overall

from ..support.bicycles import random_car, stacked, straight_car
from ..support.judged import FAIL, INCONCLUSIVE, NOT_APPLICABLE, PASS, cube, edited, failed, judge
from ..support.written import Scene


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
def test_a_cube_moved_by_five_centimetres_is_found(moved_m: float) -> None:
    # Cubes exactly the promised gap apart, each with 2 cm to spare about its box.
    rng = np.random.default_rng(4)
    cars = stacked([random_car(rng, name, 20) for name in "abc"], pad=0.02)
    result = Scene(cars, pad=0.02).result()
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


@pytest.mark.parametrize(("short_m", "verdict"), [(0.0, PASS), (5e-7, PASS), (1e-5, FAIL)])
def test_the_promised_gap_is_held_to_the_tolerance(short_m: float, verdict: Verdict) -> None:
    cars = [straight_car("a", 0, 0, 0.0, 5.0, 5), straight_car("b", 0, 4, 0.0, 5.0, 5)]
    cubes = {"a": [[-5.0, 10.0, -2.0, 1.5]], "b": [[-5.0, 10.0, 1.8 - short_m, 6.0]]}
    result = Scene(cars, cubes={name: np.array(rows) for name, rows in cubes.items()}).result()
    check = judge(result)["cubes_disjoint"]
    assert check.verdict == verdict
    assert check.margin == pytest.approx(-short_m, abs=1e-12)


@pytest.mark.parametrize("kept", [None, 0.05, -1.0, np.nan, "0", True])
@pytest.mark.parametrize(("of", "promise"), [("vehicle", 0.3), ("obstacle", 0.2)])
def test_gaps_are_those_of_the_summary_and_where_it_promises_none_of_the_settings(
    of: str, promise: float, kept: Any
) -> None:
    # 4 m above the car a second one, and 4 m below it a wall; the cubes are 0.1 m from both.
    cars = [straight_car("a", 0, 0, 0.0, 5.0, 5), straight_car("b", 0, 4, 0.0, 5.0, 5)]
    cubes = {"a": np.array([[-5.0, 10.0, -2.0, 1.9]]), "b": np.array([[-5.0, 10.0, 2.0, 6.0]])}
    result = Scene(cars, cubes=cubes, obstacles={"wall": np.array([[-9.0, 20.0, -4.0, -2.1]])}).result()
    window = result.summary["windows"][0] | {f"{of}_gap_m": kept}
    checks = judge(replace(result, summary={"windows": [window]}))
    check = checks["cubes_disjoint" if of == "vehicle" else "obstacles_clear"]
    held = kept if kept == 0.05 else promise
    assert check.margin == pytest.approx(0.1 - held, abs=1e-9)
    assert check.verdict == (PASS if held < 0.1 else FAIL)


def test_cubes_that_do_not_overlap_enough_are_found() -> None:
    car = straight_car("a", 0, 0, 0.0, 5.0, 10)
    walls = car.hulls(1.0, 0.0)
    walls[1, 0] += 0.5  # the box's rear is outside of the second cube at the switch
    checks = judge(Scene([car], cubes={"a": walls}).result())
    assert failed(checks) == {"cubes_overlap", "in_corridor"}
    assert checks["cubes_overlap"].time_s == pytest.approx(1.0)
    assert checks["cubes_overlap"].margin == pytest.approx(-0.5, abs=1e-9)


def test_an_overlapped_obstacle_is_found() -> None:
    car = straight_car("a", 0, 0, 0.0, 5.0, 25)
    boxes = np.full((5, 4), np.nan)
    boxes[3] = [18.5, 19.0, 0.9, 4.0]  # grazes the car's left side, only in unit 3
    checks = judge(Scene([car], obstacles={"block": boxes}).result())
    assert failed(checks) == {"obstacles_clear", "obstacle_separation"}
    assert checks["obstacles_clear"].time_s == 3.0
    check = checks["obstacle_separation"]
    assert check.time_s is not None
    assert 3.0 <= check.time_s <= 4.0
    assert check.margin == pytest.approx(-0.05, abs=1e-3)
    assert "'block'" in check.detail
    boxes = np.roll(boxes, -2, axis=0)  # the same box while the car is elsewhere
    assert judge(Scene([car], obstacles={"block": boxes}).result())["obstacle_separation"].verdict == PASS


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


def test_crossing_vehicles_are_found_whatever_their_cubes() -> None:
    cars = [
        straight_car("a", -10.0, 0.0, 0.0, 5.0, 20),
        straight_car("b", 0.0, -10.0, np.pi / 2, 5.0, 20),
        straight_car("c", 0.0, 30.0, 0.0, 5.0, 20),
    ]
    checks = judge(Scene(cars).result())
    assert failed(checks) == {"cubes_disjoint", "separation"}
    check = checks["separation"]
    assert check.vehicles == ("a", "b")
    assert check.time_s == pytest.approx(2.0, abs=0.3)
    assert check.margin is not None
    assert check.margin < -1.0


@pytest.mark.parametrize("yaw", [0.0, np.pi / 2, -np.pi, 0.4])
def test_leaving_the_map_is_found(yaw: float) -> None:
    frame = Frame(500.0, -300.0, yaw)
    car = straight_car("a", 0, 0, -yaw, 5.0, 10)  # drives east in the map: x up to 500 + 10 + 2.25
    for x_max, verdict in ((512.5, PASS), (512.0, FAIL)):
        bounds = MapBounds(490.0, x_max, -310.0, np.inf)
        check = judge(Scene([car], frame=frame, bounds=bounds).result())["in_bounds"]
        assert check.verdict == verdict
        assert check.vehicles == ("a",)
        if verdict == FAIL:
            assert check.margin == pytest.approx(-0.25 - (0.0 if yaw == 0.4 else 0.05), abs=1e-6)
