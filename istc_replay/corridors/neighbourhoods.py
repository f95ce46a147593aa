"""Neighbourhoods: few vehicles plan anew, those they meet move along, all others stay where they are.

They improve a plan, and put one together where more vehicles meet than one tree can hold.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.conflict_tree import BETTER, TOGETHER, Group, Tree
from istc_replay.corridors.pivot_qp import Choices, PivotQp
from istc_replay.corridors.polish import polish_about

if TYPE_CHECKING:
    from collections.abc import Sequence

    from istc_replay.corridors.problem import CorridorProblem
    from istc_replay.datatypes import FloatArray

#: Least cubes of vehicles that meet are nearer than this at some time [m].
_NEAR_M = 1.0
#: Nodes of a neighbourhood by its size; sweeps over all of them, while one gains this share.
_NEIGHBOURHOOD_NODES = {1: 60, 2: 120}
_SWEEPS, _WORTH_A_SWEEP = 4, 0.005
#: Nodes for one vehicle that joins a plan, and attempts to put one together.
_JOINING_NODES = 200
_ATTEMPTS = 6

#: A vehicle that found no place, and the names of it and of one in its way.
Left = tuple[int, tuple[str, ...]]


def join(
    problem: CorridorProblem,
    z: FloatArray,
    order: Sequence[int],
    placed: Group = frozenset(),
    together: int = TOGETHER,
) -> tuple[FloatArray | None, int, tuple[Left, ...]]:
    """Put a plan together vehicle by vehicle; who finds no place joins first in the next attempt.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    z : (n,) array
        Each vehicle's plan alone.
    order : sequence of int
        The vehicles, in the order in which they join.
    placed : set of int
        Vehicles whose plans stand already; they move along where one that joins meets them.
    together : int
        Most vehicles that move at once.

    Returns
    -------
    tuple
        A solution with least cubes or None, the number of QPs, and of the best attempt who found no
        place, and the names of each and of one in its way.
    """
    qp, nodes, fewest = PivotQp(problem), 0, None
    for _ in range(_ATTEMPTS):
        joined, more, left = _joined(problem, qp, problem.least_cubes(z), order, placed, together)
        nodes += more
        if not left:
            return joined, nodes, ()
        if fewest is None or len(left) < len(fewest):
            fewest = left
        first = [vehicle for vehicle, _ in left]
        again = [*first, *(vehicle for vehicle in order if vehicle not in first)]
        if again == list(order):
            break
        order = again
    return None, nodes, tuple(fewest or ())


def _joined(
    problem: CorridorProblem,
    qp: PivotQp,
    z: FloatArray,
    order: Sequence[int],
    placed: Group,
    together: int,
) -> tuple[FloatArray, int, list[Left]]:
    """One attempt: the plan of those that found a place, the number of QPs, and who found none."""
    nodes, left = 0, list[Left]()
    for vehicle in order:
        costs = vehicle_costs(problem, z)
        meetings = _meetings(problem, z, placed | {vehicle})
        # First it alone chooses, then also whom it meets, and whom they meet.
        for rings in range(3):
            part = _moving(frozenset([vehicle]), costs, meetings, rings, together)
            moving = _moving(part, costs, meetings, together=together)
            kept = _kept(problem, z, part, moving)
            view = qp.beside(z, tuple(sorted(moving)))
            tree = Tree(problem, view, moving, _JOINING_NODES, kept, against=placed - moving)
            tree.plunge(kept, _JOINING_NODES // 2, first_only=True)
            if tree.best is None:
                tree.earliest_first = True
                tree.plunge(kept, _JOINING_NODES // 2, first_only=True)
            nodes += tree.nodes
            if tree.best is not None:
                z = problem.least_cubes(view.z(tree.best))
                placed |= {vehicle}
                break
        else:
            left.append((vehicle, _in_the_way(problem, vehicle, tree.open_conflict, meetings)))
    return z, nodes, left


def _in_the_way(
    problem: CorridorProblem, vehicle: int, conflict: int | None, meetings: set[tuple[int, int]]
) -> tuple[str, ...]:
    """Names of a vehicle that found no place and of whom it was last in conflict with, or meets."""
    name = problem.blocks[vehicle].vehicle_id
    if conflict is not None and name in problem.pair(conflict):
        return problem.pair(conflict)
    met = [w for pair in meetings if vehicle in pair for w in pair if w != vehicle]
    return (name, *(problem.blocks[w].vehicle_id for w in sorted(met)[:1]))


def improve(
    problem: CorridorProblem, z: FloatArray, node_budget: int, together: int = TOGETHER
) -> tuple[FloatArray, int]:
    """Plan few vehicles anew beside all others, costliest first, until none gives a better solution.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    z : (n,) array
        A solution.
    node_budget : int
        Largest number of QPs.
    together : int
        Most vehicles that move at once; all others are held where they are.

    Returns
    -------
    tuple
        A solution with least cubes, no worse, and the number of QPs.
    """
    qp, nodes = PivotQp(problem), 0
    for _ in range(_SWEEPS):
        before = problem.reference_cost(z)
        for size in _NEIGHBOURHOOD_NODES:
            z, more = _sweep(problem, qp, z, size, node_budget - nodes, together)
            nodes += more
        settled = polish_about(problem, z)
        if settled is not None and problem.reference_cost(settled) < problem.reference_cost(z):
            z = problem.least_cubes(settled)
        if nodes >= node_budget or problem.reference_cost(z) > (1.0 - _WORTH_A_SWEEP) * before:
            break
    return z, nodes


def _sweep(
    problem: CorridorProblem, qp: PivotQp, z: FloatArray, size: int, node_budget: int, together: int
) -> tuple[FloatArray, int]:
    """Neighbourhoods of one size."""
    tried: set[Group] = set()
    everyone = frozenset(range(len(problem.blocks)))
    nodes, limit = 0, _NEIGHBOURHOOD_NODES[size]
    while nodes < node_budget:
        costs = vehicle_costs(problem, z)
        part = _costliest_part(problem, z, costs, size, tried)
        if part is None:
            break
        moving = _moving(part, costs, _meetings(problem, z, everyone), together=together)
        kept = _kept(problem, z, part, moving)
        view = qp.beside(z, tuple(sorted(moving)))
        most = sum(costs[v] for v in moving) * (1.0 - BETTER)
        tree = Tree(problem, view, moving, limit, kept, against=everyone - moving, most=most)
        tree.search_below_guess()
        nodes += tree.nodes
        if tree.best is not None:
            z = problem.least_cubes(view.z(tree.best))
            tried = {other for other in tried if not other & part}
        tried.add(part)
    return z, nodes


def vehicle_costs(problem: CorridorProblem, z: FloatArray) -> list[float]:
    """Eq. (3) of each vehicle."""
    away = problem.quadratic * (z - problem.reference) ** 2
    return [float(away[block.pivot[1:]].sum()) for block in problem.blocks]


def _meetings(problem: CorridorProblem, z: FloatArray, among: Group) -> set[tuple[int, int]]:
    """Pairs of vehicles whose least cubes are near each other at some time."""
    table = problem.separations
    near = ~table.obstacle & (table.slack(z).max(axis=1, initial=-np.inf) < _NEAR_M)
    near &= np.isin(table.first, tuple(among)) & np.isin(table.second, tuple(among))
    return set(zip(table.first[near].tolist(), table.second[near].tolist(), strict=True))


def _costliest_part(
    problem: CorridorProblem, z: FloatArray, costs: list[float], size: int, tried: set[Group]
) -> Group | None:
    """The costliest vehicle, or two that meet, that were not tried yet."""
    parts = {frozenset([v]) for v in range(len(costs)) if costs[v] > BETTER}
    if size > 1:
        everyone = frozenset(range(len(costs)))
        parts = {frozenset(pair) for pair in _meetings(problem, z, everyone)}
    left = sorted(parts - tried, key=sorted)
    return max(left, key=lambda part: sum(costs[v] for v in part), default=None)


def _moving(
    part: Group,
    costs: list[float],
    meetings: set[tuple[int, int]],
    rings: int = 2,
    together: int = TOGETHER,
) -> Group:
    """The part and whom it meets, and whom they meet, the costliest first, as many as can be afforded."""
    moving = set(part)
    for _ in range(rings):
        met = {w for pair in meetings if moving & set(pair) for w in pair} - moving
        moving |= set(sorted(met, key=lambda v: (-costs[v], v))[: max(0, together - len(moving))])
    return frozenset(moving)


def binding_choices(problem: CorridorProblem, z: FloatArray) -> Choices:
    """The options by which those keep apart at z who are near each other."""
    slack = problem.separations.slack(z)
    near = np.flatnonzero(slack.max(axis=1, initial=-np.inf) < _NEAR_M)
    return tuple((int(d), int(slack[d].argmax())) for d in near)


def _kept(problem: CorridorProblem, z: FloatArray, part: Group, moving: Group) -> Choices:
    """Options that those keep who move but do not choose anew."""
    table = problem.separations
    slack = table.slack(z)
    others = tuple(moving - part)
    first, second = np.isin(table.first, others), np.isin(table.second, others) & ~table.obstacle
    theirs = (first | second) & ~np.isin(table.first, tuple(part))
    theirs &= table.obstacle | ~np.isin(table.second, tuple(part))
    theirs &= slack.max(axis=1, initial=-np.inf) < _NEAR_M
    return tuple((int(d), int(slack[d].argmax())) for d in np.flatnonzero(theirs))
