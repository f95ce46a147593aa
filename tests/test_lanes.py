"""The lanes that a recorded vehicle is in and goes on to, and guidance along them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from istc_replay.config import parse_config
from istc_replay.datatypes import LaneLine, Log, StaticScene, WindowPlan, read_only
from istc_replay.lanes import lane_ahead

from .support.planning import planned
from .support.tracks import driver, log_of


def arc(turn: float, radius_m: float = 40.0) -> np.ndarray:
    """A way 60 m to the east, then a bend: to the left (1), to the right (-1), or straight on (0)."""
    at = np.linspace(0.0, 1.2, 13)
    if turn == 0.0:
        return np.stack([60.0 + 40.0 * at, np.zeros(13)], axis=-1)
    return np.stack([60.0 + radius_m * np.sin(at), turn * radius_m * (1.0 - np.cos(at))], axis=-1)


LANES = (
    LaneLine("in", read_only([[0.0, 0.0], [30.0, 0.0], [60.0, 0.0]])),
    LaneLine("left", read_only(arc(1.0))),
    LaneLine("on", read_only(arc(0.0))),
    LaneLine("right", read_only(arc(-1.0))),
    LaneLine("oncoming", read_only([[60.0, 1.0], [0.0, 1.0]])),
    LaneLine("beside", read_only([[0.0, -3.5], [60.0, -3.5]])),
    LaneLine("nowhere", read_only([], columns=2)),
)


def poses_along(line: np.ndarray, side_m: float = 0.0) -> np.ndarray:
    """Poses on a line, to its left by a distance."""
    step = np.gradient(line, axis=0)
    heading = np.arctan2(step[:, 1], step[:, 0])
    normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
    return np.column_stack([line + side_m * normal, heading])


@pytest.mark.parametrize(("turn", "name"), [(1.0, "left"), (0.0, "on"), (-1.0, "right")])
def test_the_lane_goes_on_where_the_recording_went(turn: float, name: str) -> None:
    way = np.vstack([np.stack([np.linspace(5.0, 55.0, 11), np.zeros(11)], axis=-1), arc(turn)])
    line = lane_ahead(LANES, poses_along(way, 0.8), 120.0)
    assert line is not None
    own = {lane.lane_id: lane.points_m for lane in LANES}
    np.testing.assert_array_equal(line, np.vstack([own["in"], own[name]]))
    short = lane_ahead(LANES, poses_along(way, 0.8), 30.0)
    np.testing.assert_array_equal(short, own["in"])


def test_a_vehicle_is_in_the_nearest_lane_that_heads_its_way_or_in_none() -> None:
    way = np.stack([np.linspace(5.0, 55.0, 11), np.zeros(11)], axis=-1)
    own = {lane.lane_id: lane.points_m for lane in LANES}
    np.testing.assert_array_equal(lane_ahead(LANES, poses_along(way, -2.0), 10.0), own["beside"])
    np.testing.assert_array_equal(lane_ahead(LANES, poses_along(way[::-1], 0.0), 10.0), own["oncoming"])
    assert lane_ahead(LANES, poses_along(way, 4.0), 10.0) is None
    assert lane_ahead((), poses_along(way), 10.0) is None


def lane_log(speed: np.ndarray, *lanes: LaneLine) -> Log:
    """A car that drives 0.6 m to the left of the lane's line."""
    way = 2.0 + np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2.0) / 10.0])
    car = driver("1", 0.6, seconds=(len(speed) - 1) / 10.0, x_m=way, speed_mps=speed)
    return log_of(car, scene=StaticScene(lanes))


def with_law(log: Log, text: str) -> WindowPlan:
    """The plan of the log's first window, with some settings of guidance."""
    return planned(log, parse_config('corridors.mode = "fast"\n' + text))


def test_constant_speed_in_traffic_follows_the_lane_and_the_recording_is_the_default() -> None:
    log = lane_log(np.full(41, 12.0), *LANES)
    plan = with_law(log, 'guidance.law = "constant"')
    (guide,) = plan.guidance
    assert guide.kind == "lane"
    frame = plan.scenario.window.frame
    c, s = np.cos(frame.yaw_rad), np.sin(frame.yaw_rad)
    points = guide.points_m @ np.array([[c, s], [-s, c]]) + (frame.x_m, frame.y_m)
    np.testing.assert_allclose(points[1:, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.diff(points[1:, 0]), 12.0 * plan.scenario.window.unit_s, atol=1e-6)
    assert plan.trajectories
    for text in ("", 'guidance = { law = "constant", source = "recorded" }'):
        assert [each.kind for each in with_law(log, text).guidance] == ["recorded"]
    bare = replace(log, scene=StaticScene())
    assert [each.kind for each in with_law(bare, 'guidance.law = "constant"').guidance] == ["recorded"]


def test_who_is_recorded_to_stop_in_its_lane_is_guided_to_stop_there() -> None:
    speed = np.maximum(12.0 - 4.0 * np.arange(51) / 10.0, 0.0)
    log = lane_log(speed, *LANES)
    plan = with_law(log, 'guidance.law = "constant"')
    (guide,) = plan.guidance
    frame = plan.scenario.window.frame
    end = guide.points_m[-1] @ np.array([np.cos(frame.yaw_rad), -np.sin(frame.yaw_rad)]) + frame.x_m
    assert guide.kind == "lane"
    assert end == pytest.approx(float(log.states["x_m"][-1]), abs=0.3)
