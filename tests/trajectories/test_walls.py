"""Walls around a car-box: at instants, at unit boundaries, and in continuous time."""

from __future__ import annotations

import numpy as np
import pytest

from istc_replay.config import TrajectoriesConfig
from istc_replay.geometry import box_corners, shift_along
from istc_replay.trajectories.walls import Grid, base_margins, excess, raised, walls_at

from ..support.integrators import simulate
from ..support.participants import CAR

GRID = Grid(units=2, per_unit=2, step_s=0.5)


@pytest.mark.parametrize(
    ("unit_s", "step_s", "per_unit"),
    [(1.0, 0.2, 5), (0.5, 0.2, 2), (0.25, 0.2, 2), (0.3, 0.1, 3), (0.125, 0.2, 1), (1.0, 0.3, 3)],
)
def test_a_unit_is_cut_into_intervals_as_near_as_divide_it(
    unit_s: float, step_s: float, per_unit: int
) -> None:
    grid = Grid.cut(4, unit_s, TrajectoriesConfig(step_s=step_s))
    assert grid.per_unit == per_unit
    assert grid.step_s == pytest.approx(unit_s / per_unit)
    assert grid.knots_s[-1] == pytest.approx(4 * unit_s)


def test_at_a_unit_boundary_both_cubes_hold() -> None:
    cubes = np.array([[0.0, 10.0, -2.0, 2.0], [5.0, 15.0, -1.0, 3.0]])
    walls = walls_at(GRID, cubes, np.zeros((2, 4)), np.zeros((4, 4)))
    assert np.array_equal(walls[0], cubes[0])
    assert walls[1].tolist() == [5.0, 10.0, -1.0, 2.0]
    assert np.array_equal(walls[2:], np.repeat(cubes[1:], 2, axis=0))


def test_margins_and_extra_margins_move_walls_inward() -> None:
    cubes = np.array([[0.0, 10.0, -2.0, 2.0]] * 2)
    extra = np.zeros((4, 4))
    extra[2, 0] = 0.5
    walls = walls_at(GRID, cubes, np.full((2, 4), 0.1), extra)
    assert walls[0] == pytest.approx([0.1, 9.9, -1.9, 1.9])
    assert walls[2] == pytest.approx([0.6, 9.9, -1.9, 1.9])


def test_margins_ask_for_half_of_what_the_pivots_leave_beyond_a_sliver() -> None:
    pivots, headings = np.array([[0.0, 0.0], [1.0, 0.0]]), np.zeros(2)
    cube = np.array([[-2.0, 3.5, -1.01, 5.0]])
    margins = base_margins(cube, pivots, headings, CAR, 0.02)
    assert margins[0] == pytest.approx([0.0, 0.02, 0.004, 0.02], abs=1e-6)


def test_margins_are_none_where_a_pivots_box_sticks_out() -> None:
    margins = base_margins(np.array([[-1.0, 1.0, -1.0, 1.0]]), np.zeros((2, 2)), np.zeros(2), CAR, 0.02)
    assert margins == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_the_excess_bounds_the_true_excess_closely(seed: int) -> None:
    random = np.random.default_rng(seed)
    grid = Grid(units=2, per_unit=5, step_s=0.2)
    start = np.array([0.0, 0.0, random.uniform(-3, 3), random.uniform(-0.3, 0.3), 6.0, 1.0])
    controls = random.uniform([-0.8, -4.0], [0.8, 4.0], size=(10, 2))
    cubes = random.uniform(-3.0, 3.0, size=(2, 4))
    bound = excess(grid, start, controls, CAR, cubes)

    states = simulate(start, np.repeat(controls, 200, axis=0), 1e-3, CAR.wheelbase_m)  # (2001, 6)
    centres = shift_along(*states[:, :3].T, CAR.rear_axle_to_centre_m)
    corners = box_corners(*centres.T, states[:, 2], CAR.length_m, CAR.width_m)
    for interval in range(10):
        seen = corners[200 * interval : 200 * interval + 201].reshape(-1, 2)
        x_min, x_max, y_min, y_max = cubes[interval // 5]
        (low_x, low_y), (high_x, high_y) = seen.min(axis=0), seen.max(axis=0)
        true = np.array([x_min - low_x, high_x - x_max, y_min - low_y, high_y - y_max])
        assert (bound[interval] >= true - 1e-6).all()
        assert (bound[interval] <= true + 1e-3).all()


def test_extra_margins_rise_at_both_ends_of_an_interval_that_bulges() -> None:
    out = np.full((4, 4), -1.0)
    out[2, 1] = 0.01
    extra = raised(np.zeros((4, 4)), out)
    assert np.flatnonzero(extra[:, 1]).tolist() == [1, 2]
    assert extra[2, 1] > 0.01
    assert not extra[:, [0, 2, 3]].any()
