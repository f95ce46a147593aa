"""Which boxes must keep apart, unit by unit, and by what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors.separations import all_separations
from istc_replay.datatypes import Obstacle, read_only

GAP_M, OBSTACLE_GAP_M = 0.3, 0.2


@pytest.mark.parametrize(
    ("first_unit", "common"), [(0, [0, 1, 2, 3]), (2, [2, 3]), (3, [3]), (4, []), (6, [])]
)
def test_two_vehicles_keep_apart_in_every_unit_that_both_are_in(
    first_unit: int, common: list[int], crossing: Callable[..., Any]
) -> None:
    one, other = crossing(1, vehicles=2, units=4).problem().blocks
    later = replace(other, first_unit=first_unit)
    table = all_separations((one, later), (), GAP_M, OBSTACLE_GAP_M)
    assert table.unit.tolist() == common
    assert not table.obstacle.any()


def test_the_slack_of_an_option_is_the_distance_of_two_cubes_less_the_gap(
    crossing: Callable[..., Any],
) -> None:
    blocks = crossing(1, vehicles=2, units=4).problem().blocks
    table = all_separations(blocks, (), GAP_M, OBSTACLE_GAP_M)
    random = np.random.default_rng(2)
    z = np.zeros(1 + max(int(block.cube.max()) for block in blocks))
    for block in blocks:
        low = random.uniform(-9.0, 9.0, (block.units, 2))
        high = low + random.uniform(1.0, 5.0, (block.units, 2))
        z[block.cube] = np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=-1)
    (a, b) = (z[block.cube] for block in blocks)
    apart = np.stack([a[:, 0] - b[:, 1], b[:, 0] - a[:, 1], a[:, 2] - b[:, 3], b[:, 2] - a[:, 3]], axis=-1)
    np.testing.assert_allclose(table.slack(z), apart - GAP_M)


def test_an_obstacle_is_kept_clear_of_in_the_units_that_it_is_there(crossing: Callable[..., Any]) -> None:
    (block,) = crossing(1, vehicles=1, units=4).problem().blocks
    box = [2.0, 3.0, -1.0, 4.0]
    boxes = np.array([box, [np.nan] * 4, box, [np.nan] * 4])
    table = all_separations((block,), (Obstacle("walker", read_only(boxes, 4)),), GAP_M, OBSTACLE_GAP_M)
    assert table.unit.tolist() == [0, 2]
    assert table.obstacle.all()
    z = np.zeros(int(block.cube.max()) + 1)
    z[block.cube] = [5.0, 7.0, -4.0, -2.0]
    expected = [5.0 - 3.0, 2.0 - 7.0, -4.0 - 4.0, -1.0 + 2.0]
    np.testing.assert_allclose(table.slack(z), [np.array(expected) - OBSTACLE_GAP_M] * 2)


def test_nobody_to_keep_clear_of_makes_no_separation(crossing: Callable[..., Any]) -> None:
    table = all_separations(crossing(1, vehicles=1).problem().blocks, (), GAP_M, OBSTACLE_GAP_M)
    assert len(table) == 0
    assert table.slack(np.zeros(100)).shape == (0, 4)
