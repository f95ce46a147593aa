"""The dynamic programme finds the cheapest motion, and only drivable ones."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from istc_replay.corridors.seed.lattice import Motion

SLOWER, FASTER = 2, 1  # places a unit by which a step of half a second may change


def test_the_best_motion_is_the_cheapest_of_all_on_its_path_by_enumeration(meeting: Any) -> None:
    lattice = meeting([(-15.0, 0.0, 0.0)], units=4)[2][0]
    price = np.random.default_rng(0).uniform(0.0, 500.0, lattice.shape).astype(np.float32)
    best = lattice.best(price)
    cheapest = np.inf
    for steps in product(range(lattice.shape[3]), repeat=4):
        changes = np.diff(steps)
        if steps[0] in (4, 5, 6) and changes.min() >= -SLOWER and changes.max() <= FASTER:
            places = np.concatenate([[0], np.cumsum(steps)])
            prices = price[np.arange(4), best.path, places[:-1], steps].sum()
            cost = lattice.own_cost(Motion(best.path, places, best.cubes_m, 0.0)) + float(prices)
            cheapest = min(cheapest, cost)
    assert abs(best.cost - cheapest) < 1e-4 * cheapest


def test_a_motion_ends_at_the_goal_and_brakes_no_harder_than_it_may(meeting: Any) -> None:
    lattice = meeting([(-15.0, 0.0, 0.0)])[2][0]
    best = lattice.best(np.zeros(lattice.shape, dtype=np.float32))
    assert np.allclose(lattice.poses(best)[-1, :2], [15.0, 0.0], atol=1e-6)
    changes = np.diff(np.diff(best.places))
    assert changes.min() >= -SLOWER
    assert changes.max() <= FASTER


def test_cubes_hold_the_car_at_both_ends_of_each_unit(meeting: Any) -> None:
    lattice = meeting([(-15.0, 3.0, 0.0)])[2][0]
    best = lattice.best(np.zeros(lattice.shape, dtype=np.float32))
    x = lattice.poses(best)[:, 0]
    assert (best.cubes_m[:, 0] <= x[:-1] - 1.99).all()
    assert (best.cubes_m[:, 1] >= x[1:] + 1.99).all()


def test_a_priced_meeting_is_avoided(meeting: Any) -> None:
    lattice = meeting([(-15.0, 0.0, 0.0)])[2][0]
    box = np.array([[-2.0, 2.0, -25.0, 25.0]])
    first = lattice.overlaps(np.repeat(box, 10, axis=0), 0, 0.3)
    best = lattice.best(np.float32(1e6) * first)
    assert (best.cubes_m[:10, 1] <= -2.3 + 2e-3).all()
