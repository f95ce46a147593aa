"""Which path is taken: along a taut line, or from a search."""

from __future__ import annotations

import math

import numpy as np
import pytest

from istc_replay.datatypes import MapBounds, SceneObstacle
from istc_replay.guidance.clearance import Clearance
from istc_replay.guidance.path_search import along_taut_lines, searched
from istc_replay.guidance.taut import Limits
from istc_replay.guidance.traffic import Traffic

from ..support.participants import CAR

FIELD = MapBounds(0.0, 50.0, 0.0, 38.0)
ENDS = np.array([[5.0, 19.0, 0.0], [45.0, 19.0, 0.0]])
BLOCK = SceneObstacle("block", 25.0, 20.0, 0.0, 6.0, 8.0)


def limits(*obstacles: SceneObstacle) -> Limits:
    return Limits(0.25, 1.0 / 6.0, 0.05, Clearance.of(CAR, FIELD, obstacles, 0.3, 0.1))


def test_a_search_comes_to_the_path_of_the_taut_line() -> None:
    taut = along_taut_lines(ENDS, limits(BLOCK), None)
    found, _ = searched(ENDS, limits(BLOCK), None, 4000, None)
    assert taut is not None
    assert found is not None
    assert found.length_m == pytest.approx(taut.length_m, abs=0.05)


def test_a_known_path_that_nothing_betters_is_kept() -> None:
    known = along_taut_lines(ENDS, limits(), None)
    assert searched(ENDS, limits(), None, 50, known)[0] is known


def test_where_every_line_is_closed_the_search_says_so() -> None:
    closed = limits(SceneObstacle("wall", 25.0, 19.0, 0.0, 2.0, 38.0))
    assert along_taut_lines(ENDS, closed, None) is None
    assert searched(ENDS, closed, None, 20, None) == (None, False)


def test_ends_too_near_for_a_tangent_are_joined_by_the_search() -> None:
    ends = np.array([[25.0, 19.0, 0.0], [25.0, 21.0, math.pi]])
    curve, _ = searched(ends, limits(), None, 4000, None)
    assert curve is not None
    np.testing.assert_allclose(curve.end[:2], ends[1, :2], atol=1e-8)


def test_traffic_on_the_shorter_way_makes_the_other_one_better() -> None:
    alone = along_taut_lines(ENDS, limits(BLOCK), None)
    assert alone is not None
    driven = alone.points(np.arange(0.0, alone.length_m, Traffic.spacing_m(5.0)))
    aside = along_taut_lines(ENDS, limits(BLOCK), Traffic.of([driven], 5.0))
    assert aside is not None
    assert alone.points([20.0])[0, 1] < 19.0 < aside.points([20.0])[0, 1]


def test_traffic_costs_nothing_where_it_is_not_met() -> None:
    standing = Traffic.of([np.array([[25.0, 5.0]])], 5.0)
    assert standing is not None
    along = np.column_stack([np.arange(0.0, 50.0, 0.5), np.full(100, 19.0)])
    assert standing.cost_m(along, 0.5) == 0.0
    assert standing.cost_m(along - (0.0, 14.0), 0.5) == pytest.approx(9.0, abs=0.6)
