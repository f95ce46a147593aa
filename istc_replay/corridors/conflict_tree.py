"""Stage A: pivotal points without conflicts, by conflict trees over convex QPs.

*Groups.* Each vehicle is first planned alone among the obstacles; vehicles whose plans conflict are
merged and planned together, until no conflict crosses two groups. Then the union of the groups'
optima is the optimum of all.

*Tree.* A node enforces options; its QP bounds everything below it. First the tree plunges: it follows
the best child down, so that a solution is found after about as many nodes as there are conflicts.
Then it is searched best first, which proves the solution or ends at a better one. A child whose
violation alone makes it dear stays unsolved until its turn comes.

*Neighbourhoods.* Where that does not end soon, one to three vehicles that meet are planned anew, while
all others stay where they are.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from istc_replay.corridors.pivot_qp import Choice, Choices, PivotQp, PivotSolution
from istc_replay.corridors.polish import polish

if TYPE_CHECKING:
    from collections.abc import Iterator

    from istc_replay.corridors.problem import CorridorProblem, IntArray, Separations
    from istc_replay.datatypes import FloatArray

#: A conflict smaller than this is closed by rounding, not by branching.
CONFLICT_M = 1e-6
#: A solution must be better by this share to count as one.
_BETTER = 1e-4
#: Cost of a metre of overlap that is left, in the order in which children are followed.
_OVERLAP_COST = 1.0
#: Least cubes of vehicles that meet are nearer than this at some time [m].
_NEAR_M = 1.0
#: What a second way out is worth where there is none [m].
_NO_WAY_OUT_M = 100.0
#: Shares of the budget for a first solution and for the search best first, which costs too much to be
#: worth it where more vehicles are planned together.
_FIRST_SHARE, _TREE_SHARE = 0.25, 0.6
_TOGETHER = 8
#: Nodes of a neighbourhood by its size; sweeps over all of them, while one gains this share.
_NEIGHBOURHOOD_NODES = {1: 60, 2: 120}
_SWEEPS, _WORTH_A_SWEEP = 4, 0.005

#: Numbers of vehicles.
Group = frozenset[int]

#: A node passed by: its bound, a solution, and an option yet to be enforced on it.
_Passed = tuple[float, PivotSolution, Choice | None]


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


class _Open(NamedTuple):
    """An open node: a lower bound, a number that breaks ties, and an option yet to be enforced."""

    bound: float
    order: int
    solution: PivotSolution
    choice: Choice | None


def search(problem: CorridorProblem, node_budget: int, proof_budget: int = 0) -> TreeOutcome:
    """Find pivotal points of small eq. (3) without conflict.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    node_budget : int
        Largest number of QPs to find them.
    proof_budget : int
        Largest number of QPs beyond that to prove them optimal.
    """
    qp = PivotQp(problem)
    solved: dict[Group, _Tree] = {}
    groups = [frozenset([vehicle]) for vehicle in range(len(problem.blocks))]
    nodes = 0
    while True:
        for group in groups:
            if group in solved:
                continue
            tree = _Tree(problem, qp, group, node_budget - nodes, _inherited(solved, group))
            tree.run()
            tree.prove(proof_budget)
            nodes += tree.nodes
            if tree.best is None:
                failed = (_names(problem, group),)
                return TreeOutcome(None, nodes, tree.exhausted, 0.0, tree.open_conflict, failed)
            solved[group] = tree
        z = _union(qp, problem, [solved[group] for group in groups])
        merged = _merged(problem, z, groups)
        if len(merged) == len(groups):
            break
        groups = merged
    trees = [solved[group] for group in groups]
    exhausted = all(tree.exhausted for tree in trees)
    z = problem.least_cubes(z)
    if not exhausted:
        z, more = improve(problem, z, node_budget - nodes)
        nodes += more
    return TreeOutcome(
        z,
        nodes,
        exhausted,
        sum(tree.bound for tree in trees),
        None,
        tuple(_names(problem, group) for group in groups),
    )


def improve(problem: CorridorProblem, z: FloatArray, node_budget: int) -> tuple[FloatArray, int]:
    """Plan few vehicles anew beside all others, costliest first, until none gives a better solution.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    z : (n,) array
        A solution.
    node_budget : int
        Largest number of QPs.

    Returns
    -------
    tuple
        A solution with least cubes, no worse, and the number of QPs.
    """
    qp, nodes = PivotQp(problem), 0
    for _ in range(_SWEEPS):
        before = problem.reference_cost(z)
        for size in _NEIGHBOURHOOD_NODES:
            z, more = _sweep(problem, qp, z, size, node_budget - nodes)
            nodes += more
        settled = polish(problem, problem.separations.best(z))
        if settled is not None and problem.reference_cost(settled) < problem.reference_cost(z):
            z = problem.least_cubes(settled)
        if nodes >= node_budget or problem.reference_cost(z) > (1.0 - _WORTH_A_SWEEP) * before:
            break
    return z, nodes


def _sweep(
    problem: CorridorProblem, qp: PivotQp, z: FloatArray, size: int, node_budget: int
) -> tuple[FloatArray, int]:
    """Neighbourhoods of one size."""
    tried: set[Group] = set()
    nodes, limit = 0, _NEIGHBOURHOOD_NODES[size]
    while nodes < node_budget:
        costs = _costs(problem, z)
        part = _costliest_part(problem, z, costs, size, tried)
        if part is None:
            break
        moving = _moving(part, costs, _meetings(problem, z))
        kept = _kept(problem, z, part, moving)
        view = qp.beside(z, tuple(sorted(moving)))
        most = sum(costs[v] for v in moving) * (1.0 - _BETTER)
        tree = _Tree(problem, view, moving, limit, kept, beside=True, most=most)
        tree.search_below_guess()
        nodes += tree.nodes
        if tree.best is not None:
            z = problem.least_cubes(view.z(tree.best))
            tried = {other for other in tried if not other & part}
        tried.add(part)
    return z, nodes


def _costs(problem: CorridorProblem, z: FloatArray) -> list[float]:
    """Eq. (3) of each vehicle."""
    away = problem.quadratic * (z - problem.reference) ** 2
    return [float(away[block.pivot[1:]].sum()) for block in problem.blocks]


def _meetings(problem: CorridorProblem, z: FloatArray) -> set[tuple[int, int]]:
    """Pairs of vehicles whose least cubes are near each other at some time."""
    table = problem.separations
    near = ~table.obstacle & (table.slack(z).max(axis=1, initial=-np.inf) < _NEAR_M)
    return set(zip(table.first[near].tolist(), table.second[near].tolist(), strict=True))


def _costliest_part(
    problem: CorridorProblem, z: FloatArray, costs: list[float], size: int, tried: set[Group]
) -> Group | None:
    """The costliest vehicle, or two that meet, that were not tried yet."""
    parts = {frozenset([v]) for v in range(len(costs)) if costs[v] > _BETTER}
    if size > 1:
        parts = {frozenset(pair) for pair in _meetings(problem, z)}
    left = sorted(parts - tried, key=sorted)
    return max(left, key=lambda part: sum(costs[v] for v in part), default=None)


def _moving(part: Group, costs: list[float], meetings: set[tuple[int, int]]) -> Group:
    """The part and whom it meets, and whom they meet, the costliest first, as many as can be afforded."""
    moving = set(part)
    for _ in range(2):
        met = {w for pair in meetings if moving & set(pair) for w in pair} - moving
        moving |= set(sorted(met, key=lambda v: (-costs[v], v))[: _TOGETHER - len(moving)])
    return frozenset(moving)


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


def prove(problem: CorridorProblem, choices: Choices, node_budget: int) -> TreeOutcome:
    """Bound eq. (3) of a problem that has a solution by these options, best first; it may be improved on."""
    qp = PivotQp(problem)
    tree = _Tree(problem, qp, frozenset(range(len(problem.blocks))), node_budget, choices)
    tree.plunge(choices, node_budget, first_only=True)
    tree.prove(node_budget)
    z = None if tree.best is None else problem.least_cubes(qp.z(tree.best))
    return TreeOutcome(z, tree.nodes, tree.exhausted, tree.bound)


def _names(problem: CorridorProblem, group: Group) -> tuple[str, ...]:
    return tuple(problem.blocks[vehicle].vehicle_id for vehicle in sorted(group))


def _inherited(solved: dict[Group, _Tree], group: Group) -> Choices:
    """Options that the parts of a group had chosen: a first guess of its own."""
    latest: dict[int, _Tree] = {
        vehicle: tree for part, tree in solved.items() if part <= group for vehicle in part
    }
    trees = {id(tree): tree for tree in latest.values()}
    return tuple(choice for tree in trees.values() if tree.best is not None for choice in tree.best.choices)


def _union(qp: PivotQp, problem: CorridorProblem, trees: list[_Tree]) -> FloatArray:
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


@dataclass(slots=True)
class _Tree:
    """The conflict tree of one group."""

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
    beside: bool = False  # all others are held where they are
    most: float = np.inf  # what a solution must cost less than
    _queue: list[_Open] | None = None
    _order: count[int] = field(default_factory=lambda: count(1))
    _members: tuple[int, ...] = field(init=False)
    _own: IntArray = field(init=False)
    _table: Separations = field(init=False)

    def __post_init__(self) -> None:
        table = self.problem.separations
        self._members = tuple(sorted(self.group))
        first = np.isin(table.first, self._members)
        second = np.isin(table.second, self._members) & ~table.obstacle
        # Those who are held stay in the way.
        self._own = np.flatnonzero(first | second if self.beside else first & (table.obstacle | second))
        self._table = table.taken(self._own)

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
            affordable = _TREE_SHARE * self.budget if len(self.group) <= _TOGETHER else 0.0
            self.prove(min(round(affordable), self.budget - self.nodes))

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
            slack = self._slack(node.solution)
            conflict = self._worst_conflict(slack)
            if conflict is None:
                self.best = node.solution
                continue
            for bound, choice in self._priced(node.solution, conflict, slack[conflict]):
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
        return self.most if self.best is None else min(self.most, self.best.cost * (1.0 - _BETTER))

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
            slack = self._slack(node)
            conflict = self._worst_conflict(slack)
            if conflict is None:
                self.best = node
                return
            self.open_conflict = int(self._own[conflict])
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
        least = np.inf
        passed: list[_Passed] = []
        for bound, choice in self._priced(node, conflict, slack):
            if bound >= min(least, self.cutoff):
                passed.append((bound, node, choice))
                continue
            child = self._solve(node, choice)
            if child is None:
                continue
            overlap = np.maximum(-self._slack(child).max(axis=1), 0.0).sum()
            score = child.cost + _OVERLAP_COST * float(overlap)
            if score < least:
                if best is not None:
                    passed.append((best.cost, best, None))
                best, least = child, score
            else:
                passed.append((child.cost, child, None))
        return best, passed

    def _priced(self, node: PivotSolution, conflict: int, slack: FloatArray) -> list[tuple[float, Choice]]:
        """The options of a group's conflict with lower bounds of their cost, cheapest first."""
        separation = int(self._own[conflict])
        return sorted(
            (node.cost + self.qp.price(separation, o) * float(slack[o]) ** 2, (separation, o))
            for o in range(4)
            if np.isfinite(slack[o])
        )

    def _solve(self, node: PivotSolution, choice: Choice) -> PivotSolution | None:
        """Solve with one more option; None where that is infeasible or not worth anything."""
        self.nodes += 1
        child = self.qp.with_option(node, choice, self.cutoff)
        return None if child is None or child.cost >= self.cutoff else child

    def _slack(self, node: PivotSolution) -> FloatArray:
        """How far the options of the group's separations hold (D, 4)."""
        return self._table.slack(self.problem.least_cubes(self.qp.z(node)))

    def _worst_conflict(self, slack: FloatArray) -> int | None:
        """Branch where the overlap is largest and a second way out is far, or in the earliest unit."""
        if not len(slack):
            return None
        ordered = np.sort(slack, axis=1)[:, ::-1]
        overlap = -ordered[:, 0]
        if overlap.max() <= CONFLICT_M:
            return None
        second = np.where(np.isfinite(ordered[:, 1]), -ordered[:, 1], _NO_WAY_OUT_M)
        open_ = overlap > CONFLICT_M
        if self.earliest_first:
            open_ &= self._table.unit == self._table.unit[open_].min()
        return int(np.argmax(np.where(open_, overlap + second / 2.0, -np.inf)))
