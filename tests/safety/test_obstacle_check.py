"""Obstacles that a result keeps silent about are found, whatever it keeps clear of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config
from istc_replay.datatypes import Certificate, Result, SceneObstacle, StaticScene, Verdict
from istc_replay.safety.certificate import certify

from ..support.bicycles import straight_car
from ..support.written import Scene

WALL = SceneObstacle("wall", 5.0, -4.0, 0.3, 3.0, 1.0)
HULL = (3.0, 7.0, -5.5, -2.6)  # covers the turned wall


def result_of(boxes: dict[str, Any], standing: tuple[SceneObstacle, ...]) -> Result:
    scene = Scene([straight_car("a", 0, 0, 0.0, 5.0, 25)])
    scene.obstacles = {name: np.tile(box, (5, 1)) for name, box in boxes.items()}
    return replace(scene.result(), scene=StaticScene(obstacles=standing))


def check(result: Result) -> Certificate:
    return next(c for c in certify(result, Config()) if c.check == "obstacles_known")


def test_a_covered_obstacle_passes_and_without_any_the_check_does_not_apply() -> None:
    assert check(result_of({"wall": HULL}, (WALL,))).verdict == Verdict.PASS
    assert check(result_of({}, ())).verdict == Verdict.NOT_APPLICABLE


def test_a_missing_and_a_moved_obstacle_are_found() -> None:
    missing = check(result_of({"other": HULL}, (WALL,)))
    assert (missing.verdict, missing.vehicles, missing.margin) == (Verdict.FAIL, ("wall",), None)
    moved = check(result_of({"wall": np.add(HULL, [2.0, 2.0, 0.0, 0.0])}, (WALL,)))
    assert (moved.verdict, moved.vehicles) == (Verdict.FAIL, ("wall",))
    assert moved.margin is not None
    assert moved.margin == pytest.approx(5.0 - 1.5 * np.cos(0.3) - 0.5 * np.sin(0.3) - 5.0, abs=1e-9)


def test_an_obstacle_that_is_gone_for_one_time_unit_is_found() -> None:
    result = result_of({"wall": HULL}, (WALL,))
    gone = check(replace(result, obstacles=result.obstacles.filter(pl.col("k") != 3)))
    assert (gone.verdict, gone.time_s) == (Verdict.FAIL, 3.0)


@pytest.mark.parametrize(("shift", "verdict"), [(0.0, Verdict.PASS), (6.0, Verdict.FAIL)])
@pytest.mark.parametrize(
    ("left", "reason"), [("exclusions", "not_a_vehicle"), ("exclusions", "parked"), ("frozen", "no_relation")]
)
def test_road_users_that_stay_as_recorded_are_in_their_boxes(
    left: str, reason: str, shift: float, verdict: Verdict
) -> None:
    result = result_of({"walker": HULL}, ())
    walker = result.states.filter(pl.col("source") == "recorded").with_columns(
        vehicle_id=pl.lit("walker"), x_m=pl.lit(5.0 + shift), y_m=pl.lit(-4.0), role=pl.lit("pedestrian")
    )
    left_out = [{"vehicle_id": "walker", "reason": reason, "detail": ""}]
    window = {**result.summary["windows"][0], left: left_out}
    changed = replace(result, states=pl.concat([result.states, walker]), summary={"windows": [window]})
    assert check(changed).verdict == verdict


@pytest.mark.parametrize("out", [0.0, 5.0])
def test_a_road_user_is_in_its_box_at_the_first_and_the_last_instant_too(out: float) -> None:
    result = result_of({"walker": HULL}, ())
    start_ns = result.summary["windows"][0]["start_ns"]
    edge = start_ns + round(out * 1e9)
    walker = result.states.filter(pl.col("source") == "recorded").with_columns(
        vehicle_id=pl.lit("walker"),
        x_m=pl.when(pl.col("time_ns") == edge).then(50.0).otherwise(5.0),
        y_m=pl.lit(-4.0),
    )
    frozen = [{"vehicle_id": "walker", "reason": "no_relation", "detail": ""}]
    window = {**result.summary["windows"][0], "frozen": frozen}
    found = check(replace(result, states=pl.concat([result.states, walker]), summary={"windows": [window]}))
    assert (found.verdict, found.vehicles, found.time_s) == (Verdict.FAIL, ("walker",), out)
