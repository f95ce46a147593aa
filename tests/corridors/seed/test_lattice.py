"""The dynamic programme finds the cheapest motion, and only drivable ones."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from istc_replay.corridors.seed.lattice import Motion

SLOWER, FASTER = 2, 1  # places a unit by which a step of half a second may change


def test_the_best_motion_is_the_cheapest_of_all_on_its_path_by_enumeration(meeting: Any) -> None:
    lattice = meeting([(-15.0, 0.0, 0.0)], units=4)[2][0]
    _, steps, places, paths = lattice.shape
    random = np.random.default_rng(0)
    dear = (
        random.random((2, 4, steps, steps + places, paths)) < 0.3
    )  # of two others; places before the start too
    others = [[np.flatnonzero(unit) for unit in other] for other in dear]
    best = lattice.best(others, 200.0)
    price = 200.0 * dear.sum(axis=0)[:, :, steps:]
    cheapest = np.inf
    for chosen in product(range(steps), repeat=4):
        changes = np.diff(chosen)
        if chosen[0] in (4, 5, 6) and changes.min() >= -SLOWER and changes.max() <= FASTER:
            at = np.concatenate([[0], np.cumsum(chosen)])
            prices = price[np.arange(4), chosen, at[:-1], best.path].sum()
            cost = lattice.own_cost(Motion(best.path, at, best.cubes_m, 0.0)) + float(prices)
            cheapest = min(cheapest, cost)
    assert abs(best.cost - cheapest) < 1e-4 * cheapest
    assert best.cost > lattice.best([], 0.0).cost
    assert lattice.best(others, 200.0).places.tolist() == best.places.tolist()


def test_a_motion_ends_at_the_goal_and_brakes_no_harder_than_it_may(meeting: Any) -> None:
    lattice = meeting([(-15.0, 0.0, 0.0)])[2][0]
    best = lattice.best([], 0.0)
    assert np.allclose(lattice.poses(best)[-1, :2], [15.0, 0.0], atol=1e-6)
    changes = np.diff(np.diff(best.places))
    assert changes.min() >= -SLOWER
    assert changes.max() <= FASTER


def test_cubes_hold_the_car_at_both_ends_of_each_unit(meeting: Any) -> None:
    lattice = meeting([(-15.0, 3.0, 0.0)])[2][0]
    best = lattice.best([], 0.0)
    x = lattice.poses(best)[:, 0]
    assert (best.cubes_m[:, 0] <= x[:-1] - 1.99).all()
    assert (best.cubes_m[:, 1] >= x[1:] + 1.99).all()


def test_a_priced_meeting_is_avoided(meeting: Any) -> None:
    lattice = meeting([(-15.0, 0.0, 0.0)])[2][0]
    box = np.array([[-2.0, 2.0, -25.0, 25.0]])
    met = lattice.meeting(np.repeat(box, 10, axis=0), 0, 0.3)
    best = lattice.best([met], 1e6)
    assert (best.cubes_m[:10, 1] <= -2.3 + 2e-3).all()
