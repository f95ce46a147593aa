"""Properties of any plan, over random scenes from poses to certificate."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from istc_replay.bench import recorded_log
from istc_replay.config import Config
from istc_replay.datatypes import SOUND
from istc_replay.pipeline.replay import replay_read
from istc_replay.samples.sceneform import SceneFile, parse_scene
from istc_replay.samples.scenes import record

FAST = Config.model_validate({"corridors": {"mode": "fast"}})


def random_scene(seed: int) -> SceneFile:
    """Two to four cars that start on a ring and cross it; in every other scene a block stands in it."""
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 5))
    vehicles = []
    for number in range(count):
        angle = 2.0 * math.pi * (number + float(random.uniform(-0.2, 0.2))) / count
        turn = math.remainder(angle + math.pi + float(random.uniform(-0.3, 0.3)), 2.0 * math.pi)

        def pose(distance_m: float, angle: float = angle, turn: float = turn) -> dict[str, float]:
            x, y = distance_m * math.cos(angle), distance_m * math.sin(angle)
            return {"x_m": x, "y_m": y, "heading_rad": turn}

        vehicles.append({"id": f"car_{number}", "start": pose(19.0), "goal": pose(-17.0)})
    block = {"x_min_m": -1.5, "x_max_m": 1.5, "y_min_m": 4.0, "y_max_m": 7.0}
    scene = {
        "name": f"random_{seed}",
        "map": {"x_min_m": -30.0, "x_max_m": 30.0, "y_min_m": -30.0, "y_max_m": 30.0},
        "speed_mps": float(random.uniform(4.0, 6.0)),
        "vehicle": {"length_m": 4.0, "width_m": 2.0, "wheelbase_m": 2.7, "rear_overhang_m": 0.65},
        "obstacles": [block] if seed % 2 else [],
        "vehicles": vehicles,
    }
    return parse_scene(json.dumps(scene), f"random_{seed}")


def window_of(seed: int) -> dict[str, Any]:
    """What the summary says of the scene's one window."""
    replayed = replay_read(recorded_log(record(random_scene(seed))), FAST)
    (window,) = replayed.summary["windows"]
    planned = replayed.result.states.filter(source="planned")
    assert bool(len(planned)) == (window["status"] in SOUND)
    return window


SEEDS = [*range(4), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(4, 30))]


@pytest.mark.parametrize("seed", SEEDS)
def test_any_plan_that_is_returned_is_certified_and_any_other_end_has_a_reason(seed: int) -> None:
    window = window_of(seed)
    if window["status"] in SOUND:
        verdicts = {check["verdict"] for check in window["certificate"]["checks"]}
        assert verdicts <= {"pass", "not_applicable"}
        assert window["vehicles_certified"] == window["vehicles_plannable"]
        assert window["corridors"]["bound"] <= window["corridors"]["objective"]
    if window["status"] != "certified":
        assert window["reason"]
