"""A plan that is handed over must start where the plan before has led, in state and controls."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.datatypes import Certificate, Frame, Result
from istc_replay.geometry import to_frame
from istc_replay.safety.certificate import certify

from ..support.bicycles import DENSE, Car, random_car
from ..support.judged import CONFIG, FAIL, INCONCLUSIVE, NOT_APPLICABLE, NS, PASS
from ..support.written import Scene

OF_SECOND = (pl.col("source") == "planned") & (pl.col("window") == 1)


def seam(result: Result) -> Certificate:
    """The check of the second window."""
    return next(c for c in certify(result, CONFIG) if c.check == "seam" and c.window == 1)


def led_on(car: Car, steps: int, frame: Frame) -> Car:
    """What is left of a car's motion after so many steps, in another frame."""
    first = car.dense[steps * DENSE].copy()
    first[:2], first[2] = to_frame(first[:2], frame), first[2] - frame.yaw_rad
    return replace(car, first=first, controls=car.controls[steps:])


def handed_over(cars: list[Car], frame: Frame, gone: int = 10) -> Result:
    """Two windows: the cars, and the cars after 10 steps of 0.2 s in a frame of its own, handed over."""
    one = Scene(cars)
    later = [led_on(car, gone, frame) for car in cars]
    two = Scene(later, frame=frame, start_ns=one.start_ns + gone * NS // 5, window=1)
    first, second = one.result(), two.result()
    told = [{"id": car.name, "start": "handed_over"} for car in cars]
    windows = first.summary["windows"] + [second.summary["windows"][0] | {"vehicles": told}]
    planned = second.states.filter(pl.col("source") == "planned")
    return replace(
        first,
        states=pl.concat([first.states, planned]),
        corridors=pl.concat([first.corridors, second.corridors]),
        summary={"windows": windows},
    )


@pytest.fixture(scope="module")
def cars() -> list[Car]:
    rng = np.random.default_rng(21)
    return [random_car(rng, name, 25).moved(0.0, 60.0 * k) for k, name in enumerate("ab")]


@pytest.mark.parametrize("yaw_rad", [0.0, 2.5, -3.0])
def test_a_plan_that_goes_on_passes_in_any_frame(cars: list[Car], yaw_rad: float) -> None:
    check = seam(handed_over(cars, Frame(400.0, -70.0, yaw_rad)))
    assert check.verdict == PASS
    assert check.margin == pytest.approx(1e-3, abs=1e-6)


@pytest.mark.parametrize(
    ("column", "change", "unit"),
    [
        ("x_m", 2e-3, "m"),
        ("y_m", -2e-3, "m"),
        ("heading_rad", 2e-3, "rad"),
        ("steering_rad", -2e-3, "rad"),
        ("speed_mps", 2e-3, "m/s"),
        ("acceleration_mps2", -2e-3, "m/s^2"),
    ],
)
def test_a_seam_that_is_torn_in_any_quantity_fails(
    cars: list[Car], column: str, change: float, unit: str
) -> None:
    result = handed_over(cars, Frame(400.0, -70.0, 0.4))
    torn = OF_SECOND & (pl.col("vehicle_id") == "b")
    value = pl.when(torn).then(pl.col(column) + change).otherwise(pl.col(column))
    check = seam(replace(result, states=result.states.with_columns(value.alias(column))))
    assert (check.verdict, check.vehicles, check.unit) == (FAIL, ("b",), unit)
    assert check.margin == pytest.approx(1e-3 - abs(change), abs=1e-6)


def without_plan_before(result: Result) -> Result:
    planned = (pl.col("source") == "planned") & (pl.col("window") == 0) & (pl.col("vehicle_id") == "b")
    return replace(result, states=result.states.filter(~planned))


def without_own_plan(result: Result) -> Result:
    return replace(result, states=result.states.filter(~(OF_SECOND & (pl.col("vehicle_id") == "b"))))


def with_window_between(result: Result) -> Result:
    """The second window is the third: nothing is known of the one before it."""
    third = {name: pl.col("window").replace(1, 2) for name in ("window",)}
    first, second = result.summary["windows"]
    return replace(
        result,
        states=result.states.with_columns(**third),
        corridors=result.corridors.with_columns(**third),
        summary={"windows": [first, second | {"index": 2}]},
    )


@pytest.mark.parametrize(
    ("change", "window", "vehicles"),
    [
        (without_plan_before, 1, ("b",)),
        (without_own_plan, 1, ("b",)),
        (with_window_between, 2, ("a", "b")),
    ],
)
def test_a_seam_of_which_one_side_is_not_known_is_not_judged(
    cars: list[Car], change: Any, window: int, vehicles: tuple[str, ...]
) -> None:
    result = change(handed_over(cars, Frame()))
    check = next(c for c in certify(result, CONFIG) if c.check == "seam" and c.window == window)
    assert (check.verdict, check.vehicles) == (INCONCLUSIVE, vehicles)


def test_a_plan_before_that_ends_earlier_is_not_judged(cars: list[Car]) -> None:
    result = handed_over(cars, Frame(), gone=10)
    start_ns = Scene([]).start_ns
    short = (pl.col("source") == "planned") & (pl.col("window") == 0)
    cut = result.states.filter(~(short & (pl.col("time_ns") > start_ns + NS)))
    of_cut = result.corridors.filter((pl.col("window") == 1) | (pl.col("k") == 0))
    check = seam(replace(result, states=cut, corridors=of_cut))
    assert (check.verdict, check.vehicles) == (INCONCLUSIVE, ("a", "b"))


def test_who_is_not_handed_over_has_no_seam(cars: list[Car]) -> None:
    result = handed_over(cars, Frame())
    first, second = result.summary["windows"]
    alone = [{"id": "a", "start": "recording"}, {"id": "b", "start": "recording"}]
    told = replace(result, summary={"windows": [first, second | {"vehicles": alone}]})
    assert seam(told).verdict == NOT_APPLICABLE
