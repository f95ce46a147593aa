"""Moves against their definitions, one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from istc_replay.corridors.blocks import car_box_m
from istc_replay.corridors.seed.moves import Moves

WALLS = ((-2.0, 2.0, 1.0, 24.9), (-2.0, 2.0, -24.9, -5.0))


@pytest.fixture
def moves(meeting: Any) -> Moves:
    scenario, _, lattices = meeting([(-15.0, 0.0, 0.0)], WALLS, units=8)
    participant = scenario.participants[0]
    return Moves(participant, lattices[0].paths, 0.5, scenario.obstacles, scenario.bounds_m, 0.2)


def test_a_least_cube_is_the_hull_of_the_car_boxes_at_both_ends(moves: Moves) -> None:
    steps, _, paths = moves.shape
    random = np.random.default_rng(0)
    for _ in range(50):
        path = int(random.integers(paths))
        place = int(random.integers(moves.last[path] + 1))
        step = int(random.integers(min(steps, moves.last[path] - place + 1)))
        ends = moves.paths[path].poses[[place, place + step]]
        slack = moves.slack_rad[[place, place + step], path]
        half = car_box_m(ends[:, 2], slack, 4.0, 2.0) / 2.0
        low, high = (ends[:, :2] - half).min(axis=0), (ends[:, :2] + half).max(axis=0)
        expected = [low[0], high[0], low[1], high[1]]
        assert moves.cubes_m[:, step, place, path] == pytest.approx(expected, abs=1e-5)
        assert not moves.free[step, moves.last[path] - step + 1 :, path].any()


def test_the_moves_that_meet_a_box_are_those_that_come_nearer_than_the_gap(moves: Moves) -> None:
    random = np.random.default_rng(1)
    corners = random.uniform(-15.0, 10.0, (6, 2))
    boxes = np.column_stack([corners[:, 0], corners[:, 0] + 4.0, corners[:, 1], corners[:, 1] + 2.0])
    furthest = [0, 5, 10, 20, 30, 1000]
    met = moves.meeting(boxes, 0.3, furthest)
    steps, places, paths = moves.shape
    assert any(map(len, met))
    for box, far, numbers in zip(boxes, furthest, met, strict=True):
        found = np.zeros((steps, steps + places, paths), dtype=bool)
        found.reshape(-1)[numbers] = True
        near = (moves.depth(box, 0.3) > 0.0) & moves.free
        near[:, far + 1 :] = False
        assert np.array_equal(found[:, steps:], near)
        assert not found[:, :steps].any()


def test_paths_whose_end_is_reached_are_those_with_a_chain_of_free_moves(moves: Moves) -> None:
    for overlap_max_m in (0.0, 0.6, 2.0):
        free = moves.free & (moves.deep <= overlap_max_m)
        expected = []
        for path, last in enumerate(moves.last.tolist()):
            here = {0}
            for place in range(last):
                if place in here:
                    here |= {place + int(s) for s in np.flatnonzero(free[:, place, path])}
            expected.append(last in here)
        assert moves.reachable(overlap_max_m).tolist() == expected
    assert any(expected)


def test_no_unit_begins_beyond_the_furthest_place(moves: Moves) -> None:
    furthest = moves.furthest(8)
    assert furthest[0] == 0
    place, step = 0, int(np.flatnonzero(moves.first_steps())[-1])
    for limit in furthest[1:]:
        place += step
        step = min(step + moves.more, moves.shape[0] - 1)
        assert limit == min(place, moves.shape[1] - 1)
