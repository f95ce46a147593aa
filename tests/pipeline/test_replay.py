"""Replays as a whole: symmetries of a log, the paper's findings, and what is not a plan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import istc_replay
from istc_replay.datatypes import Log, MapBounds, StaticScene, WindowStatus, read_only
from istc_replay.ingest.log import read_log
from istc_replay.pipeline.replay import replay_log

from ..support.planning import FAST, map_motion, planned

SAMPLE_LOGS = Path(__file__).resolve().parents[2] / "sample_logs"
TURN_FIRST = SAMPLE_LOGS / "intersection_turn_first.mcap"


def moved(log: Log, quarter_turns: int, shift_m: tuple[float, float], names: dict[str, str]) -> Log:
    """The log turned by quarter turns about the origin, shifted, its vehicles renamed."""
    c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarter_turns]
    x, y = pl.col("x_m"), pl.col("y_m")
    states = log.states.with_columns(
        x_m=c * x - s * y + shift_m[0],
        y_m=s * x + c * y + shift_m[1],
        heading_rad=pl.col("heading_rad") + quarter_turns * np.pi / 2,
        vehicle_id=pl.col("vehicle_id").replace_strict(names),
    ).sort("vehicle_id", "time_ns")
    turn = np.array([[c, -s], [s, c]])
    scene = StaticScene(
        lane_lines=tuple(
            replace(
                line,
                points_m=read_only(line.points_m @ turn.T + shift_m),
                vehicle_id=names[line.vehicle_id or ""],
            )
            for line in log.scene.lane_lines
        ),
        vehicles=tuple(replace(v, vehicle_id=names[v.vehicle_id]) for v in log.scene.vehicles),
    )
    return replace(log, states=states, scene=scene)


@pytest.mark.parametrize("quarter_turns", [0, 1, 2, 3])
def test_a_moved_turned_and_renamed_log_has_the_same_plan(quarter_turns: int) -> None:
    log = read_log(TURN_FIRST)
    names = {"1": "tram", "2": "11", "3": "2"}
    shift = (437_000.0, 5_812_000.0)
    original = map_motion(planned(log))
    other = map_motion(planned(moved(log, quarter_turns, shift, names)))
    c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[quarter_turns]
    turn = np.array([[c, -s], [s, c]])
    assert original.keys() == names.keys()
    for vehicle, motion in original.items():
        np.testing.assert_allclose(other[names[vehicle]], motion @ turn.T + shift, atol=5e-3)


def test_with_the_larger_eta_the_speed_varies_less() -> None:
    turn_first, straight_first = (
        {
            t.vehicle_id: float(t.states[:, 4].std())
            for t in planned(read_log(SAMPLE_LOGS / f"{name}.mcap")).trajectories
        }
        for name in ("intersection_turn_first", "intersection_straight_first")
    )
    assert straight_first["1"] < turn_first["1"]
    assert straight_first["2"] < turn_first["2"]
    assert turn_first["3"] < straight_first["3"]


def test_what_is_not_certified_is_not_a_plan() -> None:
    strict = FAST.model_copy(
        update={"certificate": FAST.certificate.model_copy(update={"separation_m": 9.0})}
    )
    done = replay_log(TURN_FIRST, strict)
    window = done.summary["windows"][0]
    assert (window["status"], window["vehicles_certified"], done.exit_code) == ("not_certified", 0, 4)
    assert "separation fail" in window["reason"]
    assert set(done.result.states["source"].unique()) == {"recorded", "rejected", "guidance"}


def test_a_vehicle_that_cannot_be_driven_is_named_and_nothing_is_planned() -> None:
    weak = FAST.model_copy(
        update={
            "trajectories": FAST.trajectories.model_copy(
                update={"steering_max_rad": 0.05, "feedback_rounds": 1}
            )
        }
    )
    done = replay_log(TURN_FIRST, weak)
    window = done.summary["windows"][0]
    assert window["status"] == "not_drivable"
    assert window["rounds"] == 2
    assert window["undrivable"]
    for culprit in window["undrivable"]:
        assert culprit["slack_m"] > 0.0
        assert f"{culprit['vehicle_id']} in time unit {culprit['unit']}" in window["reason"]
    assert "planned" not in set(done.result.states["source"].unique())
    assert done.exit_code == 4


def test_vehicles_that_overlap_at_the_start_are_named() -> None:
    log = read_log(TURN_FIRST)
    first = log.states.filter(pl.col("vehicle_id") == "1")
    twin = first.with_columns(vehicle_id=pl.lit("9"), y_m=pl.col("y_m") + 1.0)
    plan = planned(replace(log, states=pl.concat([log.states, twin])))
    assert plan.status is WindowStatus.CONFLICT_LEFT
    assert "1 and 9 cannot be separated in time unit 0" in plan.reason


def test_one_vehicle_alone_keeps_to_its_guidance() -> None:
    # To a millimetre: the area term may bend a turn by less.
    log = read_log(TURN_FIRST)
    alone = replace(log, states=log.states.filter(pl.col("vehicle_id") == "3"))
    plan = planned(alone)
    corridor = plan.corridors.corridors[0] if plan.corridors else None
    assert corridor is not None
    np.testing.assert_allclose(corridor.pivots_m, corridor.references_m, atol=1e-3)
    assert len(plan.trajectories) == 1


def test_a_window_with_nobody_to_plan_says_why() -> None:
    log = read_log(TURN_FIRST)
    blind = replace(log, states=log.states.with_columns(heading_rad=pl.lit(None, dtype=pl.Float64)))
    plan = planned(blind)
    assert plan.status is WindowStatus.NOTHING_TO_PLAN
    assert "heading_rad" in plan.reason


def test_bounds_keep_every_planned_box_inside() -> None:
    log = read_log(TURN_FIRST)
    x, y = log.states["x_m"], log.states["y_m"]
    bounds = MapBounds(x.min() - 8.0, x.max() + 8.0, y.min() - 8.0, y.max() + 8.0)  # type: ignore[operator]
    plan = planned(replace(log, scene=replace(log.scene, bounds=bounds)))
    frame = plan.scenario.window.frame
    assert plan.trajectories
    for corridor in plan.corridors.corridors if plan.corridors else ():
        cubes = corridor.cubes_m + (frame.x_m, frame.x_m, frame.y_m, frame.y_m)
        assert cubes[:, 0].min() >= bounds.x_min_m - 1e-9
        assert cubes[:, 3].max() <= bounds.y_max_m + 1e-9


def test_python_gives_what_the_command_gives(tmp_path: Path) -> None:
    states = istc_replay.read_states(TURN_FIRST)
    assert states.height == 303
    result = istc_replay.replay(TURN_FIRST, FAST)
    assert set(result.states["source"].unique()) == {"recorded", "planned", "guidance"}
    assert result.certificates["verdict"].is_in(["pass", "not_applicable"]).all()


def test_a_long_log_is_replayed_window_by_window() -> None:
    short = FAST.model_copy(
        update={
            "window": FAST.window.model_copy(update={"whole_log_s": 5.0, "horizon_s": 4.0, "stride_s": 3.0})
        }
    )
    done = replay_log(TURN_FIRST, short)
    windows = done.summary["windows"]
    assert [w["index"] for w in windows] == [0, 1, 2]
    assert done.summary["totals"]["windows_full"] == sum(w["status"] == "certified" for w in windows)
    for window in windows:
        assert window["status"] == "certified" or window["reason"]
