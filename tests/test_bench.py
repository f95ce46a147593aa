"""Measuring scenes, and perturbing them."""

from __future__ import annotations

import numpy as np
import pytest

from istc_replay.bench import PERTURBED_M, PERTURBED_RAD, perturbed
from istc_replay.geometry import box_corners, shift_along
from istc_replay.samples.scenes import packaged_scene


@pytest.mark.parametrize("seed", range(8))
def test_perturbed_cars_stay_near_and_within_the_map(seed: int) -> None:
    scene = packaged_scene("dense_4")
    moved = perturbed(scene, seed)
    car = scene.vehicle.dimensions
    for before, after in zip(scene.vehicles, moved.vehicles, strict=True):
        for old, new in ((before.start, after.start), (before.goal, after.goal)):
            assert max(abs(new.x_m - old.x_m), abs(new.y_m - old.y_m)) <= PERTURBED_M + 0.1
            assert abs(new.heading_rad - old.heading_rad) <= PERTURBED_RAD
            assert (new.x_m, new.y_m) != (old.x_m, old.y_m)
            x, y = shift_along(new.x_m, new.y_m, new.heading_rad, car.rear_axle_to_centre_m)
            box = box_corners(x, y, np.asarray(new.heading_rad), car.length_m, car.width_m)
            assert box[:, 0].min() >= scene.map.x_min_m - 1e-9
            assert box[:, 0].max() <= scene.map.x_max_m + 1e-9
            assert box[:, 1].min() >= scene.map.y_min_m - 1e-9
            assert box[:, 1].max() <= scene.map.y_max_m + 1e-9


def test_a_seed_perturbs_the_same_way_every_time() -> None:
    scene = packaged_scene("dense_6")
    assert perturbed(scene, 3) == perturbed(scene, 3)
    assert perturbed(scene, 3) != perturbed(scene, 4)
