"""Stage A: pivotal points of all vehicles without conflicts.

Each vehicle is first planned alone among the obstacles; vehicles whose plans conflict are merged and
planned together, until no conflict crosses two groups. Then the union of the groups' optima is the
optimum of all. Where more vehicles meet than one tree can hold, they join one after the other. What is
not proven to be the optimum is improved by neighbourhoods.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.conflict_tree import CONFLICT_M, TOGETHER, Group, Tree
from istc_replay.corridors.neighbourhoods import binding_choices, improve, join, vehicle_costs
from istc_replay.corridors.pivot_qp import Choices, PivotQp

if TYPE_CHECKING:
    from istc_replay.corridors.problem import CorridorProblem
    from istc_replay.datatypes import FloatArray

#: Variables of a QP that counts as one: eight vehicles for thirteen units.
_USUAL = 208


@dataclass(frozen=True, slots=True)
class TreeOutcome:
    """What the trees found: z with least cubes, or None; and how many nodes it took.

    `exhausted` tells that everything was searched: z is the optimum of the pivotal points, or
    where it is None there is none. `bound` is a lower bound of eq. (3). `open_conflict` is the
    separation that stayed open, and `groups` the vehicles that had to be planned together.
    """

    z: FloatArray | None
    nodes: int
    exhausted: bool
    bound: float = 0.0
    open_conflict: int | None = None
    groups: tuple[tuple[str, ...], ...] = ()


def search(problem: CorridorProblem, node_budget: int) -> TreeOutcome:
    """Find pivotal points of small eq. (3) without conflict.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    node_budget : int
        Largest number of QPs; those of vehicles that join a large group come on top.
    """
    qp = PivotQp(problem)
    solved: dict[Group, Tree] = {}
    groups = [frozenset([vehicle]) for vehicle in range(len(problem.blocks))]
    nodes = 0
    while True:
        for group in groups:
            if group in solved or len(group) > TOGETHER:
                continue
            tree = Tree(problem, qp, group, node_budget - nodes, _inherited(solved, group))
            tree.run()
            nodes += tree.nodes
            if tree.best is None:
                failed: tuple[tuple[str, ...], ...] = (_names(problem, group),)
                return TreeOutcome(None, nodes, tree.exhausted, 0.0, tree.open_conflict, failed)
            solved[group] = tree
        z = _union(qp, problem, _latest(solved))
        merged = _merged(problem, z, groups)
        if len(merged) == len(groups):
            break
        groups = merged
    # A bound of each part bounds the whole: of large groups that of the parts they were merged from.
    trees = _latest(solved)
    bound = sum(tree.bound for tree in trees)
    names = tuple(_names(problem, group) for group in groups)
    exhausted = all(tree.exhausted for tree in trees) and all(len(group) <= TOGETHER for group in groups)
    z = problem.least_cubes(z)
    if any(len(group) > TOGETHER for group in groups):
        joined, more, pair = join(problem, z, _joining_order(problem, z))
        nodes += more
        if joined is None:
            everyone = Tree(problem, qp, frozenset(range(len(problem.blocks))), node_budget, ())
            everyone.earliest_first = True
            everyone.plunge((), node_budget, first_only=True)
            nodes += everyone.nodes
            if everyone.best is None:
                culprits = names if pair is None else (_names(problem, frozenset(pair)),)
                return TreeOutcome(None, nodes, False, bound, None, culprits)
            joined = problem.least_cubes(qp.z(everyone.best))
        z = joined
    if not exhausted:
        z, more = improve(problem, z, max(node_budget - nodes, node_budget // 4))
        nodes += more
    return TreeOutcome(z, nodes, exhausted, bound, None, names)


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


def prove(problem: CorridorProblem, z: FloatArray, node_budget: int) -> TreeOutcome:
    """Bound eq. (3) of a problem that has a solution, best first; where one tree holds all, improve on it.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    z : (n,) array
        A solution: what costs more need not be searched.
    node_budget : int
        Largest number of QPs of the size of `_USUAL`; of larger ones, which take more steps of more
        work, it buys fewer by the fourth power of their size.
    """
    qp, costs = PivotQp(problem), vehicle_costs(problem, z)
    parts = _parts(problem, qp)
    whole = len(parts) == 1
    trees = []
    for part in parts:
        size = sum(2 * problem.blocks[vehicle].units for vehicle in part)
        budget = max(1, round(node_budget / len(parts) * min(1.0, (_USUAL / size) ** 4)))
        tree = Tree(problem, qp, part, budget, (), most=sum(costs[v] for v in part))
        if whole:
            tree.plunge(binding_choices(problem, z), budget, first_only=True)
        tree.prove(budget)
        trees.append(tree)
    best = trees[0].best if whole else None
    better = None if best is None else problem.least_cubes(qp.z(best))
    exhausted = whole and trees[0].exhausted
    return TreeOutcome(
        better, sum(tree.nodes for tree in trees), exhausted, sum(tree.bound for tree in trees)
    )


def _parts(problem: CorridorProblem, qp: PivotQp) -> list[Group]:
    """The vehicles in groups that a tree can hold, those together that are most in each other's way."""
    everyone = tuple(range(len(problem.blocks)))
    alone = qp.root(everyone, ())
    if len(everyone) <= TOGETHER or alone is None:
        return [frozenset(everyone)]
    table = problem.separations
    slack = table.slack(problem.least_cubes(qp.z(alone))).max(axis=1, initial=-np.inf)
    depth = np.zeros((len(everyone), len(everyone)))
    met = (slack < -CONFLICT_M) & ~table.obstacle
    np.add.at(depth, (table.first[met], table.second[met]), -slack[met])
    of = {vehicle: frozenset([vehicle]) for vehicle in everyone}
    for i, j in sorted(np.argwhere(depth > 0.0).tolist(), key=lambda pair: (-depth[pair[0], pair[1]], pair)):
        union = of[i] | of[j]
        if len(union) <= TOGETHER:
            of |= dict.fromkeys(union, union)
    return list(dict.fromkeys(of.values()))


def _names(problem: CorridorProblem, group: Group) -> tuple[str, ...]:
    return tuple(problem.blocks[vehicle].vehicle_id for vehicle in sorted(group))


def _inherited(solved: dict[Group, Tree], group: Group) -> Choices:
    """Options that the parts of a group had chosen: a first guess of its own."""
    trees = _latest({part: tree for part, tree in solved.items() if part <= group})
    return tuple(choice for tree in trees if tree.best is not None for choice in tree.best.choices)


def _union(qp: PivotQp, problem: CorridorProblem, trees: list[Tree]) -> FloatArray:
    z = np.zeros(problem.size)
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
