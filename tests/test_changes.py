"""What coordination changed: zeros where nothing had to, and the true figures where something had."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from istc_replay.changes import changes
from istc_replay.datatypes import (
    Dimensions,
    Frame,
    Guidance,
    Obstacle,
    Scenario,
    Trajectory,
    Window,
    WindowPlan,
    WindowStatus,
    read_only,
)

SIZE = Dimensions(4.0, 2.0, 2.7, 1.35)
TIMES = np.arange(81) / 20.0


def moving(vehicle_id: str, speed_mps: float, lane_m: float = 0.0, jerk: float = 0.0) -> Trajectory:
    """A car on a straight lane, from its rear axle at -1.35 m on; its acceleration rises by `jerk`."""
    step, steps = 0.2, 20
    t = np.arange(steps + 1) * step
    zero = np.zeros_like(t)
    x = -SIZE.rear_axle_to_centre_m + speed_mps * t + jerk * t**3 / 6
    states = np.column_stack([x, zero + lane_m, zero, zero, speed_mps + jerk * t**2 / 2, jerk * t])
    controls = np.column_stack([zero, zero + jerk])[:-1]
    return Trajectory(vehicle_id, SIZE, read_only(t), read_only(states), read_only(controls), 0.0)


def guidance(vehicle_id: str, speed_mps: float, lane_m: float = 0.0) -> Guidance:
    """Straight on at constant speed."""
    poses = np.column_stack([speed_mps * TIMES, np.full(81, lane_m), np.zeros(81)])
    at = poses[::20]
    points, headings = read_only(at[:, :2]), read_only(at[:, 2])
    return Guidance(vehicle_id, "recorded", points, headings, speed_mps, read_only(TIMES), read_only(poses))


def plan_of(*pairs: tuple[Trajectory, Guidance], obstacles: tuple[Obstacle, ...] = ()) -> WindowPlan:
    """A plan of vehicles and what guided them."""
    scenario = Scenario(Window(0, 0, 4 * 10**9, 1.0, 4, Frame()), (), obstacles, None)
    return WindowPlan(
        scenario,
        WindowStatus.CERTIFIED,
        trajectories=tuple(t for t, _ in pairs),
        guidance=tuple(g for _, g in pairs),
    )


def test_a_plan_that_is_the_guidance_changed_nothing() -> None:
    pairs = [
        (moving(name, 10.0, lane), guidance(name, 10.0, lane)) for name, lane in (("1", 0.0), ("2", 4.0))
    ]
    for change in changes(plan_of(*pairs)):
        told = (change.delay_s, change.deviation_m, change.lateral_m, change.clearance_gained_m)
        assert (change.changed, told) == (False, (0.0, 0.0, 0.0, 0.0))
        assert change.clearance_m == pytest.approx(2.0)


def test_a_slower_car_is_late_by_the_time_that_its_last_place_was_reached_before() -> None:
    (change,) = changes(plan_of((moving("1", 8.0), guidance("1", 10.0))))
    assert change.changed
    assert change.delay_s == pytest.approx(4.0 - 3.2, abs=1e-6)
    assert change.deviation_m == pytest.approx(8.0, abs=1e-6)
    assert change.lateral_m == pytest.approx(0.0, abs=1e-6)
    assert (change.clearance_m, change.clearance_gained_m) == (None, None)


def test_a_faster_car_is_early_and_one_beside_its_path_is_told_so() -> None:
    (early,) = changes(plan_of((moving("1", 11.0), guidance("1", 10.0))))
    assert early.delay_s == pytest.approx(-0.4, abs=1e-6)
    (beside,) = changes(plan_of((moving("1", 10.0, 0.7), guidance("1", 10.0))))
    assert (beside.lateral_m, beside.deviation_m) == (pytest.approx(0.7), pytest.approx(0.7))
    assert beside.delay_s == pytest.approx(0.0, abs=1e-6)


def test_comfort_is_the_rise_of_acceleration_and_of_braking() -> None:
    (change,) = changes(plan_of((moving("1", 10.0, jerk=-0.5), guidance("1", 10.0))))
    assert change.braking_mps2 == pytest.approx(2.0, abs=0.05)
    assert change.acceleration_rms_mps2 == pytest.approx(2.0 / np.sqrt(3.0), abs=0.03)


def test_clearance_counts_every_road_user_but_the_vehicle_itself() -> None:
    box = [30.0, 34.0, 2.0, 4.0]
    post, itself = (
        Obstacle("post", read_only([box] * 4)),
        Obstacle("1", read_only([[-2.0, 8.0, -1.0, 1.0]] * 4)),
    )
    pair = (moving("1", 10.0, -0.5), guidance("1", 10.0))
    (change,) = changes(plan_of(pair, obstacles=(post, itself)))
    assert change.clearance_m == pytest.approx(1.5)
    assert change.clearance_gained_m == pytest.approx(0.5)
    swapped = replace(plan_of(pair), scenario=plan_of(pair, obstacles=(itself,)).scenario)
    assert changes(swapped)[0].clearance_m is None
