"""The conflict tree: pivotal points of some vehicles without conflicts, over convex QPs.

A node enforces options; its QP bounds everything below it. First the tree plunges: it follows the best
child down, so that a solution is found after about as many nodes as there are conflicts. Then it is
searched best first, which proves the solution or ends at a better one. A child whose violation alone
makes it dear stays unsolved until its turn comes.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from istc_replay.corridors.pivot_qp import Choice, Choices, PivotQp, PivotSolution

if TYPE_CHECKING:
    from collections.abc import Iterator

    from istc_replay.corridors.option_ends import OptionEnds
    from istc_replay.corridors.problem import CorridorProblem, IntArray, Separations
    from istc_replay.datatypes import FloatArray

#: A conflict smaller than this is closed by rounding, not by branching.
CONFLICT_M = 1e-6
#: A solution must be better by this share to count as one.
BETTER = 1e-4
#: More vehicles than this are too many for one tree.
TOGETHER = 8
#: Cost of a metre of overlap that is left, in the order in which children are followed.
_OVERLAP_COST = 1.0
#: What a second way out is worth where there is none [m].
_NO_WAY_OUT_M = 100.0
#: Shares of the budget for a first solution and for the search best first.
_FIRST_SHARE, _TREE_SHARE = 0.25, 0.6

#: Numbers of vehicles.
Group = frozenset[int]

#: A node passed by: its bound, a solution, and an option yet to be enforced on it.
_Passed = tuple[float, PivotSolution, Choice | None]


class _Open(NamedTuple):
    """An open node: a lower bound, a number that breaks ties, and an option yet to be enforced."""

    bound: float
    order: int
    solution: PivotSolution
    choice: Choice | None


@dataclass(slots=True)
class Tree:
    """The conflict tree of one group; `table` are its separations, `own` their numbers."""

    problem: CorridorProblem
    qp: PivotQp
    group: Group
    budget: int
    guess: Choices
    nodes: int = 0
    exhausted: bool = False
    best: PivotSolution | None = None
    bound: float = 0.0
    open_conflict: int | None = None
    earliest_first: bool = False
    against: Group = frozenset()  # held where they are, and in the way
    most: float = np.inf  # what a solution must cost less than
    _queue: list[_Open] | None = None
    _order: count[int] = field(default_factory=lambda: count(1))
    _members: tuple[int, ...] = field(init=False)
    own: IntArray = field(init=False)
    table: Separations = field(init=False)
    _ends: OptionEnds = field(init=False)
    _prices: list[list[float]] = field(init=False)

    def __post_init__(self) -> None:
        table = self.problem.separations
        self._members = tuple(sorted(self.group))
        known = tuple(self.group | self.against)
        first, second = np.isin(table.first, self._members), np.isin(table.second, self._members)
        mine = (first & (table.obstacle | np.isin(table.second, known))) | (
            second & ~table.obstacle & np.isin(table.first, known)
        )
        self.own = np.flatnonzero(mine)
        self.table = table.taken(self.own)
        self._ends = self.qp.ends.taken(self.own)
        self._prices = self.qp.prices(self.own).tolist()

    def run(self) -> None:
        """Search within the budget: a first solution, the tree best first, then neighbourhoods."""
        share = round(_FIRST_SHARE * self.budget)
        if self.guess:
            self.plunge(self.guess, share, first_only=True)
        if self.best is None:
            self.exhausted = self.plunge((), share, first_only=True)
        if self.best is None and not self.exhausted:
            # The largest conflict first leads to better solutions, the earliest to one at all.
            self.earliest_first = True
            self.exhausted = self.plunge((), self.budget, first_only=True)
            self.earliest_first = False
        if self.best is not None:
            self.prove(min(round(_TREE_SHARE * self.budget), self.budget - self.nodes))

    def search_below_guess(self) -> None:
        """Search below the guess alone, best first and then by plunging."""
        queue = self._begun(self.guess)
        self._best_first(queue, self.nodes + self.budget // 2)
        if self.best is None and queue:
            self._plunge(queue, self.nodes + self.budget // 2, first_only=False)

    def prove(self, limit: int) -> None:
        """Search the tree best first for `limit` more nodes; called again it goes on."""
        queue = self._begun(())
        self._best_first(queue, self.nodes + limit)
        self.exhausted = not queue or queue[0].bound >= self.cutoff
        self.bound = self.cutoff if self.exhausted else queue[0].bound

    def _best_first(self, queue: list[_Open], end: int) -> None:
        while queue and queue[0].bound < self.cutoff and self.nodes < end:
            node = heapq.heappop(queue)
            if node.choice is not None:
                child = self._solve(node.solution, node.choice)
                if child is not None:
                    self._push(queue, child.cost, child, None)
                continue
            slack = self.slack(node.solution)
            conflict = self.worst_conflict(slack)
            if conflict is None:
                self.best = node.solution
                continue
            for bound, choice in self.priced(node.solution, conflict, slack[conflict]):
                if bound < self.cutoff:
                    self._push(queue, bound, node.solution, choice)

    def _begun(self, root: Choices) -> list[_Open]:
        """The open nodes below `root`: itself, or none where it has no solution; of the tree as it stands."""
        if not root and self._queue is not None:
            return self._queue
        self.nodes += 1
        start = self.qp.root(self._members, root, self.cutoff)
        queue = [] if start is None else [_Open(start.cost, 0, start, None)]
        if not root:
            self._queue = queue
        return queue

    def _push(self, queue: list[_Open], bound: float, solution: PivotSolution, choice: Choice | None) -> None:
        heapq.heappush(queue, _Open(bound, next(self._order), solution, choice))

    @property
    def cutoff(self) -> float:
        """Cost that a node must stay below to be worth anything."""
        return self.most if self.best is None else min(self.most, self.best.cost * (1.0 - BETTER))

    def plunge(self, root: Choices, limit: int, *, first_only: bool = False) -> bool:
        """Search below `root` for `limit` nodes; with `first_only` the first solution ends it.

        Returns whether nothing below `root` is left to search.
        """
        return self._plunge(self._begun(root), min(self.budget, self.nodes + limit), first_only=first_only)

    def _plunge(self, queue: list[_Open], end: int, *, first_only: bool) -> bool:
        while queue and queue[0].bound < self.cutoff:
            if self.nodes >= end or (first_only and self.best is not None):
                return False
            for passed in self._expanded(heapq.heappop(queue)):
                self._push(queue, *passed)
        return True

    def _expanded(self, node: _Open) -> Iterator[_Passed]:
        """Enforce the option that is due, or follow the best child down; gives what stays open."""
        if node.choice is None:
            yield from self._dive(node.solution)
            return
        child = self._solve(node.solution, node.choice)
        if child is not None:
            yield child.cost, child, None

    def _dive(self, node: PivotSolution) -> Iterator[_Passed]:
        """Follow the best child down to a solution or a dead end; gives the children passed by."""
        while True:
            slack = self.slack(node)
            conflict = self.worst_conflict(slack)
            if conflict is None:
                self.best = node
                return
            self.open_conflict = int(self.own[conflict])
            child, passed = self._children(node, conflict, slack[conflict])
            yield from passed
            if child is None:
                return
            if self.nodes >= self.budget:
                yield child.cost, child, None
                return
            node = child

    def _children(
        self, node: PivotSolution, conflict: int, slack: FloatArray
    ) -> tuple[PivotSolution | None, list[_Passed]]:
        """Give the best child of a conflict, and the others: those that cannot be better unsolved."""
        best: PivotSolution | None = None
        least = math.inf
        passed: list[_Passed] = []
        for bound, choice in self.priced(node, conflict, slack):
            if bound >= min(least, self.cutoff):
                passed.append((bound, node, choice))
                continue
            child = self._solve(node, choice)
            if child is None:
                continue
            overlap = np.maximum(-self.slack(child).max(axis=1), 0.0).sum()
            score = child.cost + _OVERLAP_COST * float(overlap)
            if score < least:
                if best is not None:
                    passed.append((best.cost, best, None))
                best, least = child, score
            else:
                passed.append((child.cost, child, None))
        return best, passed

    def priced(self, node: PivotSolution, conflict: int, slack: FloatArray) -> list[tuple[float, Choice]]:
        """The options of a group's conflict with lower bounds of their cost, cheapest first."""
        separation = int(self.own[conflict])
        missed = zip(self._prices[conflict], slack.tolist(), strict=True)
        return sorted(
            (node.cost + price * missed_m**2, (separation, option))
            for option, (price, missed_m) in enumerate(missed)
            if math.isfinite(missed_m)
        )

    def _solve(self, node: PivotSolution, choice: Choice) -> PivotSolution | None:
        """Solve with one more option; None where that is infeasible or not worth anything."""
        self.nodes += 1
        child = self.qp.with_option(node, choice, self.cutoff)
        return None if child is None or child.cost >= self.cutoff else child

    def slack(self, node: PivotSolution) -> FloatArray:
        """How far the options of the group's separations hold (D, 4) with least cubes."""
        return self._ends.slack(self.qp.points(node))

    def worst_conflict(self, slack: FloatArray) -> int | None:
        """Branch where the overlap is largest and a second way out is far, or in the earliest unit."""
        if not len(slack):
            return None
        open_ = np.flatnonzero(slack.max(axis=1) < -CONFLICT_M)
        if not len(open_):
            return None
        if self.earliest_first:
            unit = self.table.unit[open_]
            open_ = open_[unit == unit.min()]
        ordered = np.sort(slack[open_], axis=1)
        overlap, second = -ordered[:, 3], -ordered[:, 2]
        second = np.where(np.isfinite(second), second, _NO_WAY_OUT_M)
        return int(open_[np.argmax(overlap + second / 2.0)])
