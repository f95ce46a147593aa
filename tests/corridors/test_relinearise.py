"""Frames written anew about a plan."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from istc_replay.bench import recorded_log
from istc_replay.config import Config
from istc_replay.coordinate import speed_max_mps
from istc_replay.corridors.formulation import build_problem, default_limits
from istc_replay.corridors.relinearise import frames_about, headings_beside, with_references
from istc_replay.corridors.solve import solve_corridors
from istc_replay.samples.scenes import find_sample

from ..support.planning import planned


def test_headings_are_those_of_the_path_beside_and_never_go_back() -> None:
    angle = np.linspace(0.0, np.pi, 181)
    poses = np.stack([np.sin(angle) * 10.0, (1.0 - np.cos(angle)) * 10.0, angle], axis=-1)
    late = poses[[0, 20, 60, 59, 120], :2] + 0.3
    headings = headings_beside(late, poses)
    np.testing.assert_allclose(headings, angle[[0, 20, 60, 60, 120]], atol=0.06)
    assert np.all(np.diff(headings) >= 0.0)


def test_frames_about_the_guidance_itself_are_the_same_problem(crossing: Callable[..., Any]) -> None:
    case = crossing(1, vehicles=3, units=5)
    problem = case.problem()
    z = np.array(problem.reference)
    limits = {p.vehicle_id: default_limits(case.config) for p in case.scenario.participants}
    again = build_problem(case.scenario, frames_about(problem, z, case.guidance), case.config, limits, 10.0)
    again = with_references(again, case.guidance)
    np.testing.assert_allclose(again.reference, problem.reference, atol=1e-9)
    assert again.rows.families == problem.rows.families
    np.testing.assert_allclose(again.rows.weight, problem.rows.weight, atol=1e-6)
    for side in ("lower", "upper"):
        np.testing.assert_allclose(getattr(again.rows, side), getattr(problem.rows, side), atol=1e-5)


def test_eq_3_is_measured_from_the_guidance_whatever_the_frames(crossing: Callable[..., Any]) -> None:
    case = crossing(2, vehicles=2, units=4)
    problem = case.problem()
    moved = problem.reference + np.where(problem.quadratic > 0.0, 0.7, 0.0)
    frames = frames_about(problem, moved, case.guidance)
    limits = {p.vehicle_id: default_limits(case.config) for p in case.scenario.participants}
    again = with_references(build_problem(case.scenario, frames, case.config, limits, 10.0), case.guidance)
    for one, other in zip(problem.blocks, again.blocks, strict=True):
        np.testing.assert_array_equal(one.reference_m, other.reference_m)
    assert again.objective(moved) == pytest.approx(problem.objective(moved))


def test_who_would_move_aside_keeps_the_frames_that_it_has(crossing: Callable[..., Any]) -> None:
    case = crossing(1, vehicles=3, units=5)
    problem = case.problem()
    z = np.array(problem.reference)
    block, guide = problem.blocks[1], case.guidance[1]
    left = np.array([-np.sin(guide.headings_rad[0]), np.cos(guide.headings_rad[0])])
    step_m = float(np.hypot(*(guide.points_m[3] - guide.points_m[2])))
    for aside_rad, follows in ((0.35, True), (0.55, False)):
        moved = np.array(z)
        moved[block.pivot[3:]] += np.tan(aside_rad) * step_m * left
        frames = frames_about(problem, moved, case.guidance)
        np.testing.assert_array_equal(frames[0].points_m, problem.corridors(z)[0].pivots_m)
        expected = problem.corridors(moved)[1].pivots_m if follows else guide.points_m
        np.testing.assert_array_equal(frames[1].points_m, expected)


def test_vehicles_that_gave_way_among_obstacles_arrive_when_frames_follow_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A crowded scene would start from seeds, whose frames follow them from the outset.
    for module in ("datatypes.scenario", "samples.scenes"):
        monkeypatch.setattr(f"istc_replay.{module}.CROWD", 5)
    config = Config.model_validate({"corridors": {"mode": "fast"}})
    follow = planned(recorded_log(find_sample("dense_4_obstacles").record()), config)
    scenario = follow.scenario
    fixed = config.corridors.model_copy(update={"frame_rounds": 0})
    limits = {p.vehicle_id: default_limits(fixed) for p in scenario.participants}
    stay = solve_corridors(scenario, follow.guidance, fixed, limits, speed_max_mps(scenario, config))
    assert follow.corridors is not None
    assert follow.corridors.found_by.startswith("frames about the plan")
    assert follow.corridors.objective < 0.8 * stay.objective  # type: ignore[operator]
    for participant, trajectory in zip(scenario.participants, follow.trajectories, strict=True):
        x, y, heading = trajectory.states[-1, :3]
        ahead = trajectory.dimensions.rear_axle_to_centre_m
        end = (x + ahead * np.cos(heading), y + ahead * np.sin(heading))
        assert np.hypot(*(participant.recording.poses[-1, :2] - end)) < 1.0
