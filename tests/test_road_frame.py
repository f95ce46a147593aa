"""The frame turned to the road, the time unit without a conflict, and what headings are free in."""

from __future__ import annotations

import numpy as np
import pytest

from istc_replay.config import Config
from istc_replay.road_frame import Body, conflicts, heading_slack, road_yaw

from .support.planning import FAST, scenarios
from .support.tracks import BUSY, driver, log_of, turned


def test_the_time_unit_is_long_only_where_the_recording_has_no_conflict_at_it() -> None:
    def unit_s(ahead_m: float, config: Config = FAST, lane_m: float = 0.0) -> float:
        """The time unit of two cars, 4.5 m long, at 12 m/s."""
        log = log_of(driver("1"), driver("2", lane_m, ahead_m))
        return scenarios(log, config)[0].window.unit_s

    assert unit_s(0.0, lane_m=8.0) == 1.0
    assert unit_s(11.5) == 0.5  # 7 m between the bumpers, 6 m of way in half a second
    assert unit_s(9.0) == 0.25
    assert unit_s(6.7) == 0.5  # a conflict at any of them: half a second first
    assert unit_s(11.5, Config.model_validate({"window": {"unit_s": 0.25}})) == 0.25


def test_the_frame_turns_to_the_road() -> None:
    log = turned(BUSY, np.radians(41.0), (0.0, 0.0))
    yaw = scenarios(log, Config())[0].window.frame.yaw_rad
    assert np.degrees(yaw) % 90.0 == pytest.approx(41.0, abs=1.1)
    assert scenarios(log, Config.model_validate({"window": {"frame": "map"}}))[0].window.frame.yaw_rad == 0.0


def test_cars_side_by_side_at_an_angle_conflict_only_in_the_maps_frame() -> None:
    along = np.linspace(0.0, 40.0, 9)
    bodies = []
    for lane in (0.0, 3.0):
        points = (
            np.stack([along, np.full(9, lane)], axis=-1) @ np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2.0)
        )
        bodies.append(Body(0, np.column_stack([points, np.full(9, np.pi / 4)]), 4.5, 1.8))
    yaw = road_yaw(bodies, 8, 0.5)
    assert conflicts(bodies, 8, 0.5, 0.0)[0] == 1
    assert conflicts(bodies, 8, 0.5, yaw) == (0, 0, 0.0)


def test_headings_are_held_narrow_at_speed_and_after_the_start() -> None:
    at = np.arange(9)[:, None] * np.array([[1.0, 0.0, 0.0]])
    slow, fast = heading_slack(at * 2.0, 0.5), heading_slack(at * 10.0, 0.5)
    assert np.degrees(slow[0]) == pytest.approx(np.degrees(0.22 * 0.125))
    assert slow[-1] == pytest.approx(np.arctan(1.5 * 0.5 / 4.0))
    assert fast[-1] == pytest.approx(np.arctan(1.5 * 0.5 / 20.0))
    assert (np.diff(slow[:3]) >= 0.0).all()
