"""What lies nearer to its limit than the re-integration can tell is inconclusive, never a pass."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.config import parse_config
from istc_replay.datatypes import Result, StaticScene, Verdict
from istc_replay.safety.case import Case, build_case
from istc_replay.safety.cube_checks import cubes_overlap
from istc_replay.safety.motion import integrate
from istc_replay.safety.motion_checks import dynamics, in_corridor, obstacle_separation, separation
from istc_replay.safety.written_plans import written_plans

from ..support.bicycles import Car, straight_car
from ..support.judged import FAIL, INCONCLUSIVE, PASS, edited, judge, knot
from ..support.written import Scene

#: An error of the integration far above rounding [m].
ERROR_M = 1e-4
TOLERANCE = "[certificate]\ntolerance_m = 1e-6\n"


def case_of(result: Result, config: str = TOLERANCE, error_m: float = ERROR_M) -> Case:
    """The case of a result whose motions are known to an error."""
    case = build_case(next(written_plans([result])), {}, StaticScene(), parse_config(config))
    assert case is not None
    assert case.motion.judged.all()
    return replace(case, motion=replace(case.motion, error_m=np.full_like(case.motion.error_m, error_m)))


def car(name: str, y_m: float = 0.0, speed_mps: float = 5.0) -> Car:
    """A car 2 m wide that drives straight on for three seconds."""
    return replace(straight_car(name, 0.0, y_m, 0.0, speed_mps, 15), dimensions=(4.5, 2.0, 2.7, 1.35))


def walls(spare_m: float) -> np.ndarray:
    """Cubes (3, 4) with so much room at their sides."""
    return np.tile([-10.0, 30.0, -1.0 - spare_m, 1.0 + spare_m], (3, 1))


#: Of a pair the errors of both count.
CASES = [(0.0, FAIL), (ERROR_M, INCONCLUSIVE), (1.9 * ERROR_M, INCONCLUSIVE), (2.1 * ERROR_M, PASS)]


@pytest.mark.parametrize(("gap_m", "verdict"), CASES)
def test_two_boxes_are_apart_by_more_than_both_their_errors(gap_m: float, verdict: Verdict) -> None:
    result = Scene([car("a"), car("b", 2.0 + gap_m)]).result()
    check = separation(case_of(result))
    assert check.verdict == verdict
    assert ("cannot be decided" in check.detail) == (verdict == INCONCLUSIVE)
    asked = Scene([car("a"), car("b", 2.5 + gap_m)]).result()
    assert separation(case_of(asked, TOLERANCE + "separation_m = 0.5")).verdict == verdict


@pytest.mark.parametrize(("gap_m", "verdict"), CASES)
def test_a_box_is_farther_from_an_obstacle_than_its_error(gap_m: float, verdict: Verdict) -> None:
    wall = np.tile([-90.0, 90.0, 1.0 + gap_m, 3.0 + gap_m], (3, 1))
    assert (
        obstacle_separation(
            case_of(Scene([car("a", speed_mps=0.0)], obstacles={"wall": wall}).result())
        ).verdict
        == verdict
    )


@pytest.mark.parametrize("check", [in_corridor, cubes_overlap])
@pytest.mark.parametrize(
    ("spare_m", "verdict"),
    [(-2e-6, FAIL), (0.0, INCONCLUSIVE), (0.9 * ERROR_M, INCONCLUSIVE), (1.1 * ERROR_M, PASS)],
)
def test_a_box_is_inside_its_cube_by_more_than_its_error(
    check: Any, spare_m: float, verdict: Verdict
) -> None:
    result = Scene([car("a")], cubes={"a": walls(spare_m)}).result()
    assert check(case_of(result)).verdict == verdict


@pytest.mark.parametrize(
    ("spare_m", "verdict"), [(-1e-6, FAIL), (0.9 * ERROR_M, INCONCLUSIVE), (1.1 * ERROR_M, PASS)]
)
def test_knots_drift_by_less_than_is_allowed_less_the_error(spare_m: float, verdict: Verdict) -> None:
    result = Scene([car("a")]).result()
    moved = edited(result, "states", knot(result, "a", 15), x_m=pl.col("x_m") + 0.02)
    config = f"[certificate]\ndrift_tolerance_m = {0.02 + spare_m!r}"
    assert dynamics(case_of(moved, config)).verdict == verdict


def test_the_error_is_above_that_of_a_fine_simulation_and_a_worse_one_is_not_judged() -> None:
    turning = Car("a", np.array([0.0, 0.0, 0.3, 0.1, 7.0, 0.0]), np.tile([[0.15, 0.5]], (15, 1)), 0.2)
    plan = next(written_plans([Scene([turning]).result()])).plans["a"]
    found = {
        (step_s, tolerance_m): integrate([plan], plan.knots_ns, step_s, tolerance_m)
        for step_s, tolerance_m in ((0.01, 1e-6), (0.2, 1e-6), (0.2, 1e-15))
    }
    fine, coarse, strict = found.values()
    assert fine is not None
    assert coarse is not None
    assert strict is not None
    rear = coarse.nodes[0, -1, -1]
    reach = np.hypot(1.35 + 4.5 / 2.0, 1.9 / 2.0)
    off = np.hypot(*(rear[:2] - turning.dense[-1, :2])) + reach * abs(rear[2] - turning.dense[-1, 2])
    assert 1e-12 < off <= coarse.error_m[0]
    assert fine.error_m[0] < coarse.error_m[0] / 100.0
    assert (fine.judged.all(), coarse.judged.all(), strict.judged.any()) == (True, True, False)


def test_a_motion_that_cannot_be_integrated_well_enough_passes_nothing() -> None:
    turning = Car("a", np.array([0.0, 0.0, 0.3, 0.1, 7.0, 0.0]), np.tile([[0.15, 0.5]], (15, 1)), 0.2)
    checks = judge(
        Scene([turning]).result(), parse_config("[certificate]\nstep_s = 0.2\ntolerance_m = 1e-13")
    )
    for name in ("cubes_overlap", "dynamics", "limits", "in_corridor"):
        assert (name, checks[name].verdict, checks[name].vehicles) == (name, INCONCLUSIVE, ("a",))
