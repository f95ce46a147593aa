"""Candidate paths."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from istc_replay.corridors.seed.paths import Surroundings, along_others, candidate_paths, detours
from istc_replay.datatypes import read_only

from ...support.participants import CAR


def test_every_candidate_runs_from_start_to_goal_and_bends_no_more_than_a_car_can(meeting: Any) -> None:
    _, guidance, _ = meeting([(-15.0, 0.0, 0.0)])
    paths = candidate_paths(guidance[0], Surroundings(CAR, np.array([[-2.0, 2.0, -5.0, -1.0]]), None, 0.2))
    assert len(paths) > 10
    for path in paths:
        assert np.allclose(path.poses[0], [-15.0, 0.0, 0.0], atol=1e-6)
        assert np.allclose(path.poses[-1], [15.0, 0.0, 0.0], atol=1e-6)
        assert np.abs(path.curvatures_1pm).max() <= 0.27 + 1e-9
        assert path.step_m == np.clip(path.step_m, 0.45, 0.55)


def test_sharp_candidates_are_driven_slowly(meeting: Any) -> None:
    _, guidance, _ = meeting([(-15.0, 0.0, 0.0)])
    for path in candidate_paths(guidance[0], Surroundings(CAR, np.empty((0, 4)), None, 0.2)):
        fast = path.speeds_mps > 5.0
        assert (path.speeds_mps**2 * np.abs(path.curvatures_1pm))[fast].max(initial=0.0) <= 3.3


def test_detours_lead_through_other_openings(meeting: Any) -> None:
    # A wall with openings at y = -1.5 .. 1.5 and y = 6 .. 10.
    wall = np.array([[-1.0, 1.0, 1.5, 6.0], [-1.0, 1.0, 10.0, 25.0], [-1.0, 1.0, -25.0, -1.5]])
    _, guidance, _ = meeting([(-15.0, 0.0, 0.0)])
    found = detours(guidance[0], Surroundings(CAR, wall, (-25.0, 25.0, -25.0, 25.0), 0.2))
    at_the_wall = [float(np.interp(0.0, path.poses[:, 0], path.poses[:, 1])) for path in found]
    assert any(-1.5 < y < 1.5 for y in at_the_wall)
    assert any(6.5 < y < 9.5 for y in at_the_wall)


def test_the_guidances_other_routes_are_candidates_as_they_are_and_drawn_clear(meeting: Any) -> None:
    block = np.array([[-2.0, 2.0, -2.0, 2.0]])
    _, (guide, *_), _ = meeting(
        [(-15.0, 0.0, 0.0), (-15.0, 20.0, 0.0), (-15.0, -20.0, 0.0), (-15.0, 10.0, 0.0)],
        boxes=(tuple(block[0]),),
    )
    found = along_others(guide, Surroundings(CAR, block, (-25.0, 25.0, -25.0, 25.0), 0.2))
    assert len(found) > len(guide.others) > 1
    at_the_block = [float(np.interp(0.0, path.poses[:, 0], path.poses[:, 1])) for path in found]
    assert min(at_the_block) < -3.0
    assert max(at_the_block) > 3.0
    for path in found:
        assert np.allclose(path.poses[[0, -1], :2], [[-15.0, 0.0], [15.0, 0.0]], atol=0.1)


def test_scenes_that_are_not_crowded_have_no_other_routes(meeting: Any) -> None:
    _, guidance, _ = meeting([(-15.0, 0.0, 0.0)], boxes=((-2.0, 2.0, -2.0, 2.0),))
    assert guidance[0].others == ()
    assert along_others(guidance[0], Surroundings(CAR, np.array([[-2.0, 2.0, -2.0, 2.0]]), None, 0.2)) == []


def test_who_stays_has_one_way(meeting: Any) -> None:
    _, (guide,), _ = meeting([(-15.0, 0.0, 0.0)])
    still = replace(guide, poses=read_only(np.repeat(guide.poses[:1], len(guide.poses), axis=0)))
    paths = candidate_paths(still, Surroundings(CAR, np.array([[-2.0, 2.0, -5.0, -1.0]]), None, 0.2))
    assert len(paths) == 1
    assert np.isfinite(paths[0].poses).all()
