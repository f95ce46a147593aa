"""Scenes that cannot be: each ends with the named status, within the budget, and without a plan."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from istc_replay.bench import recorded_log
from istc_replay.config import Config
from istc_replay.datatypes import SceneObstacle
from istc_replay.errors import ScenarioError
from istc_replay.pipeline.assembly import Replay
from istc_replay.pipeline.replay import replay_read
from istc_replay.samples.sceneform import SceneFile, parse_scene
from istc_replay.samples.scenes import record

FAST = Config.model_validate({"corridors": {"mode": "fast", "seeds": 1, "seed_rounds": 5}})
CAR = {"length_m": 4.0, "width_m": 2.0, "wheelbase_m": 2.7, "rear_overhang_m": 0.65}
LORRY = {"length_m": 48.0, "width_m": 2.5, "wheelbase_m": 40.0, "rear_overhang_m": 2.0}
AHEAD = ((-20.0, 0.0, 0.0), (15.0, 0.0, 0.0))
#: Rear axles of the lanes beside it, and of the way across.
BESIDE = ((-20.0, 8.0, 0.0), (15.0, 8.0, 0.0))
ACROSS = ((0.0, -20.0, 1.5707963), (0.0, 15.0, 1.5707963))


def pose(x_m: float, y_m: float, heading_rad: float) -> dict[str, float]:
    return {"x_m": x_m, "y_m": y_m, "heading_rad": heading_rad}


def box(x_min: float, x_max: float, y_min: float, y_max: float) -> dict[str, float]:
    return {"x_min_m": x_min, "x_max_m": x_max, "y_min_m": y_min, "y_max_m": y_max}


def scene_of(*tasks: Any, obstacles: Any = (), car: Any = CAR, half_m: float = 30.0) -> SceneFile:
    scene = {
        "name": "bad",
        "map": box(-half_m, half_m, -half_m, half_m),
        "speed_mps": 5.0,
        "vehicle": car,
        "obstacles": list(obstacles),
        "vehicles": [
            {"id": str(number), "start": pose(*start), "goal": pose(*goal)}
            for number, (start, goal) in enumerate(tasks, start=1)
        ],
    }
    return parse_scene(json.dumps(scene), "bad")


def replayed(scene: SceneFile, config: Config = FAST) -> tuple[Replay, dict[str, Any]]:
    done = replay_read(recorded_log(record(scene)), config)
    (window,) = done.summary["windows"]
    return done, window


def assert_no_plan(done: Replay) -> None:
    assert done.exit_code == 4
    assert "planned" not in set(done.result.states["source"].unique())


@pytest.mark.parametrize(
    ("scene", "told"),
    [
        (
            scene_of(BESIDE, AHEAD, obstacles=[box(14, 18, -2, 2)]),
            "vehicle 2: no path.*at its goal",
        ),
        (
            scene_of(AHEAD, obstacles=[box(-2, 2, -30, -0.8), box(-2, 2, 0.8, 30)]),
            "no opening",
        ),
        (scene_of(AHEAD, obstacles=[box(-2, 2, -30, 30)]), "vehicle 1: no path"),
        (scene_of(AHEAD, car=LORRY, half_m=16.0), "does not fit on a map"),
        (scene_of(AHEAD, half_m=19.0), "vehicle 1: no path.*sticks out of the map"),
    ],
    ids=["a goal in an obstacle", "an opening too narrow", "no path", "larger than the map", "off the map"],
)
def test_a_scene_without_a_way_is_refused_as_guidance_missing_with_its_vehicle(
    scene: SceneFile, told: str
) -> None:
    with pytest.raises(ScenarioError, match=f"guidance missing: scene bad: .*{told}") as caught:
        record(scene)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("apart_m", [0.0, 0.1, 0.29])
@pytest.mark.parametrize("crowd", [False, True])
def test_start_boxes_that_touch_or_nearly_do_are_a_conflict_left_in_unit_0(
    apart_m: float, crowd: bool
) -> None:
    near = tuple((x, y + 2.0 + apart_m, heading) for x, y, heading in AHEAD)
    others = [BESIDE, ACROSS] if crowd else []
    obstacles = [box(-8.0, -4.0, -12.0, -8.0)] if crowd else []
    done, window = replayed(scene_of(AHEAD, near, *others, obstacles=obstacles))
    assert window["status"] == "conflict_left"
    assert window["conflicts"] == [{"vehicles": ["1", "2"], "unit": 0}]
    assert "1 and 2 cannot be separated in time unit 0" in window["reason"]
    assert_no_plan(done)


def test_start_boxes_just_the_gap_apart_are_planned() -> None:
    near = tuple((x, y + 2.31, heading) for x, y, heading in AHEAD)
    _, window = replayed(scene_of(AHEAD, near))
    assert window["status"] == "certified"


def test_goals_that_touch_leave_a_conflict_with_its_pair_and_unit() -> None:
    beside = (ACROSS[0], (15.0, 2.1, 0.0))
    done, window = replayed(scene_of(AHEAD, beside, BESIDE, ACROSS, obstacles=[box(-8.0, -4.0, 12.0, 16.0)]))
    assert window["status"] == "conflict_left"
    assert window["conflicts"]
    for conflict in window["conflicts"]:
        assert set(conflict["vehicles"]) <= {"1", "2", "3", "4"}
        assert 0 <= conflict["unit"] < window["units"]
    assert_no_plan(done)


def test_who_cannot_come_to_its_goal_in_time_has_a_plan_that_says_so() -> None:
    # Both are told to drive at 2 m/s; the recording, at 5 m/s, ends before vehicle 1 is there.
    blocking = ((0.0, 3.0, 0.0), (3.0, 3.0, 0.0))
    config = FAST.model_copy(update={"guidance": FAST.guidance.model_copy(update={"speed_mps": 2.0})})
    done, window = replayed(scene_of(AHEAD, blocking), config)
    assert window["status"] == "goal_not_reached"
    assert window["late"]
    assert window["reason"].startswith(f"goal not reached: {window['late'][0]} by ")
    assert window["vehicles_certified"] == 2
    assert {v["id"] for v in window["vehicles"] if v["arrived"] is False} == set(window["late"])
    assert "planned" in set(done.result.states["source"].unique())
    assert done.exit_code == 4


def test_a_recording_that_ends_in_an_obstacle_is_planned_up_to_it_and_told_why() -> None:
    driven = record(scene_of(AHEAD, BESIDE))
    block = SceneObstacle("block", 16.0, 0.0, 0.0, 4.0, 4.0)
    log = recorded_log(replace(driven, scene=replace(driven.scene, obstacles=(block,))))
    done = replay_read(log, FAST)
    (window,) = done.summary["windows"]
    assert window["status"] == "goal_not_reached"
    assert window["late"] == ["1"]
    assert window["reason"].endswith("m (its goal is within block)")
    assert done.exit_code == 4
