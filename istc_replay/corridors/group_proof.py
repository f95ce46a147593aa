"""Bounds of small groups of vehicles, put together to one of all.

A group's bound is that of its own tree of eq. (4): a few vehicles and the obstacles alone. A group grows only
by whom its best plan is in the way of: otherwise their bounds add up already. What the groups prove is packed
(`packing`), and those that matter there grow.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.conflict_tree import CONFLICT_M, Group
from istc_replay.corridors.joint_tree import USUAL, JointTree, Relaxed
from istc_replay.corridors.neighbourhoods import join
from istc_replay.corridors.packing import Packing, pack
from istc_replay.corridors.pivot_qp import PivotQp
from istc_replay.corridors.polish import polish

if TYPE_CHECKING:
    from collections.abc import Iterator

    from istc_replay.corridors.problem import CorridorProblem
    from istc_replay.datatypes import FloatArray

#: Shares of eq. (3) that bounds by parts leave in the rest.
_SHARES = (1.0, 0.2, 0.05, 0.0125, 0.003)
#: A QP takes as long as the fourth power of its size; a small one at least this part of a usual one.
_LEAST_COST = 0.12
#: QPs of pivotal points that a group gets at a time, and a vehicle or pair at once; of points and cubes.
_STEP_NODES, _PAIR_NODES, _STEP_JOINT = 100, 400, 20
#: Vehicles that are in each other's way, directly or not, are one group at once if they are no more.
_AT_ONCE = 4
#: A group of another vehicle is so many times as dear.
_DEARER = 4.0
#: Those who move along when plans are put together have a QP of at most so many usual ones' size.
_JOINING = 1.5
#: Groups of less weight do not matter.
_WEIGHT = 0.02


@dataclass(slots=True)
class GroupProof:
    """Trees of groups of a problem that has a solution z, and what they prove together.

    What is worse than z less `slack` is not searched, nor groups of more vehicles than `together`.
    """

    problem: CorridorProblem
    z: FloatArray
    slack: float
    together: int
    nodes: int = 0
    joint_qps: int = 0
    packing: Packing = field(init=False)
    trees: dict[Group, JointTree] = field(default_factory=dict)
    _qp: PivotQp = field(init=False)
    _relaxed: Relaxed = field(init=False)
    _alone: FloatArray = field(init=False)
    _spent: float = 0.0
    _plans: dict[Group, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._qp = PivotQp(self.problem)
        self._relaxed = Relaxed.with_shares(self.problem, self._everyone, _SHARES)
        for vehicle in self._everyone:
            self._search(frozenset([vehicle]), _PAIR_NODES)
        self._pack()

    @property
    def bound(self) -> float:
        """Lower bound of eq. (4) of all."""
        return float(self._alone.sum()) + self.packing.excess

    def run(self, budget: float) -> None:
        """Bound pairs, then larger groups, for so many QPs of pivotal points of the usual size."""
        for pair in combinations(self._everyone, 2):
            if self._spent < budget and self._in_the_way(frozenset(pair[:1]), frozenset(pair[1:])):
                self._search(frozenset(pair), _PAIR_NODES)
        self._pack()
        tied = [group for group in self._tied() if 2 < len(group) <= min(_AT_ONCE, self.together)]
        for group in tied:
            self._search(group, round(0.5 * budget / len(tied) / self._cost(group)))
            self._pack()
        while self._spent < budget and not self._closed:
            following = self._next()
            if following is None:
                return
            self._search(following, _STEP_NODES)
            self._pack()

    def close(self, joint_budget: int) -> None:
        """Solve the groups that matter with their cubes too, for so many QPs of points and cubes."""
        left = {group for group in self.trees if not self.trees[group].settled}
        while self.joint_qps < joint_budget and not self._closed:
            matter = [group for group in left if self._weight(group) > _WEIGHT]
            if not matter:
                return
            group = max(matter, key=lambda g: (self._weight(g) * len(g), sorted(g)))
            tree = self.trees[group]
            nodes, joint = tree.nodes, tree.joint_qps
            tree.run(_STEP_NODES, _STEP_JOINT)
            self.nodes += tree.nodes - nodes
            self.joint_qps += tree.joint_qps - joint
            # One that came to its nodes' end has more open than cubes.
            if tree.settled or tree.nodes - nodes >= _STEP_NODES or tree.joint_qps == joint:
                left.remove(group)
            self._pack()

    def put_together(self) -> None:
        """Take the plans of the groups that matter; who is still in the way of others then plans anew."""
        z = np.array(self.problem.least_cubes(self.z))
        for group, tree in self.trees.items():
            if tree.clear is not None and self._weight(group) > 1.0 - _WEIGHT:
                self._put(z, group)
        moved = self._least_cover(z)
        joined: FloatArray | None = z
        if moved:
            others = frozenset(self._everyone) - frozenset(moved)
            most = int(_JOINING * USUAL / max(2 * block.units for block in self.problem.blocks))
            joined, nodes, _ = join(self.problem, z, moved, others, max(2, min(self.together, most)))
            self.nodes += nodes
        if joined is None:
            return
        better = polish(self.problem, self.problem.separations.best(joined))
        if better is not None and self.problem.objective(better) < self.problem.objective(self.z):
            self.z = better

    def _least_cover(self, z: FloatArray) -> list[int]:
        """Few vehicles without whom z has no conflict, those with the most conflicts first."""
        table = self.problem.separations
        open_ = table.slack(z).max(axis=1, initial=-np.inf) < -CONFLICT_M
        pairs = [{int(i), int(j)} for i, j in zip(table.first[open_], table.second[open_], strict=True)]
        if table.obstacle[open_].any():
            return []
        cover: list[int] = []
        while pairs:
            most = max(self._everyone, key=lambda vehicle: (sum(vehicle in p for p in pairs), -vehicle))
            cover.append(most)
            pairs = [pair for pair in pairs if most not in pair]
        return cover

    @property
    def _everyone(self) -> range:
        return range(len(self.problem.blocks))

    @property
    def _closed(self) -> bool:
        return self.bound >= self.problem.objective(self.z) - self.slack

    def _weight(self, group: Group) -> float:
        """A group's weight in the packing; of a vehicle alone what others leave."""
        if len(group) > 1:
            return self.packing.weights.get(group, 0.0)
        return 1.0 - sum(weight for other, weight in self.packing.weights.items() if group <= other)

    def _cost(self, group: Group) -> float:
        """About what a QP of a group costs, in QPs of the usual size."""
        size = sum(2 * self.problem.blocks[vehicle].units for vehicle in group)
        return max(_LEAST_COST, (size / USUAL) ** 4)

    def _search(self, group: Group, nodes: int) -> None:
        """Search a group's tree on, up to pivotal points without conflict."""
        if group not in self.trees:
            own = self.slack / len(self._everyone)
            tree = JointTree(self.problem, self._qp, group, self.z, own, relaxed=self._relaxed)
            self.trees[group] = tree
        tree = self.trees[group]
        before = tree.nodes
        tree.run_to_clear(nodes)
        self.nodes += tree.nodes - before
        self._spent += (1 + tree.nodes - before) * self._cost(group)

    def _pack(self) -> None:
        self._alone = np.array([self.trees[frozenset([vehicle])].bound for vehicle in self._everyone])
        excess = {group: self._excess(group) for group in self.trees if len(group) > 1}
        self.packing = pack(excess, len(self._alone))

    def _excess(self, group: Group) -> float:
        return self.trees[group].bound - float(self._alone[sorted(group)].sum())

    def _tied(self) -> list[Group]:
        """The vehicles by who is in whose way, directly or by way of others."""
        of = {vehicle: frozenset([vehicle]) for vehicle in self._everyone}
        for pair in [group for group in self.trees if len(group) == 2]:
            if self._excess(pair) > self.slack / len(self._everyone):
                first, second = pair
                union = of[first] | of[second]
                of |= dict.fromkeys(union, union)
        return list(dict.fromkeys(of.values()))

    def _next(self) -> Group | None:
        """The group to search on, or one grown: where the most is missing to the solution, for its price."""
        own = np.array([self.trees[frozenset([vehicle])].objective for vehicle in self._everyone])
        missing = own - self._alone - self.packing.parts
        best, most = None, 0.0
        for group in [g for g, weight in self.packing.weights.items() if weight > _WEIGHT]:
            for grown, searched in self._grown(group):
                score = float(missing[sorted(grown)].sum()) / ((1.0 + searched) * _DEARER ** len(grown))
                if score > most:
                    best, most = grown, score
        return best

    def _grown(self, group: Group) -> Iterator[tuple[Group, float]]:
        """A group not done yet, and how long it was searched; else with others whom it is in the way of."""
        tree = self.trees[group]
        if tree.clear is None and not tree.settled:
            yield group, tree.nodes / _STEP_NODES
            return
        others = [frozenset([vehicle]) for vehicle in self._everyone if vehicle not in group]
        others += [g for g, weight in self.packing.weights.items() if weight > _WEIGHT and not g <= group]
        for other in others:
            union = group | other
            if len(union) > self.together or union in self.trees:
                continue
            if group & other or self._in_the_way(group, other):
                yield union, 0.0

    def _plan(self, group: Group) -> FloatArray:
        """The group's best plan with least cubes, as far as it is known."""
        if group not in self._plans:
            clear = self.trees[group].clear
            z = self.z if clear is None else self._qp.z(clear)
            if clear is None:
                return self.problem.least_cubes(z)
            self._plans[group] = self.problem.least_cubes(z)
        return self._plans[group]

    def _put(self, z: FloatArray, group: Group) -> None:
        """Write a group's plan into z."""
        plan = self._plan(group)
        for vehicle in group:
            block = self.problem.blocks[vehicle]
            for indices in (block.pivot[1:], block.cube):
                z[indices] = plan[indices]

    def _in_the_way(self, group: Group, other: Group) -> bool:
        """Whether the best plans of two groups have a conflict."""
        table = self.problem.separations
        z = np.array(self._plan(group))
        self._put(z, other)
        sides = [tuple(sorted(vehicles)) for vehicles in (group, other)]
        first, second = ([np.isin(column, side) for side in sides] for column in (table.first, table.second))
        between = ~table.obstacle & ((first[0] & second[1]) | (first[1] & second[0]))
        slack = table.taken(between).slack(z).max(axis=1, initial=-np.inf)
        return bool((slack < -CONFLICT_M).any())
