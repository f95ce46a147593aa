"""Positions on the Earth as metres, against lengths of meridians and parallels."""

from __future__ import annotations

import math

import numpy as np
import pytest

from istc_replay.ingest.places import LocalFrame
from istc_replay.ingest.problems import Problems

#: WGS 84: semi-major axis [m] and flattening.
A_M, FLATTENING = 6_378_137.0, 1.0 / 298.257223563


def radii_m(latitude_deg: float) -> tuple[float, float]:
    """Radii of curvature of the meridian and of the parallel's plane at a latitude."""
    e2 = FLATTENING * (2.0 - FLATTENING)
    root = 1.0 - e2 * math.sin(math.radians(latitude_deg)) ** 2
    return A_M * (1.0 - e2) / root**1.5, A_M / math.sqrt(root) * math.cos(math.radians(latitude_deg))


@pytest.mark.parametrize("latitude", [0.0, 48.1, -33.9, 71.0])
@pytest.mark.parametrize("longitude", [11.6, -179.9999])
def test_a_little_way_is_as_long_as_its_arcs(latitude: float, longitude: float) -> None:
    step = 1e-3
    places = np.array([[0.0, 0.0], [step, 0.0], [0.0, step], [-step, -step]])
    problems = Problems()
    east, north = LocalFrame(problems).metres(
        latitude + places[:, 0], longitude + places[:, 1], np.ones(4, dtype=bool)
    )
    along, around = (radius * math.radians(step) for radius in radii_m(latitude))
    np.testing.assert_allclose(east, [0.0, 0.0, around, -around], atol=0.01)
    np.testing.assert_allclose(north, [0.0, along, 0.0, -along], atol=0.01)
    (told,) = problems.found()
    assert told.code == "local_origin"
    assert f"latitude {latitude:.9f}" in told.detail


def test_the_first_position_that_is_known_is_the_origin_of_all_that_follow() -> None:
    frame = LocalFrame(Problems())
    nothing = np.zeros(2), np.zeros(2), np.zeros(2, dtype=bool)
    assert [values.tolist() for values in frame.metres(*nothing)] == [[0.0, 0.0]] * 2
    known = np.array([False, True])
    east, north = frame.metres(np.array([0.0, 48.0]), np.array([0.0, 11.0]), known)
    assert (east[1], north[1]) == (0.0, 0.0)
    _, north = frame.metres(np.array([48.001]), np.array([11.0]), np.ones(1, dtype=bool))
    assert north[0] == pytest.approx(111.2, abs=0.1)


def test_positions_beyond_the_plane_are_told_with_how_many() -> None:
    problems = Problems()
    latitude = np.array([48.0, 48.1, 48.3, 49.0, 80.0])  # the second 11 km away, the last not known
    LocalFrame(problems).metres(latitude, np.full(5, 11.0), np.array([True, True, True, True, False]))
    told = [problem.detail for problem in problems.found() if problem.code == "far_from_origin"]
    assert told == [
        "a position is more than 20 km from the origin: the plane bends there",
        "1 more of this kind",
    ]
