"""Conflict types, headways, changes of speed, and RSS against the published formulas by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from istc_replay.config import AuditConfig
from istc_replay.safety.pair_samples import rss_parameters
from istc_replay.safety.relation import CONFLICT_TYPES, conflict_angle, conflict_type, delta_v, headway
from istc_replay.safety.rss import (
    rss_margin,
    safe_distance_lateral,
    safe_distance_opposite,
    safe_distance_same,
)

Array = NDArray[np.float64]
AUDIT = AuditConfig()
RSS = rss_parameters(AUDIT)
LIMITS = (AUDIT.rear_end_rad, AUDIT.crossing_rad, AUDIT.head_on_rad)


def box(x: float, y: float, heading: float = 0.0, length: float = 4.0, width: float = 2.0) -> Array:
    return np.array([[x, y, heading, length, width]])


def one(value: float) -> Array:
    return np.array([value])


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [(0, "rear_end"), (29.9, "rear_end"), (30.1, "lane_change"), (84.9, "lane_change"), (90, "crossing"),
     (149.9, "crossing"), (150.1, "head_on"), (180, "head_on"), (-90, "crossing"), (350, "rear_end")],
)  # fmt: skip
def test_conflict_types_are_those_of_ssam(degrees: float, expected: str) -> None:
    angle = conflict_angle(one(0.3), one(0.3 + np.radians(degrees)))
    assert CONFLICT_TYPES[int(conflict_type(angle, LIMITS)[0])] == expected
    assert conflict_type(one(np.nan), LIMITS)[0] == -1


@pytest.mark.parametrize(("limit", "expected"), [(0, "lane_change"), (1, "lane_change"), (2, "crossing")])
def test_at_a_limit_itself_the_type_is_that_of_ssam(limit: int, expected: str) -> None:
    assert CONFLICT_TYPES[int(conflict_type(one(LIMITS[limit]), LIMITS)[0])] == expected


def test_headway_on_a_straight_is_gap_over_speed() -> None:
    gap, seconds = headway(box(0, 0), box(24, 0.5), one(10.0), moving_mps=0.5, same_path_rad=0.5)
    assert gap[0] == pytest.approx(20.0, abs=0.01)
    assert seconds[0] == pytest.approx(2.0, abs=0.001)


@pytest.mark.parametrize("radius", [30.0, -50.0, 200.0])
def test_headway_follows_a_bend(radius: float) -> None:
    angle = 15.0 / abs(radius)
    leader = box(abs(radius) * np.sin(angle), radius * (1 - np.cos(angle)), np.sign(radius) * angle)
    gap, _ = headway(box(0, 0), leader, one(10.0), moving_mps=0.5, same_path_rad=0.6)
    assert gap[0] == pytest.approx(15.0 - 4.0, abs=1e-9)
    beside = leader + np.array([[np.sin(angle) * -3.5 * np.sign(radius), np.cos(angle) * 3.5, 0, 0, 0]])
    assert np.isnan(headway(box(0, 0), beside, one(10.0), moving_mps=0.5, same_path_rad=0.6)[0][0])


@pytest.mark.parametrize(
    ("leader", "speed"),
    [
        (box(24, 3.5), 10.0),  # the next lane
        (box(-24, 0), 10.0),  # behind
        (box(24, 0, np.pi / 2), 10.0),  # crossing
        (box(24, 0), 0.4),  # standing
        (box(24, np.nan), 10.0),
        (box(24, 0), np.nan),
    ],
)
def test_who_does_not_follow_has_no_headway(leader: Array, speed: float) -> None:
    assert np.isnan(headway(box(0, 0), leader, one(speed), moving_mps=0.5, same_path_rad=0.5)[1][0])


def test_changes_of_speed_share_the_impulse_by_the_masses() -> None:
    small, large = box(0, 0, length=4, width=2), box(9, 0, length=12, width=2)
    first, second = delta_v(small, large, np.array([[-12.0, -16.0]]))
    assert (first[0], second[0]) == (pytest.approx(15.0), pytest.approx(5.0))


# --- RSS: numbers worked out by hand from the printed formulas ---------------------------------


def test_safe_distance_behind_a_leader() -> None:
    # 20 + 1.75 + 23.5^2 / 8 - 15^2 / 16
    assert safe_distance_same(one(20.0), one(15.0), RSS)[0] == pytest.approx(76.71875)
    half = replace(RSS, response_s=0.5)
    assert safe_distance_same(one(20.0), one(20.0), half)[0] == pytest.approx(10 + 0.4375 + 21.75**2 / 8 - 25)
    assert safe_distance_same(one(0.0), one(30.0), RSS)[0] == 0.0


def test_safe_distance_head_on() -> None:
    # 10 (own lane): (10 + 13.5) / 2 + 13.5^2 / 6; 8: (8 + 11.5) / 2 + 11.5^2 / 8
    assert safe_distance_opposite(one(10.0), one(8.0), RSS)[0] == pytest.approx(
        11.75 + 30.375 + 9.75 + 16.53125
    )


def test_safe_distance_across() -> None:
    # towards each other at 0.5 each: mu + 2 (0.6 + 0.7^2 / 1.6)
    assert safe_distance_lateral(one(0.5), one(-0.5), RSS)[0] == pytest.approx(0.1 + 2 * (0.6 + 0.30625))
    # at rest: mu + 2 (0.1 + 0.2^2 / 1.6)
    assert safe_distance_lateral(one(0.0), one(0.0), RSS)[0] == pytest.approx(0.1 + 2 * (0.1 + 0.025))
    # One at rest, the other away from it at 0.15: 0.125 less 0.05 and what it comes back by, 0.05^2 / 1.6.
    away = safe_distance_lateral(one(0.0), one(0.15), RSS)[0]
    assert away == pytest.approx(0.1 + 0.125 - (0.05 - 0.05**2 / 1.6))


@pytest.mark.parametrize("away", [0.5, 3.0, 9.0])
def test_the_faster_two_move_apart_the_less_room_they_need_across(away: float) -> None:
    assert safe_distance_lateral(one(0.0), one(away), RSS)[0] == pytest.approx(0.1)
    assert safe_distance_lateral(one(-away), one(0.0), RSS)[0] == pytest.approx(0.1)


def margin(a: Array, b: Array, speeds: tuple[float, float]) -> float:
    return float(rss_margin(a, b, (one(speeds[0]), one(speeds[1])), RSS, (LIMITS[0], LIMITS[2]))[0])


def test_danger_needs_both_directions_unsafe() -> None:
    near = margin(box(0, 0), box(24, 0), (20.0, 15.0))
    # Across, boxes in one lane overlap by their width, and rest is what they keep.
    assert near == pytest.approx(max(20.0 - 76.71875, -2.0 - 0.35))
    assert margin(box(0, 0), box(24, 3.5), (20.0, 15.0)) == pytest.approx(1.5 - 0.35)
    assert margin(box(0, 0), box(90, 0), (20.0, 15.0)) == pytest.approx(86.0 - 76.71875)


@pytest.mark.parametrize("turn", [0.0, 1.0, -2.5])
def test_rss_knows_no_preferred_direction(turn: float) -> None:
    c, s = np.cos(turn), np.sin(turn)

    def turned(x: float, y: float, heading: float) -> Array:
        return box(c * x - s * y, s * x + c * y, heading + turn)

    a, b = turned(0, 0, 0.0), turned(30, 1.0, 0.1)
    expected = margin(box(0, 0), box(30, 1.0, 0.1), (18.0, 11.0))
    assert expected < 0.0
    assert margin(a, b, (18.0, 11.0)) == pytest.approx(expected, abs=1e-9)
    assert margin(b, a, (11.0, 18.0)) == pytest.approx(expected, abs=1e-9)


def test_meeting_traffic_is_in_danger_before_it_has_passed_and_crossing_traffic_is_not_judged() -> None:
    assert margin(box(0, 0), box(40, 0.5, np.pi), (10.0, 10.0)) < 0.0
    assert margin(box(0, 0), box(40, 3.5, np.pi), (10.0, 10.0)) > 0.0
    assert margin(box(0, 0), box(-40, 0.5, np.pi), (10.0, 10.0)) > 0.0
    assert np.isnan(margin(box(0, 0), box(20, 0, np.pi / 2), (10.0, 10.0)))


def test_of_the_axes_of_either_vehicle_the_better_margin_counts() -> None:
    # The second drives off to the left: seen along the first it is farther aside than seen along itself.
    across = 6.0 - (2.0 + 4.0 * np.sin(0.4) + 2.0 * np.cos(0.4)) / 2.0
    expected = across - 0.1  # it moves away: the margin mu alone is asked for
    assert margin(box(0, 0), box(24, 6, 0.4), (20.0, 15.0)) == pytest.approx(expected)
    assert margin(box(24, 6, 0.4), box(0, 0), (15.0, 20.0)) == pytest.approx(expected)


@pytest.mark.parametrize("turn", [0.3, -0.3])
def test_who_comes_from_the_left_is_as_near_as_who_comes_from_the_right(turn: float) -> None:
    left = margin(box(0, 0), box(10, 6.0, turn), (10.0, 10.0))
    right = margin(box(0, 0), box(10, -6.0, -turn), (10.0, 10.0))
    assert left == pytest.approx(right)
    away, towards = (margin(box(0, 0), box(10, 6.0, angle), (10.0, 10.0)) for angle in (0.3, -0.3))
    assert towards < away - 1.0
