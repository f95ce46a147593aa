"""Motions of several vehicles that keep clear of each other."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest

from istc_replay.corridors.seed.lattice import Motion
from istc_replay.corridors.seed.repair import Repair

FOUR_WAYS = [(-15.0, 0.0, 0.0), (15.0, 0.0, np.pi), (0.0, -15.0, np.pi / 2), (0.0, 15.0, -np.pi / 2)]


def test_four_that_meet_in_the_middle_end_without_conflict(meeting: Any) -> None:
    lattices = meeting(FOUR_WAYS)[2]
    repair = Repair(lattices, 0.3, 0)
    assert repair.run(60, 5)
    for i, j in combinations(range(4), 2):
        a, b = repair.motions[i].cubes_m, repair.motions[j].cubes_m
        apart_x = np.maximum(a[:, 0] - b[:, 1], b[:, 0] - a[:, 1])
        apart_y = np.maximum(a[:, 2] - b[:, 3], b[:, 2] - a[:, 3])
        assert np.maximum(apart_x, apart_y).min() >= 0.3 - 2e-3


def test_equal_seeds_give_equal_motions(meeting: Any) -> None:
    lattices = meeting(FOUR_WAYS)[2]
    first, second = Repair(lattices, 0.3, 3), Repair(lattices, 0.3, 3)
    first.run(60, 5)
    second.run(60, 5)
    for a, b in zip(first.motions, second.motions, strict=True):
        assert a.path == b.path
        assert (a.places == b.places).all()


def test_improving_never_costs_more(meeting: Any) -> None:
    lattices = meeting(FOUR_WAYS)[2]
    rough, better = Repair(lattices, 0.3, 1), Repair(lattices, 0.3, 1)
    assert rough.run(60, 0)
    assert better.run(60, 15)
    assert better.cost <= rough.cost


def test_two_that_cannot_pass_are_told_within_the_budget(meeting: Any) -> None:
    walls = ((-25.0, 25.0, 1.4, 25.0), (-25.0, 25.0, -25.0, -1.4))
    lattices = meeting(FOUR_WAYS[:2], walls)[2]
    repair = Repair(lattices, 0.3, 0)
    assert not repair.run(5, 5)
    assert repair.rounds <= 5
    assert (0, 1) in repair.conflicts()


def test_a_pair_that_is_kept_apart_more_is_repaired_to_it(meeting: Any) -> None:
    lattices = meeting(FOUR_WAYS)[2]
    repair = Repair(lattices, 0.3, 0)
    assert repair.run(60, 5)

    def apart(unit: int) -> float:
        a, b = (repair.motions[v].cubes_m[unit] for v in (0, 2))
        return float(max(a[0] - b[1], b[0] - a[1], a[2] - b[3], b[2] - a[3]))

    nearest = min(range(24), key=apart)
    more = apart(nearest) + 0.5
    repair.keep_apart(2, 0, nearest, more)
    assert (0, 2) in repair.conflicts()
    assert repair.run(60, 5)
    assert apart(nearest) >= more


def test_who_is_barred_passes_elsewhere_or_is_told_to_have_no_way(meeting: Any) -> None:
    # The opening is 0.8 m narrower than the car-box with its gaps: allowed to a seed, not to layer 1.
    walls = ((-2.0, 2.0, 1.0, 24.9), (-2.0, 2.0, -24.9, -1.0))
    lattices = meeting(FOUR_WAYS[:1], walls)[2]
    repair = Repair(lattices, 0.3, 0)
    assert repair.run(5, 0)
    for _ in range(200):
        before = repair.motions[0]
        at = [unit for unit in range(24) if before.cubes_m[unit, 1] > -2.0 and before.cubes_m[unit, 0] < 2.0]
        if not at:
            break
        repair.bar(0, at[0])
        if not repair.run(5, 0):
            break
        after = repair.motions[0]
        assert after.path != before.path or (after.places != before.places).any()
    assert repair.no_way == 0 or not repair.arrives


def test_improving_goes_on_while_somebody_does_not_arrive(meeting: Any) -> None:
    lattices = meeting(FOUR_WAYS, units=16)[2]
    short = Repair(lattices, 0.3, 2)
    assert short.run(60, 0)
    longer = Repair(lattices, 0.3, 2)
    assert longer.run(60, 5)
    assert longer.cost <= short.cost
    assert longer.arrives >= short.arrives


def test_what_is_kept_from_round_to_round_changes_nothing(
    meeting: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    lattices = meeting(FOUR_WAYS, ((-2.0, 2.0, 5.0, 9.0),))[2]
    kept = Repair(lattices, 0.3, 5)
    kept.run(60, 20)
    kept.keep_apart(0, 1, 8, 0.5)
    kept.run(60, 20)

    def forgetful(repair: Repair, number: int, price: float, others: list[int]) -> Motion | None:
        lattice = repair.lattices[number]
        met = []
        for other in others:
            cubes, first = repair._kept_clear_m(number, other), repair.lattices[other].first_unit
            met.append(lattice.meeting(cubes, first, repair.gap_m))
        return lattice.best(met, price)

    monkeypatch.setattr(Repair, "_best", forgetful)
    anew = Repair(lattices, 0.3, 5)
    anew.run(60, 20)
    anew.keep_apart(0, 1, 8, 0.5)
    anew.run(60, 20)
    for a, b in zip(kept.motions, anew.motions, strict=True):
        assert a.path == b.path
        assert a.places.tolist() == b.places.tolist()


def test_cars_that_were_handed_over_close_to_each_other_find_a_way_from_there(meeting: Any) -> None:
    # Boxes 0.1 m nearer than the gap at the start: places of half a metre tell no better.
    starts = [(-15.0, 0.0, 0.0), (-15.0, 2.2, 0.0)]
    lattices = meeting(starts)[2]
    assert not Repair(lattices, 0.3, 0).run(20, 0)
    for lattice in lattices:
        lattice.handed = True
    handed = Repair(lattices, 0.3, 0)
    assert handed.run(20, 0)
    later = [motion.cubes_m[3:] for motion in handed.motions]
    assert np.maximum(later[1][:, 2] - later[0][:, 3], np.abs(later[1][:, 0] - later[0][:, 1])).min() >= 0.0
