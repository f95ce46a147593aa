"""Post-encroachment times against looking at every pair of footprints, and the broad phase."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from istc_replay.geometry import box_corners
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.broad_phase import overlapping_pairs, reach_hulls
from istc_replay.safety.encroachment import encroachments
from istc_replay.safety.relation import conflict_angle
from istc_replay.safety.swept import time_to_collision

Array = NDArray[np.float64]


def traffic(rng: np.random.Generator, vehicles: int, samples: int) -> tuple[Array, Array]:
    """Vehicles that wander over a small place at 5 Hz, some of them absent for a while."""
    times = np.arange(samples) * 0.2
    heading = rng.uniform(-np.pi, np.pi, vehicles) + rng.normal(0, 0.2, vehicles) * times[:, None]
    speed = rng.uniform(1.0, 6.0, vehicles)
    step = np.stack([np.cos(heading), np.sin(heading)], axis=-1) * speed[:, None] * 0.2
    place = rng.uniform(-12, 12, (vehicles, 2)) + np.cumsum(step, axis=0) - step.sum(axis=0) / 2
    size = np.broadcast_to(rng.uniform([3.0, 1.5], [5.0, 2.0], (vehicles, 2)), (samples, vehicles, 2))
    boxes = np.concatenate([place, heading[..., None], size], axis=-1)
    boxes[5:9, 0] = np.nan
    boxes[:4, 1] = np.nan
    return boxes, times


@pytest.mark.parametrize("seed", range(4))
def test_they_are_those_of_every_pair_of_footprints(seed: int) -> None:
    boxes, times = traffic(np.random.default_rng(seed), 5, 45)
    expected = set()
    shapes = np.full(boxes.shape[:2], None, dtype=object)
    known = np.isfinite(boxes).all(axis=-1)
    shapes[known] = shapely.polygons(box_corners(*boxes[known].T))
    for i in range(5):
        for j in range(5):
            for k in range(times.size):
                later = [
                    m
                    for m in range(k, times.size)
                    if i != j
                    and known[k, i]
                    and known[m, j]
                    and m - k <= 15  # 3 s
                    and conflict_angle(boxes[k, i, 2], boxes[m, j, 2]) >= 0.5
                    and shapes[k, i].intersects(shapes[m, j])
                ]
                if later:
                    expected.add((k, later[0], i, j))
    found = encroachments(boxes, times, longest_s=3.0, least_angle_rad=0.5)
    assert len(expected) > 20
    assert set(zip(*(column.tolist() for column in found), strict=True)) == expected


def test_blocks_of_time_change_nothing() -> None:
    boxes, times = traffic(np.random.default_rng(9), 6, 60)
    whole = encroachments(boxes, times, longest_s=4.0, least_angle_rad=0.5)
    for block_s in (0.1, 0.7, 30.0):
        for one, two in zip(
            whole,
            encroachments(boxes, times, longest_s=4.0, least_angle_rad=0.5, block_s=block_s),
            strict=True,
        ):
            np.testing.assert_array_equal(one, two)


def test_followers_are_left_to_the_headway_and_nobody_meets_oneself() -> None:
    times = np.arange(0, 6, 0.1)
    boxes = np.zeros((times.size, 2, 5))
    boxes[:, 0, 0], boxes[:, 1, 0] = 8 * times, 8 * times - 12
    boxes[..., 3:] = 4.0, 2.0
    assert encroachments(boxes, times, longest_s=5.0, least_angle_rad=0.5)[0].size == 0
    assert encroachments(boxes, times, longest_s=5.0, least_angle_rad=0.0)[0].size > 0
    assert encroachments(boxes[:0], times[:0], longest_s=5.0, least_angle_rad=0.0)[0].size == 0


def test_the_broad_phase_keeps_every_pair_that_touches_within_its_reach_or_is_near() -> None:
    rng = np.random.default_rng(2)
    n, groups = 400, 10
    boxes = np.column_stack(
        [rng.uniform(-60, 60, (n, 2)), rng.uniform(-4, 4, n), rng.uniform(1, 9, n), rng.uniform(0.5, 2.5, n)]
    )
    velocity = np.stack([np.cos(boxes[:, 2]), np.sin(boxes[:, 2])], -1) * rng.uniform(-5, 25, n)[:, None]
    group = np.sort(rng.integers(0, groups, n))
    boxes[rng.integers(0, n, 10), 1] = np.nan
    low, high = reach_hulls(boxes, velocity, 5.0, np.zeros(n), 3.0)
    first, second = overlapping_pairs(low, high, group)
    kept = set(zip(first.tolist(), second.tolist(), strict=True))
    assert len(kept) == first.size
    assert (first < second).all()
    assert (group[first] == group[second]).all()
    i, j = np.triu_indices(n, 1)
    same = group[i] == group[j]
    i, j = i[same], j[same]
    needed = (time_to_collision(boxes[i], boxes[j], velocity[j] - velocity[i]) <= 5.0) | (
        box_gap(boxes[i], boxes[j]) <= 3.0
    )
    assert needed.sum() > 150
    assert set(zip(i[needed].tolist(), j[needed].tolist(), strict=True)) <= kept
    # And it throws away most of the rest.
    overlapping = (low[i] <= high[j]).all(axis=1) & (low[j] <= high[i]).all(axis=1)
    assert kept == set(zip(i[overlapping].tolist(), j[overlapping].tolist(), strict=True))
    assert first.size < 0.5 * i.size
