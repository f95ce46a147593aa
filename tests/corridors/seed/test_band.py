"""Paths drawn clear of obstacles."""

from __future__ import annotations

import numpy as np

from istc_replay.corridors.blocks import car_box_m
from istc_replay.corridors.seed.band import drawn_clear
from istc_replay.geometry import shift_along

from ...support.participants import CAR

STRAIGHT = np.column_stack([np.linspace(-20.0, 20.0, 161), np.zeros((161, 2))])


def test_a_path_drawn_clear_keeps_its_ends_and_its_car_boxes_miss_the_box() -> None:
    box = np.array([[-3.0, 3.0, -6.0, -0.5]])
    poses = drawn_clear(STRAIGHT, CAR, box, None, 0.4)
    assert np.allclose(poses[[0, -1]], STRAIGHT[[0, -1]], atol=1e-6)
    half = car_box_m(poses[:, 2], 0.0, CAR.length_m, CAR.width_m) / 2.0
    low = shift_along(*poses.T, CAR.rear_axle_to_centre_m) - half  # type: ignore[call-arg]
    over = (low[:, 0] < 3.0) & (low[:, 0] + 2.0 * half[:, 0] > -3.0)
    assert low[over, 1].min() > -0.5 + 0.2


def test_a_path_with_nothing_near_stays_as_it_is() -> None:
    poses = drawn_clear(STRAIGHT, CAR, np.array([[-3.0, 3.0, 15.0, 20.0]]), None, 0.4)
    assert np.abs(poses[:, 1]).max() < 1e-6


def test_a_path_stays_on_the_map() -> None:
    box = np.array([[-3.0, 3.0, -6.0, -0.5]])
    poses = drawn_clear(STRAIGHT, CAR, box, (-25.0, 25.0, -25.0, 1.8), 0.4)
    assert poses[:, 1].max() < 1.2
