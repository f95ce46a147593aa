"""The re-integrated motion and the proofs over continuous time, against fine simulation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config, parse_config
from istc_replay.datatypes import StaticScene
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.case import Case, build_case
from istc_replay.safety.sweep import Least, least_gap, moving_bodies, standing_bodies
from istc_replay.safety.walls import least_inside, wall_margin
from istc_replay.safety.written_plans import written_plans

from ..support.bicycles import DENSE, Car, random_car, straight_car
from ..support.written import Scene


def case_of(scene: Any, config: Config | None = None) -> Case:
    case = build_case(next(written_plans([scene.result()])), {}, StaticScene(), config or Config())
    assert case is not None
    return case


def nearby_cars(rng: np.random.Generator, count: int) -> list[Any]:
    return [random_car(rng, f"v{i}", 15).moved(*rng.uniform(-8, 8, 2)) for i in range(count)]


@pytest.mark.parametrize("step_s", [0.01, 0.05, 0.2])
def test_the_motion_is_that_of_a_fine_simulation(step_s: float) -> None:
    rng = np.random.default_rng(1)
    cars = nearby_cars(rng, 4)
    motion = case_of(Scene(cars), parse_config(f"[certificate]\nstep_s = {step_s}")).motion
    assert motion.judged.all()
    for row, car in enumerate(cars):
        times = car.times_s(1.0)[:-1]
        piece = np.searchsorted(motion.edges_s, times + 1e-9) - 1
        states = motion.at(np.full(times.size, row), piece, times - motion.edges_s[piece])
        np.testing.assert_allclose(states[:, 3:], car.dense[:-1, 3:], rtol=0, atol=1e-12)
        error = np.hypot(*(states[:, :2] - car.dense[:-1, :2]).T).max()
        assert error < 1e-7
        assert np.abs(states[:, 2] - car.dense[:-1, 2]).max() < 1e-7


def test_bounds_hold_for_the_fine_simulation() -> None:
    rng = np.random.default_rng(2)
    cars = nearby_cars(rng, 6)
    motion = case_of(Scene(cars)).motion
    bodies = moving_bodies(motion)
    for row, car in enumerate(cars):
        h = 0.2 / DENSE
        speed, turn = car.dense[:, 4], car.dense[:, 4] * np.tan(car.dense[:, 3]) / car.dimensions[2]
        centre_velocity = np.diff(car.centres()[:, :2], axis=0) / h
        piece = np.repeat(np.arange(15), DENSE)
        for values, bound in (
            (np.abs(speed[:-1]), motion.bounds[row, piece, 0]),
            (np.abs(car.dense[:-1, 5]), motion.bounds[row, piece, 1]),
            (np.abs(turn[:-1]), motion.bounds[row, piece, 2]),
            (np.abs(np.diff(turn)) / h, motion.bounds[row, piece, 3]),
            (np.hypot(*centre_velocity.T), bodies.speed_mps[row, piece]),
        ):
            assert (values <= bound + 1e-9).all()
        inner = np.nonzero(piece[1:] == piece[:-1])[0]
        centre_acceleration = np.hypot(*np.diff(centre_velocity, axis=0)[inner].T) / h
        assert (centre_acceleration <= bodies.acceleration_mps2[row, piece[inner]] + 1e-6).all()
        corners = np.diff(car.corners(), n=2, axis=0)[inner] / h**2
        reach = np.hypot(abs(car.dimensions[3]) + car.dimensions[0] / 2, car.dimensions[1] / 2)
        bend = motion.point_acceleration(np.full(len(cars), reach))[row, piece[inner]]
        assert (np.abs(corners).max(axis=(1, 2)) <= bend + 1e-6).all()


@pytest.mark.parametrize("seed", range(40))
def test_dense_sampling_never_finds_less_than_the_proven_separation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cars = nearby_cars(rng, 3)
    case = case_of(Scene(cars))
    boxes = [car.boxes() for car in cars]
    dense = {(i, j): box_gap(boxes[i], boxes[j]) for i in range(3) for j in range(i + 1, 3)}
    truth = min(gaps.min() for gaps in dense.values())
    least = least_gap(moving_bodies(case.motion), None, case.motion.edges_s, 0.0, 0.0)
    assert least.proven <= truth + 1e-9
    assert truth - 0.03 <= least.found <= truth + 1e-3  # the samples are 3 ms apart
    if truth > 0.01:
        assert least.proven > 0.0
    # The witness is where it says.
    k = round(least.time_s / 0.2 * DENSE)
    assert dense[least.first, least.second][k] == pytest.approx(least.found, abs=0.03)


@pytest.mark.parametrize("seed", range(40))
def test_dense_sampling_never_finds_less_than_the_proven_distance_from_obstacles(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    cars = nearby_cars(rng, 2)
    centres, sizes = rng.uniform(-15, 15, (4, 3, 2)), rng.uniform(0.2, 3, (4, 3, 2))
    low, high = centres - sizes / 2, centres + sizes / 2
    walls = np.stack([low[..., 0], high[..., 0], low[..., 1], high[..., 1]], axis=-1)
    walls[0, 1] = np.nan
    case = case_of(Scene(cars, obstacles={f"o{i}": rows for i, rows in enumerate(walls)}))
    truth = np.inf
    for car in cars:
        for k in range(3):
            closed = slice(5 * k * DENSE, 5 * (k + 1) * DENSE + 1)
            for i in range(4):
                box = [*centres[i, k], 0.0, *sizes[i, k]]
                if np.isfinite(walls[i, k]).all():
                    truth = min(truth, box_gap(car.boxes()[closed], box).min())
    least = least_gap(
        moving_bodies(case.motion), standing_bodies(case.obstacles_m), case.motion.edges_s, 0.0, 0.0
    )
    assert least.proven <= truth + 1e-9
    assert truth - 0.03 <= least.found <= truth + 1e-3


@pytest.mark.parametrize("seed", range(40))
def test_dense_sampling_never_leaves_a_corridor_that_was_proven(seed: int) -> None:
    rng = np.random.default_rng(200 + seed)
    cars = nearby_cars(rng, 2)
    # Walls that the truth grazes from either side.
    cubes = {
        car.name: car.hulls(1.0, 0.0) + rng.normal(0, 1e-4, (3, 4)) + [-1e-4, 1e-4, -1e-4, 1e-4]
        for car in cars
    }
    case = case_of(Scene(cars, cubes=cubes))
    truth = np.inf
    for car in cars:
        for k in range(3):
            closed = slice(5 * k * DENSE, 5 * (k + 1) * DENSE + 1)
            truth = min(truth, wall_margin(car.boxes()[closed], cubes[car.name][k]).min())
    least = least_inside(case.motion, case.walls_m, 1e-6)
    assert least.proven <= truth + 1e-9
    assert least.found <= truth + 1e-4
    if truth < -2e-5:
        assert least.found < -1e-6
    elif truth > 2e-5:
        assert least.proven >= -1e-6


def test_a_gap_that_is_widest_in_the_middle_is_bounded_by_the_accelerations() -> None:
    # In the middle of the only step the relative speed is zero: 5 m/s against 6 m/s and braking.
    behind = straight_car("a", 0.0, 0.0, 0.0, 5.0, 1)
    ahead = Car("b", np.array([8.0, 0.0, 0.0, 0.0, 6.0, -10.0]), np.zeros((1, 2)), 0.2)
    case = case_of(Scene([behind, ahead], unit_s=0.2))
    least = least_gap(moving_bodies(case.motion), None, case.motion.edges_s, 0.0, 0.0)
    truth = 8.0 + 1.35 - 4.5
    assert least.proven <= truth
    assert least.found == pytest.approx(truth, abs=1e-3)


@pytest.mark.parametrize(
    ("apart_m", "speed_mps", "far_m"),
    # Two that stand beside each other all the time, and two that come nearer to each other by the end.
    [(10.0, 5.0, 20.0), (7.0, 10.0, 29.0)],
)
def test_a_pair_that_is_far_in_the_middle_of_a_step_is_not_left_out(
    apart_m: float, speed_mps: float, far_m: float
) -> None:
    cars = [
        straight_car("a", 0.0, 0.0, 0.0, 0.0, 1, 1.0),
        straight_car("b", 0.0, apart_m, 0.0, 0.0, 1, 1.0),
        straight_car("c", 100.0, 0.0, 0.0, speed_mps, 1, 1.0),
        straight_car("d", 100.0 + far_m, 0.0, np.pi, speed_mps, 1, 1.0),
    ]
    gap = far_m - 2.0 * speed_mps - 4.5
    assert gap < apart_m - 1.9
    case = case_of(Scene(cars))
    least = least_gap(moving_bodies(case.motion), None, case.motion.edges_s, 0.0, 0.0)
    assert (least.first, least.second) == (2, 3)
    assert least.found == pytest.approx(gap, abs=1e-3)


def test_knots_a_rounding_off_a_boundary_are_on_it() -> None:
    scene = Scene([straight_car("a", 0, 0, 0, 5.0, 10)])
    result = scene.result()
    for late_ns in (-700, 700):
        late = (
            pl.when(pl.col("source") == "planned")
            .then(pl.col("time_ns") + late_ns)
            .otherwise(pl.col("time_ns"))
        )
        moved = replace(result, states=result.states.with_columns(late.alias("time_ns")))
        case = build_case(next(written_plans([moved])), {}, StaticScene(), Config())
        assert case is not None
        assert case.motion.present.all()
        assert (case.units >= 0).all()


def test_parallel_traffic_is_proven_at_any_gap() -> None:
    cars = [straight_car(f"v{i}", 2.0 * i, i * (1.9 + 1e-6), 0.0, 8.0, 40) for i in range(4)]
    case = case_of(Scene(cars))
    least = least_gap(moving_bodies(case.motion), None, case.motion.edges_s, 0.0, 0.0)
    assert least.found == pytest.approx(1e-6, abs=1e-9)
    assert least.proven > 0.0


def test_touching_is_never_proven_apart() -> None:
    # A car that passes a wall at a distance of exactly nothing, and of next to nothing.
    for gap in (0.0, 1e-12):
        scene = Scene([straight_car("a", 0, 0, 0.0, 8.0, 40)])
        scene.obstacles = {"wall": np.tile([10.0, 50.0, 0.95 + gap, 3.0], (8, 1))}
        case = case_of(scene)
        least = least_gap(
            moving_bodies(case.motion), standing_bodies(case.obstacles_m), case.motion.edges_s, 0.0, 1e-9
        )
        assert not least.proven > 0.0
        assert least.found == pytest.approx(gap, abs=1e-9)


def test_nothing_to_look_at_is_told_as_such() -> None:
    cars = [straight_car("a", 0, 0, 0, 5.0, 5), straight_car("b", 0, 0, 0, 5.0, 5, first_unit=2)]
    case = case_of(Scene(cars))
    bodies = moving_bodies(case.motion)
    assert least_gap(bodies, None, case.motion.edges_s, 0.0, 0.0) == Least()
    assert least_gap(bodies, standing_bodies(case.obstacles_m), case.motion.edges_s, 0.0, 0.0) == Least()
    assert least_inside(case.motion, np.full_like(case.walls_m, np.nan), 0.0) == Least()


def swinging(heading: float) -> Car:
    """A car whose corners, seven metres ahead of its rear axle, are pulled sideways hard."""
    first = np.array([0.0, 0.0, heading, 1.0, 3.0, 0.0])
    return Car("a", first, np.zeros((5, 2)), 0.2, dimensions=(2.0, 1.0, 1.0, 6.0))


def dip_m(car: Car) -> float:
    """How much higher a corner comes between the instants that are looked at first than at them."""
    highest = car.corners()[..., 1].max(axis=1)
    return float(highest.max() - highest[:: DENSE // 2].max())


def test_a_corner_that_swings_out_between_two_instants_is_found() -> None:
    car = max((swinging(heading) for heading in np.linspace(-np.pi, np.pi, 81)), key=dip_m)
    dip = dip_m(car)
    assert dip > 0.13  # else the test tests nothing
    walls = car.hulls(1.0, 1.0)
    walls[0, 3] = car.corners()[..., 1].max() - dip / 5.0
    truth = wall_margin(car.boxes(), walls[0]).min()
    assert truth == pytest.approx(-dip / 5.0)
    config = parse_config("[certificate]\nstep_s = 0.2\ntolerance_m = 1e-2")
    case = case_of(Scene([car], cubes={"a": walls}), config)
    assert case.motion.judged.all()
    assert case.motion.nodes.shape[2] == 3
    least = least_inside(case.motion, case.walls_m[case.walled_row], 1e-2)
    assert least.proven <= truth + 1e-3
    assert least.found < -1e-2


@pytest.mark.parametrize("overlap_m", [0.1, 3e-4])
@pytest.mark.parametrize("ahead_m", [0.0, 4.0])
def test_a_corner_that_comes_down_on_a_wall_as_the_plan_ends_is_found(
    ahead_m: float, overlap_m: float
) -> None:
    # It turns on the spot, nearly, and its corner is at full speed when it comes to the wall.
    rate = 0.5 * np.tan(1.0) / 0.2
    heading = -np.arctan2(0.5, 3.0 + ahead_m) - 0.2 * rate
    first = np.array([0.0, 0.0, heading, 1.0, 0.5, 0.0])
    car = Car("a", first, np.zeros((1, 2)), 0.2, 0, (6.0, 1.0, 0.2, ahead_m))
    x, y = car.corners()[-1, 0]
    scene = Scene([car], unit_s=0.2)
    scene.obstacles = {"wall": np.array([[x - overlap_m, x + 9.0, y - overlap_m, y + 9.0]])}
    middle = 4.5 - overlap_m / 2.0
    wall = np.array([x + middle, y + middle, 0.0, 9.0 + overlap_m, 9.0 + overlap_m])
    truth = box_gap(car.boxes(), wall)
    assert truth.argmin() == len(truth) - 1
    assert -1.3 * overlap_m < truth.min() < -0.5 * overlap_m
    assert truth[len(truth) // 2] > 0.4
    case = case_of(scene)
    least = least_gap(
        moving_bodies(case.motion), standing_bodies(case.obstacles_m), case.motion.edges_s, 0.0, 0.0
    )
    assert least.proven <= truth.min() + 1e-9
