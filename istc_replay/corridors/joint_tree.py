"""The tree of eq. (4): the conflict tree, and below its leaves QPs of pivotal points and cubes together.

A node of the conflict tree bounds eq. (3), and with it eq. (4) by parts. Where its least cubes have no
conflict, the QP of points and cubes with the options chosen so far bounds eq. (4) itself; cubes that meet in
its solution are branched on in the same way. Best first, so that the bound rises as a whole.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from istc_replay.corridors.conflict_tree import TOGETHER, Group, Tree
from istc_replay.corridors.groups import proof_parts
from istc_replay.corridors.neighbourhoods import binding_choices
from istc_replay.corridors.pivot_qp import Choice, Choices, Part, PivotQp, PivotSolution
from istc_replay.corridors.polish import polish, polish_part

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from istc_replay.corridors.problem import CorridorProblem, IntArray
    from istc_replay.datatypes import FloatArray

#: A QP's optimum is taken as a bound less this share.
QP_ROUNDING = 1e-6
#: Cubes that meet by no more than this in a joint solution are not branched on [m].
_MEET_M = 1e-5
#: About what the cubes' sizes gain by moving pivotal points where only a share s of eq. (3) counts,
#: times s. It decides how good a bound is, not whether it is one.
_DRIFT_COST = 0.2
_LEAST_SHARE = 1e-3
#: The search ends at this share of the gap allowed, so that rounding does not decide.
_GAP_SHARE = 0.95
#: Variables of a QP that counts as one: pivotal points of eight vehicles for thirteen units.
USUAL = 208


@dataclass(frozen=True, slots=True)
class JointOutcome:
    """A lower bound of eq. (4), a solution better than the incumbent or None, and how many QPs it took."""

    bound: float
    z: FloatArray | None
    nodes: int
    joint_qps: int


def prove(
    problem: CorridorProblem,
    z: FloatArray,
    tolerance: float,
    node_budget: int,
    joint_budget: int,
    together: int = TOGETHER,
) -> JointOutcome:
    """Bound eq. (4) of a problem that has a solution; where one tree holds all, improve on it.

    Parameters
    ----------
    problem : CorridorProblem
        The window's problem.
    z : (n,) array
        A solution: what costs more need not be searched.
    tolerance : float
        Relative gap at which the search ends.
    node_budget, joint_budget : int
        Largest number of QPs of pivotal points, and of points and cubes, of the size of `USUAL`; of
        larger ones, which take more steps of more work, it buys fewer by the fourth power of their size.
    together : int
        Most vehicles of one tree: a bound of each part bounds the whole.
    """
    qp = PivotQp(problem)
    parts = proof_parts(problem, qp, together)
    slack = _GAP_SHARE * tolerance * max(1.0, abs(problem.objective(z))) / len(parts)
    trees = []
    for part in parts:
        tree = JointTree(problem, qp, part, z, slack)
        size = sum(2 * problem.blocks[vehicle].units for vehicle in part)
        share = min(1.0, (USUAL / size) ** 4) / len(parts)
        if len(parts) == 1 and joint_budget:
            tree.try_options(binding_choices(problem, z))
        tree.run(max(1, round(share * node_budget)), round(share * joint_budget))
        trees.append(tree)
    better = trees[0].z if len(parts) == 1 else None
    bound = sum(tree.bound for tree in trees)
    return JointOutcome(bound, better, sum(t.nodes for t in trees), sum(t.joint_qps for t in trees))


class _Open(NamedTuple):
    """An open node: a lower bound of eq. (4), a number that breaks ties, an option yet to be enforced."""

    bound: float
    order: int
    solution: PivotSolution
    choice: Choice | None


@dataclass(frozen=True, slots=True)
class Relaxed:
    """What is left of eq. (4) without a part of eq. (3), at least, if nobody is in the way of anybody.

    `shares` are those of eq. (3) that count in it, `rests` the optimum of each vehicle with each share.
    """

    shares: tuple[float, ...]
    rests: tuple[Mapping[int, float], ...]

    @classmethod
    def of(cls, problem: CorridorProblem, vehicles: Sequence[int], reference_cost: float) -> Relaxed:
        """Solve the QP without separations with the shares that suit such a value of eq. (3)."""
        drift = float(np.sqrt(_DRIFT_COST / max(reference_cost, _DRIFT_COST)))
        return cls.with_shares(problem, vehicles, {1.0, min(1.0, 3.0 * drift), max(drift, _LEAST_SHARE)})

    @classmethod
    def with_shares(
        cls, problem: CorridorProblem, vehicles: Sequence[int], shares: Iterable[float]
    ) -> Relaxed:
        """Solve the QP without separations with these shares of eq. (3)."""
        found = []
        indices = [problem.indices([vehicle]) for vehicle in vehicles]
        ends = np.cumsum([len(own) for own in indices])
        for share in sorted(shares):
            z = polish_part(problem, vehicles, (), share=share)
            if z is None:
                continue
            rests = {}
            for vehicle, at, own in zip(vehicles, indices, np.split(z, ends[:-1]), strict=True):
                away = float(problem.quadratic[at] @ (own - problem.reference[at]) ** 2)
                rests[vehicle] = _rounded_down(share * away + float(problem.linear[at] @ own))
            found.append((share, rests))
        return cls(tuple(share for share, _ in found), tuple(rests for _, rests in found))

    def rest(self, vehicles: Sequence[int]) -> list[tuple[float, float]]:
        """Each share with what is left of some vehicles' eq. (4)."""
        return [
            (share, sum(rests[v] for v in vehicles))
            for share, rests in zip(self.shares, self.rests, strict=True)
        ]


@dataclass(slots=True)
class JointTree:
    """Search of some vehicles' eq. (4) for what is better than `around` by more than `slack`."""

    problem: CorridorProblem
    qp: PivotQp
    group: Group
    around: FloatArray
    slack: float
    objective: float = field(init=False)  # of the best solution, of these vehicles alone
    z: FloatArray | None = None  # a solution better than `around`
    nodes: int = 0
    joint_qps: int = 0
    relaxed: Relaxed | None = None  # of all vehicles, where it is known
    clear: PivotSolution | None = None  # the cheapest pivotal points without conflict, once they are found
    _indices: IntArray = field(init=False)  # of these vehicles' variables
    _shares: list[tuple[float, float]] = field(init=False)
    _left: float = np.inf  # least bound of what could not be solved
    _queue: list[_Open] = field(default_factory=list)
    _order: count[int] = field(default_factory=count)
    _tree: Tree = field(init=False)
    _joint: dict[Part, FloatArray | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._tree = Tree(self.problem, self.qp, self.group, 0, ())
        self._indices = self.problem.indices(self._members)
        self.objective = self._value(self.around)
        relaxed = self.relaxed or Relaxed.of(self.problem, self._members, self._reference_cost(self.around))
        self._shares = relaxed.rest(self._members)
        root = self.qp.root(self._members, ())
        if root is not None:
            self._push(self._by_parts(root.cost), root, None)

    @property
    def _members(self) -> tuple[int, ...]:
        return tuple(sorted(self.group))

    @property
    def cutoff(self) -> float:
        """Bound from which on a node is worth nothing."""
        return self.objective - self.slack

    @property
    def bound(self) -> float:
        """Lower bound of eq. (4)."""
        open_ = self._queue[0].bound if self._queue else np.inf
        return float(min(self.cutoff, self._left, open_))

    def try_options(self, choices: Choices) -> None:
        """Look for a solution with some options."""
        solution = self.qp.root(self._members, choices)
        z = None if solution is None else self._solved_jointly(solution)
        if z is not None:
            self._offer(polish(self.problem, self.problem.separations.best(z)))

    @property
    def settled(self) -> bool:
        """Whether more nodes cannot raise the bound."""
        return not self._queue or self._queue[0].bound >= min(self.cutoff, self._left)

    def run_to_clear(self, node_budget: int) -> None:
        """Search, best first, up to pivotal points without conflict, for so many QPs of these."""
        end = self.nodes + node_budget
        while not self.settled and self.clear is None and self.nodes < end:
            solution, choice = self._queue[0].solution, self._queue[0].choice
            if choice is None and self._tree.worst_conflict(self._tree.slack(solution)) is None:
                self.clear = solution
            else:
                self._step(heapq.heappop(self._queue))

    def run(self, node_budget: int, joint_budget: int) -> None:
        """Search, best first, for so many QPs of pivotal points and of points and cubes."""
        node_budget, joint_budget = node_budget + self.nodes, joint_budget + self.joint_qps
        whole = len(self.group) == len(self.problem.blocks)
        while self._queue and self._queue[0].bound < self.cutoff:
            if not whole and self.settled:
                return
            if self.nodes >= node_budget or self.joint_qps > joint_budget:
                return
            self._step(heapq.heappop(self._queue))

    def _step(self, node: _Open) -> None:
        """Enforce the option that is due, or branch."""
        if node.choice is None:
            self._branch(node)
            return
        self.nodes += 1
        child = self.qp.with_option(node.solution, node.choice, self._most())
        if child is not None:
            self._push(max(node.bound, self._by_parts(child.cost)), child, None)

    def _branch(self, node: _Open) -> None:
        slack = self._tree.slack(node.solution)
        conflict = self._tree.worst_conflict(slack)
        if conflict is not None:
            for cost, choice in self._tree.priced(node.solution, conflict, slack[conflict]):
                self._push(max(node.bound, self._by_parts(cost)), node.solution, choice)
            return
        z = self._solved_jointly(node.solution)
        if z is None:
            self._left = min(self._left, node.bound)
            return
        bound = max(node.bound, _rounded_down(self._value(z)))
        slack = self._tree.table.slack(z)
        conflict = self._tree.worst_conflict(slack)
        if conflict is None or slack.max(axis=1).min() >= -_MEET_M:
            self._settle(bound, z)
            return
        separation = int(self._tree.own[conflict])
        for option in np.flatnonzero(np.isfinite(slack[conflict])).tolist():
            self._push(bound, node.solution, (separation, option))

    def _settle(self, bound: float, z: FloatArray) -> None:
        """A leaf without conflicts: its solution is the best below it."""
        exact = None
        if len(self.group) == len(self.problem.blocks):
            exact = polish(self.problem, self.problem.separations.best(z))
        self._offer(exact)
        if exact is None or self._value(exact) > bound + 2.0 * QP_ROUNDING * max(1.0, abs(bound)):
            self._left = min(self._left, bound)

    def _offer(self, z: FloatArray | None) -> None:
        if z is not None and self._value(z) < self.objective:
            self.z, self.objective = z, self._value(z)

    def _push(self, bound: float, solution: PivotSolution, choice: Choice | None) -> None:
        if bound < self.cutoff:
            heapq.heappush(self._queue, _Open(bound, next(self._order), solution, choice))

    def _by_parts(self, reference_cost: float) -> float:
        return max(((1.0 - share) * reference_cost + rest for share, rest in self._shares), default=-np.inf)

    def _most(self) -> float:
        """Eq. (3) of whatever is worth anything is at most this."""
        limits = [(self.cutoff - rest) / (1.0 - share) for share, rest in self._shares if share < 1.0]
        return min(limits, default=np.inf)

    def _value(self, z: FloatArray) -> float:
        return self._reference_cost(z) + float(self.problem.linear[self._indices] @ z[self._indices])

    def _reference_cost(self, z: FloatArray) -> float:
        at = self._indices
        return float(self.problem.quadratic[at] @ (z[at] - self.problem.reference[at]) ** 2)

    def _solved_jointly(self, solution: PivotSolution) -> FloatArray | None:
        """Points and cubes of least eq. (4) with the options chosen, by the parts that these tie together."""
        z = np.zeros(self.problem.size)
        for part in solution.parts:
            if part not in self._joint:
                self.joint_qps += 1
                self._joint[part] = polish_part(self.problem, part.members, part.choices)
            found = self._joint[part]
            if found is None:
                return None
            z[self.problem.indices(part.members)] = found
        return z


def _rounded_down(value: float) -> float:
    return value - QP_ROUNDING * max(1.0, abs(value))
