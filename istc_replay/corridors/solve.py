"""Solving layer 1: the stages in their order, and what came of them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors import proof
from istc_replay.corridors.formulation import build_problem
from istc_replay.corridors.incumbent import Search, cramped, fill, follow, gives_way, grow_tree
from istc_replay.corridors.paper import PAPER_BIG_M, build_paper_problem
from istc_replay.corridors.seeded import search_seeds
from istc_replay.datatypes import Corridors, SolveStatus

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from istc_replay.config import CorridorsConfig
    from istc_replay.corridors.problem import CorridorProblem, Limits
    from istc_replay.datatypes import Guidance, Scenario


def solve_corridors(
    scenario: Scenario,
    guidance: Sequence[Guidance],
    config: CorridorsConfig,
    limits: Mapping[str, Limits],
    speed_max_mps: float,
    attempt: int = 0,
) -> Corridors:
    """Construct the interactive spatio-temporal corridors of a window, eq. (4).

    Every outcome is returned, none is raised, save a missing solver (SolveError). Later attempts at a
    scene start from other seeds.
    """
    paper = config.formulation == "paper"
    build = build_paper_problem if paper else build_problem
    problem = build(scenario, guidance, config, limits, speed_max_mps)
    refused = _refused(problem)
    if refused is not None:
        return refused
    search = Search(problem)

    def rewritten(frames: Sequence[Guidance]) -> CorridorProblem:
        return build_problem(scenario, frames, config, limits, speed_max_mps)

    seeded = not paper and not scenario.traffic and (scenario.crowded or attempt > 0)
    if seeded:
        reason = search_seeds(search, scenario, guidance, rewritten, config, attempt)
        if search.z is None and scenario.crowded:
            records = tuple(search.records)
            return Corridors(SolveStatus.LIMIT, reason=reason, culprits=search.culprits, records=records)
    if not paper and search.z is None:
        tree = grow_tree(search, config)
        if tree.z is None and tree.exhausted:
            where = "" if tree.open_conflict is None else _conflict_text(problem, tree.open_conflict)
            reason = where or "the limits of eq. (9) to (12) contradict each other or the map's bounds"
            records = tuple(search.records)
            return Corridors(SolveStatus.INFEASIBLE, reason=reason, culprits=search.culprits, records=records)
        if tree.z is not None:
            large_traffic = scenario.traffic and problem.binaries > config.proof_binaries_max
            fill(search, tree.z, config, sized=not large_traffic)
        if not scenario.traffic and (not tree.exhausted or gives_way(search)):
            follow(search, guidance, rewritten, config)
    _prove(search, scenario, config)
    return _outcome(search, config)


def _prove(search: Search, scenario: Scenario, config: CorridorsConfig) -> None:
    """Bound the incumbent as far as the mode asks; where there is none, look for one."""
    paper = config.formulation == "paper"
    certified = config.mode == "certified" or (search.z is None and not scenario.traffic)
    if certified and not paper and not scenario.traffic:
        proof.prove_points(search, config)
    proof.bound_by_parts(search)
    gap = search.gap
    if not certified or (gap is not None and gap <= config.gap_tolerance):
        return
    problem = search.problem
    if not len(problem.separations) or (scenario.traffic and problem.binaries > config.proof_binaries_max):
        return
    if not paper and search.z is not None:
        problem = proof.probe(search, config)
    if problem.binaries <= config.proof_binaries_max:
        proof.approximate(search, problem, config, PAPER_BIG_M if paper else None)


def _refused(problem: CorridorProblem) -> Corridors | None:
    """What cannot be solved whatever is chosen, with its reason."""
    impossible = problem.impossible.tolist()
    if impossible:
        reason = _conflict_text(problem, impossible[0])
        pairs = tuple(dict.fromkeys(map(problem.pair, impossible)))
        return Corridors(SolveStatus.INFEASIBLE, reason=reason, culprits=pairs)
    narrow = cramped(problem)
    if narrow:
        vehicle_id, unit = narrow[0]
        reason = f"{vehicle_id} has no room within the map's bounds in time unit {unit}"
        return Corridors(SolveStatus.INFEASIBLE, reason=reason, culprits=tuple((v,) for v, _ in narrow))
    return None


def _outcome(search: Search, config: CorridorsConfig) -> Corridors:
    records = tuple(search.records)
    if search.z is None:
        return replace(_none_found(search), records=records, culprits=search.culprits)
    gap = search.gap
    proven = gap is not None and gap <= config.gap_tolerance
    return Corridors(
        status=SolveStatus.OPTIMAL if proven else SolveStatus.FEASIBLE,
        corridors=search.problem.corridors(search.z),
        frames=search.frames,
        objective=search.objective,
        bound=search.bound if np.isfinite(search.bound) else None,
        gap=gap,
        found_by=search.found_by,
        reason=search.note,
        records=records,
    )


def _none_found(search: Search) -> Corridors:
    if any(r.status is SolveStatus.INFEASIBLE for r in search.records):
        return Corridors(SolveStatus.INFEASIBLE, reason="no corridors satisfy eq. (5) to (12) together")
    died = [r.detail for r in search.records if r.solver == "cbc" and r.status is SolveStatus.ERROR]
    if died:
        return Corridors(SolveStatus.ERROR, reason=f"no corridors were found before {died[-1]}")
    reason = "the node budget ended before corridors were found; raise corridors.tree_node_budget"
    return Corridors(SolveStatus.LIMIT, reason=reason)


def _conflict_text(problem: CorridorProblem, separation: int) -> str:
    first, second = problem.pair(separation)
    equation = "eq. (6)" if problem.separations.obstacle[separation] else "eq. (5)"
    unit = int(problem.separations.unit[separation])
    return f"{first} and {second} cannot be separated in time unit {unit} ({equation})"
