"""The best weights of groups, and that they are a bound."""

from __future__ import annotations

import numpy as np
import pytest

from istc_replay.corridors.packing import pack


def random_excesses(seed: int, vehicles: int, groups: int) -> dict[frozenset[int], float]:
    """Groups of two to four vehicles and what they cost more together."""
    random = np.random.default_rng(seed)
    sizes = random.integers(2, 5, groups)
    members = [frozenset(random.choice(vehicles, size, replace=False).tolist()) for size in sizes]
    return {group: float(random.uniform(-10.0, 1000.0)) for group in members}


def test_three_pairs_of_three_vehicles_count_half_each() -> None:
    packing = pack({frozenset({0, 1}): 3.0, frozenset({0, 2}): 2.0, frozenset({1, 2}): 2.0}, 3)
    assert packing.excess == pytest.approx(3.5, abs=1e-6)
    assert list(packing.weights.values()) == pytest.approx([0.5, 0.5, 0.5], abs=1e-6)
    assert packing.parts.tolist() == pytest.approx([1.5, 1.5, 0.5], abs=1e-5)


@pytest.mark.parametrize("seed", range(10))
def test_weights_and_parts_prove_each_other_best(seed: int) -> None:
    vehicles = 3 + seed
    excess = random_excesses(seed, max(4, vehicles), 3 * vehicles)
    packing = pack(excess, max(4, vehicles))
    load = np.zeros(max(4, vehicles))
    for group, weight in packing.weights.items():
        assert weight >= 0.0
        load[sorted(group)] += weight
    assert load.max() <= 1.0 + 1e-12
    assert packing.excess == pytest.approx(sum(w * excess[g] for g, w in packing.weights.items()))
    # Parts that cover every group's excess bound what any weights can add up to.
    assert all(packing.parts[sorted(group)].sum() >= value - 1e-3 for group, value in excess.items())
    assert packing.parts.sum() == pytest.approx(packing.excess, rel=1e-5)


@pytest.mark.parametrize("excess", [{}, {frozenset({0, 1}): 0.0}, {frozenset({0, 1}): -4.0}])
def test_groups_without_an_excess_add_nothing(excess: dict[frozenset[int], float]) -> None:
    packing = pack(excess, 2)
    assert (packing.excess, packing.weights, packing.parts.tolist()) == (0.0, {}, [0.0, 0.0])
