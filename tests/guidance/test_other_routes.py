"""Other routes of a guidance."""

from __future__ import annotations

import numpy as np

from istc_replay.datatypes import SceneObstacle
from istc_replay.geometry import shift_along
from istc_replay.guidance.clearance import Clearance, MapBounds
from istc_replay.guidance.other_routes import other_routes

from ..support.participants import CAR

BOUNDS_M = (-25.0, 25.0, -25.0, 25.0)
#: A block on the straight way.
BLOCK = SceneObstacle("block", 0.0, 0.0, 0.0, 4.0, 4.0)


def straight(length_m: float) -> np.ndarray:
    x = np.linspace(-length_m / 2.0, length_m / 2.0, 61)
    return np.column_stack([x, np.zeros((61, 2))])


def test_other_routes_pass_a_block_on_either_side_and_keep_clear_of_it() -> None:
    routes = other_routes(straight(36.0), CAR, BOUNDS_M, [BLOCK])
    beside = [float(np.interp(0.0, route[:, 0], route[:, 1])) for route in routes]
    assert min(beside) < -3.0
    assert max(beside) > 3.0
    clearance = Clearance.of(CAR, MapBounds(*BOUNDS_M), [BLOCK], 0.0, 0.0)
    for route in routes:
        assert clearance.gaps(route).min() > 0.45


def test_other_routes_lead_from_end_to_end_and_can_be_steered() -> None:
    for route in other_routes(straight(36.0), CAR, None, [BLOCK]):
        centres = shift_along(*route.T, CAR.rear_axle_to_centre_m)
        assert np.allclose(centres[[0, -1]], [[-18.0, 0.0], [18.0, 0.0]], atol=1e-6)
        steps = np.hypot(*np.diff(route[:, :2], axis=0).T)
        assert steps.max() <= 0.25 + 1e-9
        assert steps.sum() <= 1.2 * 36.0
        assert np.abs(np.diff(route[:, 2]) / steps).max() <= 1.0 / 5.0 + 1e-3


def test_no_two_other_routes_are_alike() -> None:
    routes = other_routes(straight(36.0), CAR, BOUNDS_M, [BLOCK])
    assert len(routes) >= 2
    for n, one in enumerate(routes):
        for other in routes[:n]:
            at = [route[np.linspace(0, len(route) - 1, 40).astype(int), :2] for route in (one, other)]
            assert np.abs(at[0] - at[1]).max() > 0.25


def test_who_stays_or_has_no_way_past_has_no_other_route() -> None:
    wall = SceneObstacle("wall", 0.0, 0.0, 0.0, 2.0, 50.0)
    assert other_routes(straight(0.5), CAR, BOUNDS_M, [BLOCK]) == ()
    assert other_routes(straight(36.0), CAR, BOUNDS_M, [wall]) == ()
