"""Windows of a log: by which rules they are planned, and with which settings."""

from __future__ import annotations

from istc_replay.config import Config, parse_config, render_config
from istc_replay.scenario import build_scenarios
from istc_replay.windows import settled_config

from .support.tracks import driver, log_of


def test_a_slow_log_is_a_scene_and_a_fast_one_traffic() -> None:
    slow, fast = log_of(driver("1", speed_mps=5.0)), log_of(driver("1"))
    assert [next(iter(build_scenarios(log, Config()))).traffic for log in (slow, fast)] == [False, True]
    by_name = next(iter(build_scenarios(fast, Config.model_validate({"window": {"rules": "scene"}}))))
    assert (by_name.traffic, by_name.window.unit_s) == (False, 1.0)


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
