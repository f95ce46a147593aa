"""The rows of layer 1 hold just where the equations hold, each written out once more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors.formulation import default_limits
from istc_replay.corridors.problem import CorridorProblem
from istc_replay.corridors.rows import lateral_rows

SPEED_MAX_MPS = 10.0


@pytest.fixture(params=[1, 2, 3])
def case(request: pytest.FixtureRequest, crossing: Callable[..., Any]) -> Any:
    """One vehicle that drives straight on, in some direction, for four units of a second."""
    return crossing(request.param, vehicles=1, units=4)


def holds(problem: CorridorProblem, z: np.ndarray) -> dict[str, bool]:
    """Whether all rows of each equation hold."""
    value = problem.rows.value(z)
    kept = (problem.rows.lower <= value) & (value <= problem.rows.upper)
    names, counts = zip(*problem.rows.families, strict=True)
    of = np.repeat(names, counts)
    return {name: bool(kept[of == name].all()) for name in set(names)}


def parts(problem: CorridorProblem, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pivotal points (K+1, 2), cubes (K, 4), half car-boxes (K+1, 2)."""
    (block,) = problem.blocks
    pivots = np.vstack([block.start_m, z[block.pivot[1:]]])
    return pivots, z[block.cube], np.asarray(block.half_gamma_m)


def overlaps(pivots: np.ndarray, cubes: np.ndarray, half: np.ndarray) -> bool:
    """Eq. (7), (11): each car-box lies in the cubes on both sides."""
    units = len(cubes)
    return all(
        (pivots[k] - half[k] >= cubes[c, 0::2]).all() and (pivots[k] + half[k] <= cubes[c, 1::2]).all()
        for k in range(1, units + 1)
        for c in (k - 1, k)
        if c < units
    )


def steps(pivots: np.ndarray, heading: float, speed: float, config: Any) -> bool:
    """Eq. (12) of a guidance that drives straight on at a constant speed, a second a unit."""
    limits = default_limits(config)
    ahead = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-ahead[1], ahead[0]])
    step = np.diff(pivots, axis=0)
    along, across, change = step @ ahead, step @ left, np.diff(step, axis=0)
    reach = max(config.forward_m, SPEED_MAX_MPS, speed)
    least, most = np.zeros(len(step)), np.full(len(step), reach)
    least[0] = max(speed - limits.deceleration_mps2 / 2.0, 0.0)
    most[0] = min(reach, speed + limits.acceleration_mps2 / 2.0)
    return bool(
        (along >= least).all()
        and (along <= most).all()
        and (np.abs(across) <= limits.cone * along).all()
        and (change @ ahead >= -limits.deceleration_mps2).all()
        and (change @ ahead <= limits.acceleration_mps2).all()
        and (np.abs(change @ left) <= limits.lateral_acceleration_mps2).all()
    )


def ranges(pivots: np.ndarray, cubes: np.ndarray, half: np.ndarray, heading: float, config: Any) -> bool:
    """Eq. (9), (10): a cube, and the next car-box, stay within the hull of a tube about the pivotal point."""
    ahead = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-ahead[1], ahead[0]])
    reach = max(config.forward_m, SPEED_MAX_MPS)
    corners = [
        s * ahead + w * left
        for s in (-config.backward_m, reach)
        for w in (-1, 1) * np.array(config.sideways_m)
    ]
    for k in range(len(cubes)):
        wide = np.maximum(half[k], half[k + 1])
        low, high = np.min(corners, axis=0) - wide, np.max(corners, axis=0) + wide
        if k and ((cubes[k, 0::2] - pivots[k] < low).any() or (cubes[k, 1::2] - pivots[k] > high).any()):
            return False
        step = pivots[k + 1] - pivots[k]
        if (step - half[k + 1] < low).any() or (step + half[k + 1] > high).any():
            return False
    return True


def test_rows_hold_where_the_equations_hold_and_nowhere_else(case: Any) -> None:
    problem, participant = case.problem(), case.scenario.participants[0]
    heading, speed = participant.start.heading_rad, participant.start.speed_mps
    random = np.random.default_rng(4)
    seen: dict[str, set[bool]] = {"eq. (7), (11)": set(), "eq. (9), (10)": set(), "eq. (12)": set()}
    least = problem.least_cubes(np.array(problem.reference))
    for _ in range(1000):
        z = least + random.normal(0.0, random.choice([0.02, 0.2, 1.0]), problem.size)
        z[problem.blocks[0].cube] += np.array([-1.0, 1.0, -1.0, 1.0]) * random.uniform(0.0, 12.0)
        pivots, cubes, half = parts(problem, z)
        expected = {
            "eq. (7), (11)": overlaps(pivots, cubes, half),
            "eq. (9), (10)": ranges(pivots, cubes, half, heading, case.config),
            "eq. (12)": steps(pivots, heading, speed, case.config),
        }
        assert holds(problem, z) == expected
        for name, kept in expected.items():
            seen[name].add(kept)
    assert all(found == {True, False} for found in seen.values())


@pytest.mark.parametrize(
    ("reach_m", "room_m", "kept_m"),
    [(1.5, 0.0, 1.2), (0.5, 0.0, 0.4), (1.5, 0.4, 0.8), (0.5, 0.6, 0.0), (-0.2, 0.0, 0.0)],
)
def test_a_lateral_bound_leaves_layer_2_a_fifth_of_the_room_or_three_tenths_of_a_metre(
    case: Any, reach_m: float, room_m: float, kept_m: float
) -> None:
    problem, guide = case.problem(), case.guidance[0]
    (block,) = problem.blocks
    path = np.array(guide.points_m)
    rows = lateral_rows(block, guide, path, np.full((len(path), 2), reach_m), room_m)
    left = np.array([-np.sin(guide.headings_rad[1]), np.cos(guide.headings_rad[1])])
    for aside, inside in ((max(kept_m - 1e-6, 0.0), True), (kept_m + 1e-6, False)):
        for sign in (1.0, -1.0):
            z = np.array(problem.reference)
            z[block.pivot[2]] += sign * aside * left
            value = rows.value(z)
            assert bool(((rows.lower - 1e-9 <= value) & (value <= rows.upper + 1e-9)).all()) == inside


def test_what_can_be_reached_is_within_the_map(crossing: Callable[..., Any]) -> None:
    case = crossing(2, vehicles=1, units=4)
    free = case.problem()
    bounds = (-14.0, 5.0, -13.0, 6.0)
    held = replace(case, scenario=replace(case.scenario, bounds_m=bounds)).problem()
    (block,) = held.blocks
    low, high = np.array(bounds[0::2]), np.array(bounds[1::2])
    pivots, half = block.pivot[1:], block.half_gamma_m[1:]
    np.testing.assert_allclose(held.lower[pivots], np.maximum(free.lower[pivots], low + half))
    np.testing.assert_allclose(held.upper[pivots], np.minimum(free.upper[pivots], high - half))
    assert (held.upper[pivots] < free.upper[pivots] - 1e-6).any()
    assert (held.lower[block.cube[:, 0::2]] >= low - 1e-9).all()
    assert (held.upper[block.cube[:, 1::2]] <= high + 1e-9).all()
