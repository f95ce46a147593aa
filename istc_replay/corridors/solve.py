"""Solving layer 1: the stages, their budgets, and what each found."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors import cbc, conflict_tree
from istc_replay.corridors.formulation import build_problem
from istc_replay.corridors.miqp import MilpModel, build_milp, build_size_milp
from istc_replay.corridors.paper import PAPER_BIG_M, build_paper_problem
from istc_replay.corridors.polish import polish
from istc_replay.corridors.relinearise import frames_about, with_references
from istc_replay.datatypes import Corridors, FloatArray, SolveRecord, SolveStatus

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from istc_replay.config import CorridorsConfig
    from istc_replay.corridors.problem import CorridorProblem, Limits
    from istc_replay.datatypes import Guidance, Scenario

#: Where the first tangents touch, from the incumbent [m]. Wide seeds close the gap in one round
#: where close ones alone need three or more (docs/performance.md).
_SEEDS_M = (-4.0, -2.0, -1.0, -0.3, 0.3, 1.0, 2.0, 4.0)
#: CBC may leave this share of the wanted gap open in each round.
_GAP_SHARE = 0.25
#: Frames are written anew while that makes the objective better by this share.
_WORTH = 0.02
_MUCH = 0.1
#: A QP's optimum is taken as a bound less this share.
_QP_ROUNDING = 1e-6


@dataclass(slots=True)
class _Search:
    """The incumbent and the bound while the stages run."""

    problem: CorridorProblem
    z: FloatArray | None = None
    objective: float = np.inf
    bound: float = -np.inf
    found_by: str = ""
    exhausted: bool = False  # stage A saw everything there is
    records: list[SolveRecord] = field(default_factory=list)
    culprits: tuple[tuple[str, ...], ...] = ()

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
        return max(0.0, self.objective - self.bound) / max(1.0, abs(self.objective))

    def record(self, stage: str, solver: str, status: SolveStatus, began: float, **figures: object) -> None:
        """Note one solver call of layer 1."""
        self.records.append(
            replace(
                SolveRecord("corridors", stage, solver, status, wall_s=time.perf_counter() - began),
                **figures,  # type: ignore[arg-type]
            )
        )


def solve_corridors(
    scenario: Scenario,
    guidance: Sequence[Guidance],
    config: CorridorsConfig,
    limits: Mapping[str, Limits],
    speed_max_mps: float,
) -> Corridors:
    """Construct the interactive spatio-temporal corridors of a window, eq. (4).

    Every outcome is returned, none is raised, save a missing or dying solver (SolveError).
    """
    paper = config.formulation == "paper"
    build = build_paper_problem if paper else build_problem
    problem = build(scenario, guidance, config, limits, speed_max_mps)
    impossible = problem.impossible.tolist()
    if impossible:
        reason = _conflict_text(problem, impossible[0])
        pairs = tuple(dict.fromkeys(map(problem.pair, impossible)))
        return Corridors(SolveStatus.INFEASIBLE, reason=reason, culprits=pairs)
    cramped = _cramped(problem)
    if cramped:
        reason, vehicles = _bounds_text(cramped), tuple((vehicle,) for vehicle, _ in cramped)
        return Corridors(SolveStatus.INFEASIBLE, reason=reason, culprits=vehicles)
    search = _Search(problem)
    if not paper:
        proven = _incumbent(search, config, sized=not _large_traffic(scenario, problem, config))
        if proven is not None:
            return replace(proven, records=tuple(search.records))
        if search.z is not None and not search.exhausted and not scenario.traffic:

            def rewritten(frames: Sequence[Guidance]) -> CorridorProblem:
                return build_problem(scenario, frames, config, limits, speed_max_mps)

            _relinearise(search, guidance, rewritten, config)
    wanted = config.mode == "certified" or (search.z is None and not scenario.traffic)
    if len(problem.separations) and wanted and problem.binaries <= config.proof_binaries_max:
        _prove(search, config, PAPER_BIG_M if paper else None)
    else:
        _relax(search)
    return _outcome(search, config)


def _outcome(search: _Search, config: CorridorsConfig) -> Corridors:
    records = tuple(search.records)
    if search.z is None:
        infeasible = any(r.status is SolveStatus.INFEASIBLE for r in records)
        status = SolveStatus.INFEASIBLE if infeasible else SolveStatus.LIMIT
        reason = (
            "no corridors satisfy eq. (5) to (12) together"
            if infeasible
            else "the node budget ended before corridors were found; raise corridors.tree_node_budget"
        )
        return Corridors(status, reason=reason, records=records, culprits=search.culprits)
    gap = search.gap
    proven = gap is not None and gap <= config.gap_tolerance
    return Corridors(
        status=SolveStatus.OPTIMAL if proven else SolveStatus.FEASIBLE,
        corridors=search.problem.corridors(search.z),
        objective=search.objective,
        bound=search.bound if np.isfinite(search.bound) else None,
        gap=gap,
        found_by=search.found_by,
        records=records,
    )


def _large_traffic(scenario: Scenario, problem: CorridorProblem, config: CorridorsConfig) -> bool:
    return scenario.traffic and problem.binaries > config.proof_binaries_max


def _incumbent(search: _Search, config: CorridorsConfig, *, sized: bool) -> Corridors | None:
    """Stages A, B (where `sized`) and C; an outcome only where A proves that there is no solution."""
    problem = search.problem
    began = time.perf_counter()
    tree = conflict_tree.search(problem, config.tree_node_budget)
    search.exhausted = tree.exhausted
    search.offer(tree.z, "conflict tree")
    status = SolveStatus.FEASIBLE if tree.z is not None else SolveStatus.LIMIT
    infeasible = tree.exhausted and tree.z is None
    if infeasible:
        status = SolveStatus.INFEASIBLE
    search.record(
        "conflict tree", "daqp", status, began, nodes=tree.nodes, objective=_finite(search.objective)
    )
    if tree.z is None:
        conflict = tree.open_conflict
        search.culprits = tree.groups if conflict is None else (problem.pair(conflict),)
    if infeasible:
        where = "" if tree.open_conflict is None else _conflict_text(problem, tree.open_conflict)
        reason = where or "the limits of eq. (9) to (12) contradict each other or the map's bounds"
        return Corridors(SolveStatus.INFEASIBLE, reason=reason, culprits=search.culprits)
    if tree.z is None:
        return None
    grown = _size_cubes(search, tree.z, config) if sized and len(problem.separations) else tree.z
    choice = problem.separations.best(grown)
    began = time.perf_counter()
    z = polish(problem, choice)
    search.offer(z, "joint polish")
    search.record(
        "joint polish",
        "piqp",
        SolveStatus.FEASIBLE if z is not None else SolveStatus.ERROR,
        began,
        objective=None if z is None else problem.objective(z),
    )
    return None


def _size_cubes(search: _Search, z: FloatArray, config: CorridorsConfig) -> FloatArray:
    """Stage B: the largest cubes around fixed pivotal points, a small MILP."""
    began = time.perf_counter()
    problem = search.problem
    milp = build_size_milp(problem, z)
    if milp.model is None:
        search.offer(milp.grown, "cube sizes")
        search.record(
            "cube sizes", "bounds", SolveStatus.OPTIMAL, began, objective=problem.objective(milp.grown)
        )
        return milp.grown
    run = cbc.solve(
        milp.model,
        gap=0.0,
        node_budget=config.milp_node_budget,
        emergency_stop_s=config.emergency_stop_s,
    )
    found = run.status in (SolveStatus.OPTIMAL, SolveStatus.FEASIBLE)
    sized = milp.solution() if found else z
    search.offer(sized, "cube sizes")
    search.record(
        "cube sizes",
        "cbc",
        run.status,
        began,
        objective=problem.objective(sized),
        nodes=run.nodes,
        iterations=run.iterations,
        binaries=len(milp.model.delta),
        detail=run.detail,
    )
    return sized


def _relinearise(
    search: _Search,
    guidance: Sequence[Guidance],
    rewritten: Callable[[Sequence[Guidance]], CorridorProblem],
    config: CorridorsConfig,
) -> None:
    """Write the frames anew about the incumbent and solve again, while that makes it better."""
    for round_ in range(1, config.frame_rounds + 1):
        if search.z is None:
            return
        began = time.perf_counter()
        frames = frames_about(search.problem, search.z, guidance)
        problem = with_references(rewritten(frames), guidance)
        if len(problem.impossible) or _cramped(problem):
            return
        choice = problem.separations.best(search.z)
        polished = polish(problem, choice)
        found = [polished]
        # Other choices are worth a search only where the frames made a difference.
        if polished is None or problem.objective(polished) < search.objective - _MUCH * abs(search.objective):
            refined = conflict_tree.refine(
                problem, tuple(enumerate(choice.tolist())), config.tree_node_budget // 8
            )
            if refined is not None:
                found.append(polish(problem, problem.separations.best(refined)))
        best = min((z for z in found if z is not None), key=problem.objective, default=None)
        better = best is not None and problem.objective(best) < search.objective - _WORTH * abs(
            search.objective
        )
        if better:
            search.problem = problem
            search.offer(best, f"frames about the plan, round {round_}")
        search.record(
            f"frames about the plan {round_}",
            "daqp, piqp",
            SolveStatus.FEASIBLE if best is not None else SolveStatus.INFEASIBLE,
            began,
            objective=None if best is None else problem.objective(best),
        )
        if not better:
            return


def _prove(search: _Search, config: CorridorsConfig, big_m: float | None) -> None:
    """The full MIQP by outer approximation, until the gap is closed or the budget spent."""
    problem = search.problem
    milp = build_milp(problem, big_m=big_m)
    _seed_tangents(milp, search.z)
    nodes_left = config.milp_node_budget
    for round_ in range(1, config.rounds + 1):
        began = time.perf_counter()
        if search.z is not None:
            milp.set_start(search.z)
        run = cbc.solve(
            milp.model,
            gap=config.gap_tolerance * _GAP_SHARE,
            node_budget=nodes_left,
            emergency_stop_s=config.emergency_stop_s,
            warm_start=search.z is not None,
        )
        nodes_left -= run.nodes
        if run.bound is not None:
            search.bound = max(search.bound, run.bound)
        found = run.status in (SolveStatus.OPTIMAL, SolveStatus.FEASIBLE)
        if found:
            relaxed = milp.solution()
            better = polish(problem, problem.separations.best(relaxed))
            search.offer(better, f"outer approximation, round {round_}")
            new = milp.add_tangents(relaxed) + (0 if better is None else milp.add_tangents(better))
        search.record(
            f"outer approximation {round_}",
            "cbc",
            run.status,
            began,
            objective=_finite(search.objective),
            bound=_finite(search.bound),
            gap=search.gap,
            nodes=run.nodes,
            iterations=run.iterations,
            binaries=milp.binaries,
            detail=run.detail,
        )
        gap = search.gap
        closed = gap is not None and gap <= config.gap_tolerance
        if closed or not found or nodes_left <= 0 or new == 0:
            return


def _seed_tangents(milp: MilpModel, z: FloatArray | None) -> None:
    """Tangents at the incumbent (or the reference), around it, and at the optimum without conflicts."""
    centre = milp.problem.reference if z is None else z
    milp.add_tangents(centre)
    for offset in _SEEDS_M:
        milp.add_tangents(centre + offset)
    relaxed = polish(milp.problem, None)
    if relaxed is not None:
        milp.add_tangents(relaxed)


def _relax(search: _Search) -> None:
    """Bound eq. (4) by the QP without disjunctions: fast mode's bound, and exact where there are none."""
    began = time.perf_counter()
    z = polish(search.problem, None)
    if z is not None and not len(search.problem.separations):
        search.offer(z, "joint polish")
    if z is not None:
        objective = search.problem.objective(z)
        search.bound = objective - _QP_ROUNDING * max(1.0, abs(objective))
    search.record(
        "relaxation",
        "piqp",
        SolveStatus.FEASIBLE if z is not None else SolveStatus.ERROR,
        began,
        bound=_finite(search.bound),
        gap=search.gap,
    )


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _conflict_text(problem: CorridorProblem, separation: int) -> str:
    first, second = problem.pair(separation)
    equation = "eq. (6)" if problem.separations.obstacle[separation] else "eq. (5)"
    unit = int(problem.separations.unit[separation])
    return f"{first} and {second} cannot be separated in time unit {unit} ({equation})"


def _cramped(problem: CorridorProblem) -> list[tuple[str, int]]:
    """Vehicles whose bounds contradict each other, and the first unit in which they do."""
    found = []
    for block in problem.blocks:
        for k in range(block.units):
            walls = np.concatenate([block.cube[k], block.pivot[k + 1]])
            if np.any(problem.lower[walls] > problem.upper[walls] + 1e-9):
                found.append((block.vehicle_id, block.first_unit + k))
                break
    return found


def _bounds_text(cramped: Sequence[tuple[str, int]]) -> str:
    vehicle_id, unit = cramped[0]
    return f"{vehicle_id} has no room within the map's bounds in time unit {unit}"
