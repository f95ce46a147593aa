"""Stage A: pivotal points of all vehicles without conflicts.

Each vehicle is first planned alone among the obstacles; vehicles whose plans conflict are merged and
planned together, until no conflict crosses two groups. Then the union of the groups' optima is the
optimum of all. Groups of too many vehicles for one tree, or for the nodes that are left, are solved one
vehicle against the others: they join in turn, and the cubes of those that did are obstacles that move.
What is not proven to be the optimum is improved by neighbourhoods.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.conflict_tree import CONFLICT_M, TOGETHER, Group, Tree
from istc_replay.corridors.neighbourhoods import improve, join
from istc_replay.corridors.pivot_qp import Choices, PivotQp

if TYPE_CHECKING:
    from istc_replay.corridors.problem import CorridorProblem
    from istc_replay.datatypes import FloatArray


@dataclass(frozen=True, slots=True)
class TreeOutcome:
    """What the trees found: z with least cubes, or None; and how many nodes it took.

    `exhausted` tells that everything was searched: z is the optimum of the pivotal points, or
    where it is None there is none. `bound` is a lower bound of eq. (3). `open_conflict` is the
    separation that stayed open, `culprits` are those that are in each other's way, and `groups` the vehicles
    that had to be planned together. Those `in_turn` were planned one after the other.
    """

    z: FloatArray | None
    nodes: int
    exhausted: bool
    bound: float = 0.0
    open_conflict: int | None = None
    culprits: tuple[tuple[str, ...], ...] = ()
    groups: tuple[tuple[str, ...], ...] = ()
    in_turn: tuple[str, ...] = ()


def search(
    problem: CorridorProblem, node_budget: int, together: int = TOGETHER, *, in_turn: bool = True
) -> TreeOutcome:
    """Find pivotal points of small eq. (3) without conflict.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    node_budget : int
        Largest number of QPs; those of vehicles that join in turn come on top.
    together : int
        Most vehicles of one tree.
    in_turn : bool
        Whether vehicles that are too much for one tree are planned one after the other.
    """
    qp = PivotQp(problem)
    solved: dict[Group, Tree] = {}
    apart: set[Group] = set()  # too much for one tree
    groups = [frozenset([vehicle]) for vehicle in range(len(problem.blocks))]
    nodes = 0
    while True:
        for group in groups:
            if group in solved or group in apart:
                continue
            if len(group) > together:
                apart.add(group)
                continue
            tree = Tree(problem, qp, group, node_budget - nodes, _inherited(solved, group))
            tree.run()
            nodes += tree.nodes
            if tree.best is not None:
                solved[group] = tree
            elif not tree.exhausted:
                apart.add(group)
            else:
                conflict = tree.open_conflict
                culprits = _names(problem, group) if conflict is None else problem.pair(conflict)
                return TreeOutcome(None, nodes, True, 0.0, conflict, (culprits,))
        z = _union(qp, problem, _latest(solved))
        merged = _merged(problem, z, groups)
        if len(merged) == len(groups):
            break
        groups = merged
    # A bound of each part bounds the whole: of large groups that of the parts they were merged from.
    trees = _latest(solved)
    bound = sum(tree.bound for tree in trees)
    z, large = problem.least_cubes(z), frozenset[int]().union(*apart.intersection(groups))
    exhausted = all(tree.exhausted for tree in trees) and not large
    if large and not in_turn:
        return TreeOutcome(None, nodes, False, bound, None, (_names(problem, large),))
    if large:
        joined, more, culprits_left = _one_against_the_other(problem, qp, z, large, node_budget, together)
        nodes += more
        if joined is None:
            return TreeOutcome(None, nodes, False, bound, None, culprits_left)
        z = joined
    if not exhausted:
        z, more = improve(problem, z, max(node_budget - nodes, node_budget // 4))
        nodes += more
    names = tuple(_names(problem, group) for group in groups)
    return TreeOutcome(z, nodes, exhausted, bound, None, (), names, _names(problem, large))


def _one_against_the_other(
    problem: CorridorProblem, qp: PivotQp, z: FloatArray, large: Group, node_budget: int, together: int
) -> tuple[FloatArray | None, int, tuple[tuple[str, ...], ...]]:
    """Put vehicles beside all others in turn; else all of them at once, the earliest conflict first.

    Gives a solution or None, the number of QPs, and who found no place beside whom.
    """
    everyone = frozenset(range(len(problem.blocks)))
    order = [vehicle for vehicle in _joining_order(problem, z) if vehicle in large]
    joined, nodes, left = join(problem, z, order, everyone - large, together)
    if joined is not None:
        return joined, nodes, ()
    tree = Tree(problem, qp, everyone, node_budget, ())
    tree.earliest_first = True
    tree.plunge((), node_budget, first_only=True)
    nodes += tree.nodes
    if tree.best is not None:
        return problem.least_cubes(qp.z(tree.best)), nodes, ()
    return None, nodes, tuple(names for _, names in left)


def _joining_order(problem: CorridorProblem, z: FloatArray) -> list[int]:
    """The vehicles with the most conflicts first: they have the least choice."""
    table = problem.separations
    conflicts = np.zeros(len(problem.blocks), dtype=np.int64)
    open_ = (table.slack(z).max(axis=1, initial=-np.inf) < -CONFLICT_M) & ~table.obstacle
    for side in (table.first, table.second):
        np.add.at(conflicts, side[open_], 1)
    return sorted(range(len(conflicts)), key=lambda vehicle: (-conflicts[vehicle], vehicle))


def _latest(solved: dict[Group, Tree]) -> list[Tree]:
    """The trees of the largest groups solved, one for each vehicle."""
    latest: dict[int, Tree] = {vehicle: tree for group, tree in solved.items() for vehicle in group}
    return list({id(tree): tree for tree in latest.values()}.values())


def proof_parts(problem: CorridorProblem, qp: PivotQp, together: int) -> list[Group]:
    """The vehicles in groups that a tree can hold, those together that are most in each other's way."""
    everyone = tuple(range(len(problem.blocks)))
    alone = qp.root(everyone, ())
    if len(everyone) <= together or alone is None:
        return [frozenset(everyone)]
    table = problem.separations
    slack = table.slack(problem.least_cubes(qp.z(alone))).max(axis=1, initial=-np.inf)
    depth = np.zeros((len(everyone), len(everyone)))
    met = (slack < -CONFLICT_M) & ~table.obstacle
    np.add.at(depth, (table.first[met], table.second[met]), -slack[met])
    of = {vehicle: frozenset([vehicle]) for vehicle in everyone}
    for i, j in sorted(np.argwhere(depth > 0.0).tolist(), key=lambda pair: (-depth[pair[0], pair[1]], pair)):
        union = of[i] | of[j]
        if len(union) <= together:
            of |= dict.fromkeys(union, union)
    return list(dict.fromkeys(of.values()))


def _names(problem: CorridorProblem, group: Group) -> tuple[str, ...]:
    return tuple(problem.blocks[vehicle].vehicle_id for vehicle in sorted(group))


def _inherited(solved: dict[Group, Tree], group: Group) -> Choices:
    """Options that the parts of a group had chosen: a first guess of its own."""
    trees = _latest({part: tree for part, tree in solved.items() if part <= group})
    return tuple(choice for tree in trees if tree.best is not None for choice in tree.best.choices)


def _union(qp: PivotQp, problem: CorridorProblem, trees: list[Tree]) -> FloatArray:
    """The plans of the trees, and of who is in none its own without any option."""
    z = np.zeros(problem.size)
    planned = frozenset[int]().union(*(tree.group for tree in trees))
    others = tuple(vehicle for vehicle in range(len(problem.blocks)) if vehicle not in planned)
    free = qp.root(others, ()) if others else None
    if free is not None:
        z += qp.z(free)
    for tree in trees:
        if tree.best is not None:
            z += qp.z(tree.best)  # each has its own vehicles' entries alone
    return z


def _merged(problem: CorridorProblem, z: FloatArray, groups: list[Group]) -> list[Group]:
    """Merge groups between which z has a conflict."""
    of = {vehicle: group for group in groups for vehicle in group}
    table = problem.separations
    slack = table.slack(problem.least_cubes(z)).max(axis=1, initial=-np.inf)
    for d in np.flatnonzero((slack < -CONFLICT_M) & ~table.obstacle):
        first, second = of[int(table.first[d])], of[int(table.second[d])]
        if first != second:
            union = first | second
            of |= dict.fromkeys(union, union)
    return list(dict.fromkeys(of.values()))
