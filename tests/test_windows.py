"""Windows of a log: by which rules they are planned, and with which settings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest

from istc_replay.config import Config, parse_config, render_config
from istc_replay.datatypes import LaneLine, MapBounds, SceneObstacle, StaticScene, VehicleInfo, read_only
from istc_replay.ingest.log import read_log
from istc_replay.windows import fitting_unit_s, is_traffic, settled_config, window_spans

from .support.planning import scenarios
from .support.tracks import driver, log_of


def test_a_slow_log_is_a_scene_and_a_fast_one_traffic() -> None:
    slow, fast = log_of(driver("1", speed_mps=5.0)), log_of(driver("1"))
    assert [scenarios(log, Config())[0].traffic for log in (slow, fast)] == [False, True]
    by_name = scenarios(fast, Config.model_validate({"window": {"rules": "scene"}}))[0]
    assert (by_name.traffic, by_name.window.unit_s) == (False, 1.0)


@pytest.mark.parametrize("standing", [0, 1, 40])
def test_standing_obstacles_make_no_scene_of_fast_traffic_and_are_planned_around(standing: int) -> None:
    poles = tuple(SceneObstacle(f"pole {n}", 8.0 * n, 4.0, 0.0, 0.3, 0.3) for n in range(standing))
    log = log_of(driver("1"), driver("2", ahead_m=20.0), scene=StaticScene(obstacles=poles))
    assert is_traffic(log, Config().window)
    (scenario,) = scenarios(log, Config())
    assert (scenario.traffic, len(scenario.participants)) == (True, 2)
    assert {o.obstacle_id for o in scenario.obstacles} == {pole.obstacle_id for pole in poles}
    slow = replace(log, states=log.states.with_columns(speed_mps=pl.lit(5.0)))
    assert not is_traffic(slow, Config().window)


@pytest.mark.parametrize("told", ["intent", "priority", "bounds"])
def test_what_is_told_of_a_scene_makes_one_of_fast_driving_too(told: str) -> None:
    scene = {
        "intent": StaticScene(lane_lines=(LaneLine("lane", read_only([[0.0, 0.0], [50.0, 0.0]], 2), "1"),)),
        "priority": StaticScene(vehicles=(VehicleInfo("1", priority=2.0),)),
        "bounds": StaticScene(bounds=MapBounds(-100.0, 200.0, -50.0, 50.0)),
    }[told]
    assert not is_traffic(log_of(driver("1"), scene=scene), Config().window)


THIRD_PARTY = (
    *("USA_Lanker-1_1_T-1", "USA_Peach-4_8_T-1", "USA_US101-3_3_T-1", "USA_US101-4_1_T-1"),
    *("acc-test", "alks_cut-in", "pedestrian", "sumo_rbl_fcd"),
)


@pytest.mark.parametrize("name", THIRD_PARTY)
def test_recordings_from_elsewhere_are_traffic_whatever_stands_beside_the_road(
    shared_logs: Path, name: str
) -> None:
    log = read_log(shared_logs / f"third_party/{name}.mcap")
    pole = SceneObstacle("pole", 1e4, 1e4, 0.0, 0.3, 0.3)
    beside = replace(log, scene=replace(log.scene, obstacles=(*log.scene.obstacles, pole)))
    assert is_traffic(log, Config().window)
    assert is_traffic(beside, Config().window)


def test_settings_of_traffic_are_taken_where_none_are_set_and_settled_ones_stay() -> None:
    log = log_of(driver("1"))
    config = parse_config("trajectories.deceleration_max_mps2 = 4.5")
    settled = settled_config(log, config)
    assert settled.trajectories.deceleration_max_mps2 == 4.5
    assert settled.trajectories.acceleration_max_mps2 == 5.0
    assert settled.corridors.milp_node_budget == 1000
    assert settled_config(log, parse_config(render_config(settled))) == settled
    own = parse_config("corridors.milp_node_budget = 5000")
    assert settled_config(log, own).corridors.milp_node_budget == 5000
    scene = log_of(driver("1", speed_mps=5.0))
    assert settled_config(scene, config) == config


@pytest.mark.parametrize(
    ("unit_s", "stride_s", "fits_s"),
    [
        (1.0, 4.0, 1.0),
        (1.0, 2.5, 0.625),
        (0.75, 3.0, 0.75),
        (0.75, 4.0, 0.5),
        (0.5, 2.2, 0.44),
        (1.0, 0.4, 0.4),
    ],
)
def test_in_steps_a_time_unit_divides_the_stride(unit_s: float, stride_s: float, fits_s: float) -> None:
    steps = Config.model_validate({"window": {"start": "handed_over", "stride_s": stride_s}}).window
    assert fitting_unit_s(unit_s, steps, traffic=False) == pytest.approx(fits_s, abs=1e-12)
    assert fitting_unit_s(unit_s, steps, traffic=True) == unit_s
    assert fitting_unit_s(unit_s, Config().window, traffic=False) == unit_s


def test_in_steps_a_window_reaches_beyond_the_stride_as_far_as_it_takes_to_stand() -> None:
    log = log_of(driver("1", speed_mps=5.0, seconds=12.0))
    window = {"whole_log_s": 3.0, "horizon_s": 3.0, "stride_s": 3.0}
    anew = window_spans(log, Config.model_validate({"window": window}))
    steps = window_spans(log, Config.model_validate({"window": window | {"start": "handed_over"}}))
    assert {length for _, length, _ in anew[:-1]} == {3_000_000_000}
    assert {length for _, length, _ in steps[:-1]} == {5_000_000_000}  # 5 m/s at 3 m/s^2
