"""Stage A: pivotal points without conflicts, by conflict trees over convex QPs.

*Groups.* Each vehicle is first planned alone among the obstacles; vehicles whose plans conflict are
merged and planned together, until no conflict crosses two groups. Then the union of the groups'
optima is the optimum of all.

*Tree.* A node enforces options; its QP bounds everything below it. The tree plunges: from the best
open node it follows the best child down to a solution, so that one is found after about as many
nodes as there are conflicts; the open nodes then prove it, or find a better one.

*Neighbourhoods.* Where that does not end soon, one vehicle, then pairs, give up their options and
choose anew.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from itertools import combinations, count
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.pivot_qp import Choices, PivotQp, PivotSolution
from istc_replay.corridors.problem import OptionTable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from istc_replay.corridors.problem import CorridorProblem, Disjunction, IntArray
    from istc_replay.datatypes import FloatArray

#: A conflict smaller than this is closed by rounding, not by branching.
CONFLICT_M = 1e-6
#: A solution must be better by this share to count as one.
_BETTER = 1e-4
#: Cost of a metre of overlap that is left, in the order in which children are followed.
_OVERLAP_COST = 1.0
#: What a second way out is worth where there is none [m].
_NO_WAY_OUT_M = 100.0
#: Share of the budget for the whole tree before neighbourhoods are searched, and nodes of each.
_TREE_SHARE = 0.25
_NEIGHBOURHOOD_NODES = {1: 60, 2: 120}

Group = frozenset[str]


@dataclass(frozen=True, slots=True)
class TreeOutcome:
    """What the trees found: z with least cubes, or None; and how many nodes it took.

    `exhausted` tells that everything was searched: z is the optimum of the pivotal points, or
    where it is None there is none. `open_conflict` is the disjunction that stayed open, and
    `groups` the vehicles that had to be planned together.
    """

    z: FloatArray | None
    nodes: int
    exhausted: bool
    open_conflict: Disjunction | None = None
    groups: tuple[tuple[str, ...], ...] = ()


def search(problem: CorridorProblem, node_budget: int) -> TreeOutcome:
    """Find pivotal points of small eq. (3) without conflict.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    node_budget : int
        Largest number of QPs.
    """
    order = [block.vehicle_id for block in problem.blocks]
    solved: dict[Group, _Tree] = {}
    groups = [frozenset([vehicle]) for vehicle in order]
    nodes = 0
    while True:
        for group in groups:
            if group in solved:
                continue
            tree = _Tree(problem, group, node_budget - nodes, _inherited(solved, group))
            tree.run()
            nodes += tree.nodes
            if tree.best is None:
                named = tuple(vehicle for vehicle in order if vehicle in group)
                return TreeOutcome(None, nodes, tree.exhausted, tree.open_conflict, (named,))
            solved[group] = tree
        z = _union(problem, [solved[group] for group in groups])
        merged = _merged(problem, z, groups)
        if len(merged) == len(groups):
            break
        groups = merged
    exhausted = all(solved[group].exhausted for group in groups)
    named_groups = tuple(tuple(v for v in order if v in group) for group in groups)
    return TreeOutcome(problem.least_cubes(z), nodes, exhausted, None, named_groups)


def refine(problem: CorridorProblem, choices: Choices, node_budget: int) -> FloatArray | None:
    """Improve on given options by neighbourhoods; z with least cubes, None where they hold no more."""
    vehicles = frozenset(block.vehicle_id for block in problem.blocks)
    tree = _Tree(problem, vehicles, node_budget, choices)
    tree.run_below_guess()
    return None if tree.best is None else problem.least_cubes(tree.best.z)


def _inherited(solved: dict[Group, _Tree], group: Group) -> Choices:
    """Options that the parts of a group had chosen: a first guess of its own."""
    latest: dict[str, _Tree] = {
        vehicle: tree for part, tree in solved.items() if part <= group for vehicle in part
    }
    trees = {id(tree): tree for tree in latest.values()}
    return tuple(choice for tree in trees.values() for choice in tree.best_choices)


def _union(problem: CorridorProblem, trees: list[_Tree]) -> FloatArray:
    z = np.zeros(problem.size)
    for tree in trees:
        if tree.best is not None:
            z += tree.best.z  # each has its own vehicles' entries alone
    return z


def _merged(problem: CorridorProblem, z: FloatArray, groups: list[Group]) -> list[Group]:
    """Merge groups between which z has a conflict."""
    of = {vehicle: group for group in groups for vehicle in group}
    slack = OptionTable.of(problem.disjunctions).slack(problem.least_cubes(z)).max(axis=1, initial=-np.inf)
    for disjunction, best in zip(problem.disjunctions, slack, strict=True):
        if (
            best < -CONFLICT_M
            and disjunction.second in of
            and of[disjunction.first] != of[disjunction.second]
        ):
            union = of[disjunction.first] | of[disjunction.second]
            of |= dict.fromkeys(union, union)
    return list(dict.fromkeys(of.values()))


@dataclass(slots=True)
class _Tree:
    """The conflict tree of one group."""

    problem: CorridorProblem
    group: Group
    budget: int
    guess: Choices
    nodes: int = 0
    exhausted: bool = False
    best: PivotSolution | None = None
    best_choices: Choices = ()
    open_conflict: Disjunction | None = None
    earliest_first: bool = False
    _qp: PivotQp = field(init=False)
    _unit: IntArray = field(init=False)
    _own: list[int] = field(init=False)
    _table: OptionTable = field(init=False)

    def __post_init__(self) -> None:
        disjunctions = self.problem.disjunctions
        self._own = [
            d
            for d, item in enumerate(disjunctions)
            if item.first in self.group and (item.equation == "eq. (6)" or item.second in self.group)
        ]
        self._qp = PivotQp(self.problem, tuple(self.group))
        self._table = OptionTable.of([disjunctions[d] for d in self._own])
        self._unit = np.array([disjunctions[d].unit for d in self._own], dtype=np.int64)

    def run(self) -> None:
        """Search within the budget: below the guess, the whole tree, then neighbourhoods."""
        share = round(_TREE_SHARE * self.budget)
        if self.guess:
            self.plunge(self.guess, share, first_only=True)
        self.exhausted = self.plunge((), share)
        if self.best is None and not self.exhausted:
            # The largest conflict first leads to better solutions, the earliest to one at all.
            self.earliest_first = True
            self.exhausted = self.plunge((), self.budget, first_only=True)
        if not self.exhausted and self.best is not None:
            self._improve()

    def run_below_guess(self) -> None:
        """Search below the guess alone, then its neighbourhoods."""
        self.plunge(self.guess, round(_TREE_SHARE * self.budget), first_only=True)
        if self.best is not None:
            self._improve()

    @property
    def cutoff(self) -> float:
        """Cost that a node must stay below to be worth anything."""
        return np.inf if self.best is None else self.best.cost * (1.0 - _BETTER)

    def plunge(self, root: Choices, limit: int, *, first_only: bool = False) -> bool:
        """Search below `root` for `limit` nodes; with `first_only` the first solution ends it.

        Returns whether nothing below `root` is left to search.
        """
        end = min(self.budget, self.nodes + limit)
        start = self._solve(root, None)
        if start is None or start.cost >= self.cutoff:
            return True
        order = count()
        queue: list[tuple[float, int, Choices, PivotSolution]] = [(start.cost, next(order), root, start)]
        while queue:
            if self.nodes >= end:
                return False
            cost, _, choices, node = heapq.heappop(queue)
            if cost >= self.cutoff:
                return True
            for sibling, at in self._dive(choices, node):
                heapq.heappush(queue, (sibling.cost, next(order), at, sibling))
            if first_only and self.best is not None:
                return False
        return True

    def _dive(self, choices: Choices, node: PivotSolution) -> Iterator[tuple[PivotSolution, Choices]]:
        """Follow the best child down to a solution or a dead end; gives the children passed by."""
        while True:
            conflict = self._worst_conflict(node.z)
            if conflict is None:
                self.best, self.best_choices = node, choices
                return
            self.open_conflict = self.problem.disjunctions[conflict]
            children = self._children(choices, node, conflict)
            if not children:
                return
            yield from ((child, at) for _, child, at in children[1:])
            if self.nodes >= self.budget:
                yield children[0][1:]
                return
            _, node, choices = children[0]

    def _children(
        self, choices: Choices, node: PivotSolution, conflict: int
    ) -> list[tuple[float, PivotSolution, Choices]]:
        children = []
        for option in range(len(self.problem.disjunctions[conflict].options)):
            at = (*choices, (conflict, option))
            child = self._solve(at, node.multipliers)
            if child is not None and child.cost < self.cutoff:
                overlap = np.maximum(-self._slack(child.z).max(axis=1), 0.0).sum()
                children.append((child.cost + _OVERLAP_COST * float(overlap), child, at))
        children.sort(key=lambda entry: entry[0])
        return children

    def _improve(self) -> None:
        """Neighbourhoods of the best solution, costliest first, until none gives a better one."""
        for size, nodes in _NEIGHBOURHOOD_NODES.items():
            tried: set[Group] = set()
            while self.nodes < self.budget:
                part = self._costliest_part(size, tried)
                if part is None:
                    break
                before = self.best
                for self.earliest_first in (False, True):
                    kept = tuple(c for c in self.best_choices if not self._concerns(c[0], part))
                    self.plunge(kept, nodes)
                if self.best is not before:
                    tried = {other for other in tried if not other & part}
                tried.add(part)

    def _costliest_part(self, size: int, tried: set[Group]) -> Group | None:
        if self.best is None:
            return None
        z, problem, costs = self.best.z, self.problem, {}
        for block in problem.blocks:
            if block.vehicle_id in self.group:
                index = block.pivot[1:].ravel()
                away = z[index] - problem.reference[index]
                costs[block.vehicle_id] = float(problem.quadratic[index] @ away**2)
        parts = [part for part in combinations(costs, size) if frozenset(part) not in tried]
        return max(map(frozenset, parts), key=lambda part: sum(costs[v] for v in part), default=None)

    def _concerns(self, disjunction: int, part: Group) -> bool:
        pair = self.problem.disjunctions[disjunction]
        return pair.first in part or (pair.equation == "eq. (5)" and pair.second in part)

    def _solve(self, choices: Choices, multipliers: FloatArray | None) -> PivotSolution | None:
        self.nodes += 1
        return self._qp.solve(choices, multipliers)

    def _slack(self, z: FloatArray) -> FloatArray:
        return self._table.slack(self.problem.least_cubes(z))

    def _worst_conflict(self, z: FloatArray) -> int | None:
        """Branch where the overlap is largest and a second way out is far, or in the earliest unit."""
        if not self._own:
            return None
        ordered = np.sort(self._slack(z), axis=1)[:, ::-1]
        overlap = -ordered[:, 0]
        if overlap.max() <= CONFLICT_M:
            return None
        second = np.where(np.isfinite(ordered[:, 1]), -ordered[:, 1], _NO_WAY_OUT_M)
        open_ = overlap > CONFLICT_M
        if self.earliest_first:
            open_ &= self._unit == self._unit[open_].min()
        return self._own[int(np.argmax(np.where(open_, overlap + second / 2.0, -np.inf)))]
