"""The stages that find corridors: conflict tree, cube sizes, joint polish, frames about the plan."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors import cbc, groups, neighbourhoods
from istc_replay.corridors.cube_sizes import size_problem
from istc_replay.corridors.polish import FEASIBLE_M, polish_about
from istc_replay.corridors.relinearise import frames_about, with_references
from istc_replay.datatypes import FloatArray, SolveRecord, SolveStatus, read_only

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from istc_replay.config import CorridorsConfig
    from istc_replay.corridors.groups import TreeOutcome
    from istc_replay.corridors.problem import CorridorProblem, IntArray
    from istc_replay.datatypes import Conflict, Guidance

#: Frames are written anew while that makes the objective better by this share.
_WORTH = 0.02
#: Who ends nearer to its guidance than this has not given way for good [m].
_BEHIND_M = 1.0
_MUCH = 0.1
#: Who steps less in the last unit of its guidance stops there; how near is at the goal, and near it [m].
_STANDING_M, _AT_GOAL_M, _NEAR_GOAL_M = 0.05, 0.3, 3.0


@dataclass(slots=True)
class Search:
    """The incumbent and the bound while the stages run.

    `reference_bound` is a lower bound of eq. (3) alone, for `problem` as it is.
    """

    problem: CorridorProblem
    z: FloatArray | None = None
    objective: float = np.inf
    bound: float = -np.inf
    reference_bound: float = 0.0
    found_by: str = ""
    exhausted: bool = False  # the conflict tree saw everything there is
    records: list[SolveRecord] = field(default_factory=list)
    culprits: tuple[tuple[str, ...], ...] = ()
    conflicts: tuple[Conflict, ...] = ()
    note: str = ""  # how the incumbent was found, where that is out of the ordinary
    frames: tuple[Guidance, ...] = ()  # that `problem` is written about, where they are not the guidance

    def offer(self, z: FloatArray | None, stage: str) -> bool:
        """Take z as the incumbent if it is better."""
        if z is None:
            return False
        objective = self.problem.objective(z)
        if objective >= self.objective:
            return False
        self.z, self.objective, self.found_by = z, objective, stage
        return True

    @property
    def gap(self) -> float | None:
        """(objective - bound) / max(1, |objective|)."""
        if self.z is None or not np.isfinite(self.bound):
            return None
        return gap_between(self.objective, self.bound)

    def closed(self, tolerance: float) -> bool:
        """Whether the incumbent is proven to be the optimum within a relative gap."""
        gap = self.gap
        return gap is not None and gap <= tolerance

    def record(self, stage: str, solver: str, status: SolveStatus, began: float, **figures: object) -> None:
        """Note one solver call of layer 1: what it found, and the bound and gap as they stand."""
        standing = {"bound": self.bound if np.isfinite(self.bound) else None, "gap": self.gap}
        self.records.append(
            replace(
                SolveRecord("corridors", stage, solver, status, wall_s=time.perf_counter() - began),
                **(standing | figures),  # type: ignore[arg-type]
            )
        )


def gap_between(objective: float, bound: float) -> float:
    """(objective - bound) / max(1, |objective|)."""
    return max(0.0, objective - bound) / max(1.0, abs(objective))


def grow_tree(search: Search, config: CorridorsConfig, *, first_try: bool = False) -> TreeOutcome:
    """Stage A: pivotal points without conflict; in a `first_try` within a smaller budget, or not at all."""
    began = time.perf_counter()
    problem = search.problem
    budget = config.small_crowd_node_budget if first_try else config.tree_node_budget
    tree = groups.search(problem, budget, config.group_vehicles_max, in_turn=not first_try)
    search.exhausted, search.reference_bound = tree.exhausted, tree.bound
    search.offer(tree.z, "conflict tree")
    status = SolveStatus.FEASIBLE
    if tree.z is None:
        status = SolveStatus.INFEASIBLE if tree.exhausted else SolveStatus.LIMIT
        search.culprits = tree.culprits
    objective = None if tree.z is None else problem.objective(tree.z)
    if tree.in_turn:
        search.note = f"too many to plan at once, planned one after the other: {', '.join(tree.in_turn)}"
    figures = {"nodes": tree.nodes, "objective": objective, "detail": search.note}
    search.record("conflict tree", "daqp", status, began, **figures)
    return tree


def fill(search: Search, z: FloatArray, config: CorridorsConfig, *, sized: bool) -> None:
    """Stages B (where `sized`) and C: the options of the largest cubes about z, then both moved together."""
    problem = search.problem
    choice = problem.separations.best(z)
    if sized and len(problem.separations):
        choice = _size_cubes(search, z, config)
    began = time.perf_counter()
    polished = polish_about(problem, z, choice)
    search.offer(polished, "joint polish")
    search.record(
        "joint polish",
        "piqp",
        SolveStatus.FEASIBLE if polished is not None else SolveStatus.ERROR,
        began,
        objective=None if polished is None else problem.objective(polished),
    )


def _size_cubes(search: Search, z: FloatArray, config: CorridorsConfig) -> IntArray:
    """Stage B: the options (D,) of the largest cubes around fixed pivotal points, by small LPs or a MILP."""
    began = time.perf_counter()
    sizes = size_problem(search.problem, z)
    sizes.settle_small()
    if not len(sizes.open):
        search.record("cube sizes", "daqp", SolveStatus.OPTIMAL, began)
        return sizes.choice
    model = sizes.milp()
    run = cbc.solve(
        model, gap=0.0, node_budget=config.milp_node_budget, emergency_stop_s=config.emergency_stop_s
    )
    if run.status in (SolveStatus.OPTIMAL, SolveStatus.FEASIBLE):
        sizes.settle(model)
    search.record(
        "cube sizes",
        "cbc",
        run.status,
        began,
        nodes=run.nodes,
        iterations=run.iterations,
        binaries=len(model.delta),
        detail=run.detail,
    )
    return sizes.choice


def gives_way(search: Search, part: Sequence[int] | None = None) -> bool:
    """Whether someone is not back at its guidance in the end: its frames are then those of elsewhere."""
    if search.z is None:
        return False
    for number in range(len(search.problem.blocks)) if part is None else part:
        block = search.problem.blocks[number]
        away = search.z[block.pivot[-1]] - block.reference_m[-1]
        if float(np.hypot(*away)) > _BEHIND_M:
            return True
    return False


def follow(
    search: Search,
    guidance: Sequence[Guidance],
    rewritten: Callable[[Sequence[Guidance]], CorridorProblem],
    config: CorridorsConfig,
    *,
    searched: bool = True,
) -> None:
    """Write the frames anew about the incumbent and solve again, while that makes it better.

    Parts of the window that never meet are judged each for itself. Other choices are `searched` for only
    where the frames made a difference.
    """
    parts = search.problem.parts
    if searched and search.exhausted:
        parts = tuple(part for part in parts if gives_way(search, part))
    for round_ in range(1, config.frame_rounds + 1):
        if search.z is None or not parts:
            return
        began = time.perf_counter()
        found = _followed(search, parts, guidance, rewritten, config, searched=searched)
        search.record(
            f"frames about the plan {round_}",
            "daqp, piqp",
            SolveStatus.FEASIBLE if found is not None else SolveStatus.INFEASIBLE,
            began,
            objective=None if found is None else found.problem.objective(found.z),
        )
        if found is None or not found.parts:
            return
        search.problem, search.reference_bound, search.exhausted = found.problem, 0.0, False
        search.frames, parts = found.frames, found.parts
        search.offer(found.z, f"frames about the plan, round {round_}")


@dataclass(frozen=True, slots=True, eq=False)
class _Followed:
    """A solution about other frames, and the parts of the window that it makes better."""

    problem: CorridorProblem
    frames: tuple[Guidance, ...]
    z: FloatArray
    parts: tuple[tuple[int, ...], ...]


def _followed(
    search: Search,
    parts: Sequence[tuple[int, ...]],
    guidance: Sequence[Guidance],
    rewritten: Callable[[Sequence[Guidance]], CorridorProblem],
    config: CorridorsConfig,
    *,
    searched: bool,
) -> _Followed | None:
    """Frames of some parts about the incumbent; None where there is no solution about them."""
    before, old = search.frames or tuple(guidance), search.z
    if old is None:
        return None
    frames = _mixed(before, frames_about(search.problem, old, before), parts)
    problem = with_references(rewritten(frames), guidance)
    polished = None if len(problem.impossible) or cramped(problem) else polish_about(problem, old)
    if polished is None:
        return None
    costs = {part: search.problem.part_objective(old, part) for part in parts}

    def better(z: FloatArray, share: float) -> list[tuple[int, ...]]:
        return [p for p in parts if problem.part_objective(z, p) < costs[p] - share * abs(costs[p])]

    z, much = polished, better(polished, _MUCH) if searched else []
    if much:
        refined, _ = neighbourhoods.improve(problem, problem.least_cubes(z), config.tree_node_budget // 4)
        again = polish_about(problem, refined)
        if again is not None:
            gain = [p for p in much if problem.part_objective(again, p) < problem.part_objective(z, p)]
            z = _joined(problem, z, again, gain)
    gained = better(z, _WORTH)
    if len(gained) < len(search.problem.parts):  # the others stay as they were, frames and all
        frames = _mixed(before, frames, gained)
        problem = with_references(rewritten(frames), guidance)
        z = _joined(problem, old, z, gained)
        if (problem.separations.slack(z).max(axis=1, initial=-np.inf) < -FEASIBLE_M).any():
            return None
    return _Followed(problem, frames, z, tuple(gained))


def _mixed(
    old: Sequence[Guidance], new: Sequence[Guidance], parts: Sequence[tuple[int, ...]]
) -> tuple[Guidance, ...]:
    """The new frames of some parts, the old ones of all others."""
    chosen = {number for part in parts for number in part}
    return tuple(new[row] if row in chosen else old[row] for row in range(len(old)))


def _joined(
    problem: CorridorProblem, old: FloatArray, new: FloatArray, parts: Sequence[tuple[int, ...]]
) -> FloatArray:
    """The new solution of some parts, the old one of all others."""
    z = np.array(old)
    for part in parts:
        own = problem.indices(part)
        z[own] = new[own]
    return z


def bring_home(search: Search, guidance: Sequence[Guidance]) -> None:
    """Hold the last pivotal points of who stops near its goal at the goal, where all choices allow it.

    Parts of the window that never meet are judged each for itself.
    """
    for part in search.problem.parts:
        near = [vehicle for vehicle in part if _stops_near(search, guidance, vehicle)]
        if search.z is None or not near:
            continue
        began = time.perf_counter()
        home = _at_goals(search.problem, guidance, near)
        found = None if cramped(home) else polish_about(home, search.z)
        if found is not None:
            z = _joined(home, search.z, found, [part])
            search.problem, search.z, search.objective = home, z, home.objective(z)
            search.found_by, search.exhausted = "goals held", False
        search.record(
            "goals held",
            "piqp",
            SolveStatus.INFEASIBLE if found is None else SolveStatus.FEASIBLE,
            began,
            objective=None if found is None else search.objective,
        )


def _stops_near(search: Search, guidance: Sequence[Guidance], vehicle: int) -> bool:
    """Whether a vehicle whose guidance stops at a goal ends beside it, and not far away."""
    points = guidance[vehicle].points_m
    if search.z is None or np.hypot(*(points[-1] - points[-2])) > _STANDING_M:
        return False
    away = np.hypot(*(search.z[search.problem.blocks[vehicle].pivot[-1]] - points[-1]))
    return bool(_AT_GOAL_M < away < _NEAR_GOAL_M)


def _at_goals(
    problem: CorridorProblem, guidance: Sequence[Guidance], vehicles: Sequence[int]
) -> CorridorProblem:
    """The problem with the last pivotal points of some vehicles at their goals."""
    lower, upper = np.array(problem.lower), np.array(problem.upper)
    for vehicle in vehicles:
        last, goal = problem.blocks[vehicle].pivot[-1], guidance[vehicle].points_m[-1]
        lower[last] = np.maximum(lower[last], goal - _AT_GOAL_M)
        upper[last] = np.minimum(upper[last], goal + _AT_GOAL_M)
    return replace(problem, lower=read_only(lower), upper=read_only(upper))


def cramped(problem: CorridorProblem) -> list[tuple[str, int]]:
    """Vehicles whose bounds contradict each other, and the first unit in which they do."""
    found = []
    for block in problem.blocks:
        for k in range(block.units):
            walls = np.concatenate([block.cube[k], block.pivot[k + 1]])
            if np.any(problem.lower[walls] > problem.upper[walls] + 1e-9):
                found.append((block.vehicle_id, block.first_unit + k))
                break
    return found
