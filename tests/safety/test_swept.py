"""Time to collision, DRAC and required braking against computations that share nothing with them."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from istc_replay.geometry import box_corners
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.braking import required_deceleration
from istc_replay.safety.swept import pair_measures, silhouette_overlap, time_to_collision

Array = NDArray[np.float64]


def random_pairs(count: int, seed: int, spread: float = 25.0) -> tuple[Array, Array, Array]:
    """Boxes and relative velocities: a third parallel or perpendicular, half far from the origin."""
    rng = np.random.default_rng(seed)
    a, b = (
        np.column_stack(
            [
                rng.uniform(-spread, spread, (count, 2)),
                rng.uniform(-np.pi, np.pi, count),
                rng.uniform(0.5, 12.0, count),
                rng.uniform(0.4, 2.6, count),
            ]
        )
        for _ in range(2)
    )
    b[: count // 3, 2] = a[: count // 3, 2] + rng.integers(-2, 3, count // 3) * np.pi / 2
    utm = np.where(rng.random(count) < 0.5, 1.0, 0.0)[:, None] * np.array([448_262.0, 5_411_932.0])
    a[:, :2] += utm
    b[:, :2] += utm
    velocity = rng.normal(0.0, 8.0, (count, 2))
    # Most random pairs miss each other: aim a half of them.
    aimed = rng.random(count) < 0.5
    towards = (a - b)[aimed, :2] + rng.normal(0.0, 2.0, (aimed.sum(), 2))
    velocity[aimed] = towards * rng.uniform(0.1, 1.0, (aimed.sum(), 1))
    return a, b, velocity


def corners(boxes: Array, origin: Array) -> Array:
    moved = boxes.copy()
    moved[:, :2] -= origin
    return box_corners(*moved.T)


def ray_oracle(a: Array, b: Array, velocity: Array) -> Array:
    """First time at which -v t is in the Minkowski difference: the ray's first crossing of its chords.

    All chords between the 16 differences of corners lie in their hull, and its boundary is among
    them. The ray starts outside, so what it crosses first is the boundary.
    """
    origin = a[:, :2]
    differences = (corners(b, origin)[:, None] - corners(a, origin)[:, :, None]).reshape(-1, 16, 2)
    i, j = np.triu_indices(16, 1)
    start, chord = differences[:, i], differences[:, j] - differences[:, i]
    ray = -velocity[:, None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = ray[..., 0] * chord[..., 1] - ray[..., 1] * chord[..., 0]
        t = (start[..., 0] * chord[..., 1] - start[..., 1] * chord[..., 0]) / cross
        u = (start[..., 0] * ray[..., 1] - start[..., 1] * ray[..., 0]) / cross
    times = np.where((t >= 0.0) & (u >= 0.0) & (u <= 1.0), t, np.inf).min(axis=1)
    inside = shapely.intersects(shapely.polygons(corners(a, origin)), shapely.polygons(corners(b, origin)))
    return np.where(inside, 0.0, times)


@pytest.fixture(scope="module")
def many() -> tuple[Array, Array, Array, Array]:
    """20,000 pairs and their times by the oracle, but for those that would graze within rounding."""
    a, b, velocity = random_pairs(20_000, 1)
    clear = (np.abs(silhouette_overlap(a, b, velocity)) > 1e-6) & (np.abs(box_gap(a, b)) > 1e-9)
    assert clear.sum() > 19_900
    a, b, velocity = a[clear], b[clear], velocity[clear]
    return a, b, velocity, ray_oracle(a, b, velocity)


def test_times_equal_those_of_a_ray_through_the_minkowski_difference(
    many: tuple[Array, Array, Array, Array],
) -> None:
    a, b, velocity, expected = many
    found = time_to_collision(a, b, velocity)
    assert (np.isinf(found) == np.isinf(expected)).all()
    assert (expected == 0.0).sum() > 100
    assert (np.isfinite(expected) & (expected > 0.0)).sum() > 5_000
    finite = np.isfinite(expected)
    np.testing.assert_allclose(found[finite], expected[finite], rtol=1e-7, atol=2e-9)


def test_gaps_equal_shapelys_with_their_sign(many: tuple[Array, Array, Array, Array]) -> None:
    a, b, velocity, _ = many
    gap = pair_measures(a, b, velocity)[0]
    one, two = (shapely.polygons(corners(boxes, a[:, :2])) for boxes in (a, b))
    distance = shapely.distance(one, two)
    np.testing.assert_allclose(np.maximum(gap, 0.0), distance, atol=1e-9, rtol=0.0)
    assert ((gap > 0.0) == (distance > 0.0)).all()


def test_at_the_time_found_the_boxes_touch(many: tuple[Array, Array, Array, Array]) -> None:
    a, b, velocity, _ = many
    time = time_to_collision(a, b, velocity)
    ahead = np.isfinite(time) & (time > 0.0)
    moved = b[ahead].copy()
    moved[:, :2] += velocity[ahead] * time[ahead, None]
    assert np.abs(box_gap(a[ahead], moved)).max() < 2e-8


def turned(a: Array, b: Array, velocity: Array, angle: float) -> tuple[Array, Array, Array]:
    """The same pairs, turned about the first box."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    one, two = a.copy(), b.copy()
    two[:, :2] = a[:, :2] + (b[:, :2] - a[:, :2]) @ turn.T
    one[:, 2] += angle
    two[:, 2] += angle
    return one, two, velocity @ turn.T


@pytest.mark.parametrize("how", ["moved", "turned", "swapped"])
def test_nothing_changes_when_a_pair_is(how: str, many: tuple[Array, Array, Array, Array]) -> None:
    a, b, velocity, _ = many
    before = pair_measures(a, b, velocity)
    if how == "swapped":
        after = pair_measures(b, a, -velocity)
    elif how == "moved":
        shift = np.array([1234.5, -987.25, 0.0, 0.0, 0.0])
        after = pair_measures(a + shift, b + shift, velocity)
    else:
        after = pair_measures(*turned(a, b, velocity, 0.7))
    for one, two in zip(before, after, strict=True):
        np.testing.assert_allclose(two, one, rtol=1e-6, atol=1e-7)


def test_a_later_start_is_that_much_nearer(many: tuple[Array, Array, Array, Array]) -> None:
    a, b, velocity, time = many
    ahead = np.isfinite(time) & (time > 0.6)
    later = b[ahead].copy()
    later[:, :2] += 0.5 * velocity[ahead]
    np.testing.assert_allclose(
        time_to_collision(a[ahead], later, velocity[ahead]), time[ahead] - 0.5, atol=1e-6
    )


CAR = [0.0, 0.0, 0.0, 4.0, 2.0]


@pytest.mark.parametrize(
    ("other", "velocity", "expected"),
    [
        ([14.0, 0.0, 0.0, 4.0, 2.0], [-5.0, 0.0], 2.0),  # ten metres at five a second
        ([14.0, 0.0, 0.0, 4.0, 2.0], [5.0, 0.0], np.inf),  # leaving
        ([14.0, 0.0, 0.0, 4.0, 2.0], [0.0, 0.0], np.inf),  # the same velocity
        ([3.0, 0.0, 0.0, 4.0, 2.0], [5.0, 0.0], 0.0),  # overlapping, though leaving
        ([3.0, 0.0, 0.0, 4.0, 2.0], [0.0, 0.0], 0.0),  # overlapping at rest
        ([4.0, 0.0, 0.0, 4.0, 2.0], [1.0, 0.0], 0.0),  # touching: boxes are closed
        ([14.0, 2.0, 0.0, 4.0, 2.0], [-5.0, 0.0], 2.0),  # grazing counts
        ([14.0, 2.0 + 1e-9, 0.0, 4.0, 2.0], [-5.0, 0.0], np.inf),  # and just beside does not
        ([0.0, 8.0, np.pi / 2, 4.0, 2.0], [0.0, -2.5], 2.0),  # from the side
        ([14.0, 0.0, 0.0, 4.0, 2.0], [-1e-9, 0.0], 1e10),  # hardly moving
    ],
)
def test_edge_cases(other: list[float], velocity: list[float], expected: float) -> None:
    assert time_to_collision(CAR, other, velocity) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("unknown", [np.nan, np.inf])
@pytest.mark.parametrize("column", range(5))
def test_what_is_not_known_is_not_judged(column: int, unknown: float) -> None:
    other = np.array([14.0, 0.0, 0.0, 4.0, 2.0])
    other[column] = unknown
    for value in pair_measures(CAR, other, [-5.0, 0.0]):
        assert np.isnan(value)
    assert np.isnan(time_to_collision(CAR, [14.0, 0.0, 0.0, 4.0, 2.0], [np.nan, 0.0]))


def test_drac_is_the_familiar_one_in_a_lane() -> None:
    gap, ttc, drac = pair_measures(CAR, [14.0, 0.5, 0.0, 4.0, 2.0], [-5.0, 0.0])
    assert (gap, ttc) == (pytest.approx(10.0), pytest.approx(2.0))
    assert drac == pytest.approx(5.0**2 / (2 * 10.0))
    assert pair_measures(CAR, [14.0, 0.5, 0.0, 4.0, 2.0], [5.0, 0.0])[2] == 0.0
    assert pair_measures(CAR, CAR, [5.0, 0.0])[2] == np.inf


def test_the_silhouette_overlap_is_what_shapely_sees_across_the_relative_velocity() -> None:
    a, b, velocity = random_pairs(500, 3)
    across = np.stack([-velocity[:, 1], velocity[:, 0]], axis=-1)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    one, two = (np.einsum("nij,nj->ni", corners(boxes, a[:, :2]), across) for boxes in (a, b))
    # Positive overlaps are measured between the near edges, however far inside one is.
    expected = np.minimum(one.max(1) - two.min(1), two.max(1) - one.min(1))
    np.testing.assert_allclose(silhouette_overlap(a, b, velocity), expected, atol=1e-8)


def least_gap_braking(a: Array, b: Array, own: Array, other: Array, braking: float) -> float:
    """The least gap while the first brakes to a stop, on a fine grid of times."""
    speed = float(np.hypot(*own))
    t = np.linspace(0.0, 60.0, 24_001)
    until = np.minimum(t, speed / braking if braking > 0.0 else np.inf)
    way = speed * until - braking * until**2 / 2.0
    one, two = np.tile(a, (t.size, 1)), np.tile(b, (t.size, 1))
    one[:, :2] += own / max(speed, 1e-12) * way[:, None]
    two[:, :2] += other * t[:, None]
    return float(box_gap(one, two).min())


def test_required_braking_is_where_a_simulation_stops_hitting() -> None:
    rng = np.random.default_rng(5)
    a, b, _ = random_pairs(2_000, 4, 15.0)
    a[:, :2] -= (middle := b[:, :2].round())
    b[:, :2] -= middle
    speeds = rng.uniform(0.0, 15.0, (2, a.shape[0]))
    own, other = (
        np.stack([np.cos(x[:, 2]), np.sin(x[:, 2])], -1) * v[:, None]
        for x, v in zip((a, b), speeds, strict=True)
    )
    required = required_deceleration(a, b, own, other)
    time = time_to_collision(a, b, other - own)
    np.testing.assert_array_equal(required > 0.0, np.isfinite(time))
    ahead = np.flatnonzero((time > 0.0) & (time < 8.0))[:110]
    assert 10 < np.isinf(required[ahead]).sum() < ahead.size - 30
    for k in ahead:
        if np.isinf(required[k]):
            assert least_gap_braking(a[k], b[k], own[k], other[k], 1e7) < 1e-3
        else:
            assert least_gap_braking(a[k], b[k], own[k], other[k], required[k] * 1.02) > 0.0
            # The grid of times sees a touch as a gap of up to the way of half a step.
            assert least_gap_braking(a[k], b[k], own[k], other[k], required[k] * 0.98) < 0.02


def test_required_braking_in_a_lane_is_the_textbooks() -> None:
    follower, leader = np.array([CAR]), np.array([[24.0, 0.0, 0.0, 4.0, 2.0]])
    required = required_deceleration(follower, leader, np.array([[15.0, 0.0]]), np.array([[5.0, 0.0]]))
    assert required[0] == pytest.approx(10.0**2 / (2 * 20.0))
    to_rest = required_deceleration(follower, leader, np.array([[15.0, 0.0]]), np.array([[0.0, 0.0]]))
    assert to_rest[0] == pytest.approx(15.0**2 / (2 * 20.0))
    hit_from_behind = required_deceleration(leader, follower, np.array([[5.0, 0.0]]), np.array([[15.0, 0.0]]))
    assert hit_from_behind[0] == np.inf
    unknown = required_deceleration(follower, leader, np.array([[np.nan, 0.0]]), np.array([[0.0, 0.0]]))
    assert np.isnan(unknown[0])
