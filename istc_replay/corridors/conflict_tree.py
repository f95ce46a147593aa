"""Stage A: pivotal points without conflicts, by a conflict tree over convex QPs.

A node enforces options; its QP bounds everything below it. The tree *plunges*: from the best open
node it follows the best child down to a solution, so that one is found after about as many nodes
as there are conflicts; the open nodes then prove it, or find a better one. Where that does not end
soon, neighbourhoods are searched: one vehicle, then pairs, give up their options and choose anew.
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

    from istc_replay.corridors.problem import CorridorProblem
    from istc_replay.datatypes import FloatArray

#: A conflict smaller than this is closed by rounding, not by branching.
CONFLICT_M = 1e-6
#: A solution must be better by this share to count as one.
_BETTER = 1e-4
#: Cost of a metre of overlap that is left, in the order in which children are followed.
_OVERLAP_COST = 1.0
#: What a second way out is worth where there is none [m].
_NO_WAY_OUT_M = 100.0
#: Share of the budget for the whole tree before neighbourhoods are searched, and theirs each.
_TREE_SHARE = 0.25
_NEIGHBOURHOOD_NODES = {1: 60, 2: 120}


@dataclass(frozen=True, slots=True)
class TreeOutcome:
    """What the tree found: z with least cubes, or None; and how many nodes it took.

    `exhausted` tells that the whole tree was searched: z is the optimum of the pivotal points, or
    where it is None there is none. `last_conflict` is the disjunction that stayed open.
    """

    z: FloatArray | None
    nodes: int
    exhausted: bool
    last_conflict: int | None = None


def search(problem: CorridorProblem, node_budget: int) -> TreeOutcome:
    """Find pivotal points of small eq. (3) without conflict.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    node_budget : int
        Largest number of QPs.
    """
    tree = _Tree(problem, node_budget)
    # Until there is a solution the whole budget may go into finding one.
    exhausted = tree.plunge((), limit=round(_TREE_SHARE * node_budget), solution_first=True)
    if not exhausted and tree.best is not None:
        tree.improve()
    z = None if tree.best is None else tree.best.z
    return TreeOutcome(z, tree.nodes, exhausted, tree.last_conflict)


@dataclass(slots=True)
class _Tree:
    problem: CorridorProblem
    budget: int
    nodes: int = 0
    best: PivotSolution | None = None
    best_choices: Choices = ()
    last_conflict: int | None = None
    _qp: PivotQp = field(init=False)
    _table: OptionTable = field(init=False)

    def __post_init__(self) -> None:
        self._qp = PivotQp(self.problem)
        self._table = OptionTable.of(self.problem)

    @property
    def cutoff(self) -> float:
        """Cost that a node must stay below to be worth anything."""
        return np.inf if self.best is None else self.best.cost * (1.0 - _BETTER)

    def plunge(self, root: Choices, limit: int, *, solution_first: bool = False) -> bool:
        """Search below `root` for `limit` nodes; with `solution_first`, on until there is a solution.

        Returns
        -------
        bool
            Whether nothing below `root` is left to search.
        """
        end = min(self.budget, self.nodes + limit)
        start = self._solve(root, None)
        if start is None or start.cost >= self.cutoff:
            return True
        order = count()
        queue: list[tuple[float, int, Choices, PivotSolution]] = [(start.cost, next(order), root, start)]
        while queue:
            if self.nodes >= (self.budget if solution_first and self.best is None else end):
                return False
            cost, _, choices, node = heapq.heappop(queue)
            if cost >= self.cutoff:
                return True
            for sibling, at in self._dive(choices, node):
                heapq.heappush(queue, (sibling.cost, next(order), at, sibling))
        return True

    def _dive(self, choices: Choices, node: PivotSolution) -> Iterator[tuple[PivotSolution, Choices]]:
        """Follow the best child down to a solution or a dead end; gives the children passed by."""
        while True:
            conflict = self._worst_conflict(node.z)
            if conflict is None:
                self.best, self.best_choices = node, choices
                return
            self.last_conflict = conflict
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

    def improve(self) -> None:
        """Neighbourhoods of the best solution, costliest first, until none gives a better one."""
        for size, nodes in _NEIGHBOURHOOD_NODES.items():
            tried: set[tuple[str, ...]] = set()
            while self.nodes < self.budget:
                group = self._costliest_group(size, tried)
                if group is None:
                    break
                before = self.best
                kept = tuple(c for c in self.best_choices if not self._concerns(c[0], group))
                self.plunge(kept, nodes)
                if self.best is not before:
                    tried = {other for other in tried if not set(other) & set(group)}
                tried.add(group)

    def _costliest_group(self, size: int, tried: set[tuple[str, ...]]) -> tuple[str, ...] | None:
        if self.best is None:
            return None
        z, problem, costs = self.best.z, self.problem, {}
        for block in problem.blocks:
            index = block.pivot[1:].ravel()
            costs[block.vehicle_id] = float(
                problem.quadratic[index] @ (z[index] - problem.reference[index]) ** 2
            )
        groups = [group for group in combinations(costs, size) if group not in tried]
        return max(groups, key=lambda group: sum(costs[vehicle] for vehicle in group), default=None)

    def _concerns(self, disjunction: int, group: tuple[str, ...]) -> bool:
        pair = self.problem.disjunctions[disjunction]
        return pair.first in group or (pair.equation == "eq. (5)" and pair.second in group)

    def _solve(self, choices: Choices, multipliers: FloatArray | None) -> PivotSolution | None:
        self.nodes += 1
        return self._qp.solve(choices, multipliers)

    def _slack(self, z: FloatArray) -> FloatArray:
        return self._table.slack(z)

    def _worst_conflict(self, z: FloatArray) -> int | None:
        """Branch where the overlap is largest and a second way out is far."""
        if not self.problem.disjunctions:
            return None
        ordered = np.sort(self._slack(z), axis=1)[:, ::-1]
        overlap = -ordered[:, 0]
        if overlap.max() <= CONFLICT_M:
            return None
        second = np.where(np.isfinite(ordered[:, 1]), -ordered[:, 1], _NO_WAY_OUT_M)
        return int(np.argmax(np.where(overlap > CONFLICT_M, overlap + second / 2.0, -np.inf)))
