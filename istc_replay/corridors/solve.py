"""Solving layer 1: the stages in their order, and what came of them."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors import proof
from istc_replay.corridors.formulation import build_problem
from istc_replay.corridors.incumbent import (
    Search,
    bring_home,
    cramped,
    fill,
    follow,
    gap_between,
    gives_way,
    grow_tree,
)
from istc_replay.corridors.joint_tree import USUAL
from istc_replay.corridors.neighbourhoods import improve
from istc_replay.corridors.paper import PAPER_BIG_M, build_paper_problem
from istc_replay.corridors.polish import polish_about
from istc_replay.corridors.relinearise import with_references
from istc_replay.corridors.seeded import Seeds, search_seeds
from istc_replay.datatypes import Conflict, Corridors, SolveStatus

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from istc_replay.config import CorridorsConfig
    from istc_replay.corridors.problem import CorridorProblem, Limits
    from istc_replay.datatypes import Guidance, Scenario, SolveRecord


def solve_corridors(
    scenario: Scenario,
    guidance: Sequence[Guidance],
    config: CorridorsConfig,
    limits: Mapping[str, Limits],
    speed_max_mps: float,
) -> Corridors:
    """Construct the interactive spatio-temporal corridors of a window, eq. (4), and bound them as asked."""
    found, search = find_corridors(scenario, guidance, config, limits, speed_max_mps, Seeds())
    return found if search is None else prove_corridors(search, scenario, config)


def find_corridors(
    scenario: Scenario,
    guidance: Sequence[Guidance],
    config: CorridorsConfig,
    limits: Mapping[str, Limits],
    speed_max_mps: float,
    seeds: Seeds | None,
) -> tuple[Corridors, Search | None]:
    """Find corridors, eq. (4). Every outcome is returned, none is raised, save a missing solver (SolveError).

    Parameters
    ----------
    scenario, guidance, config
        The window and the settings.
    limits : mapping
        Limits of the pivotal points by vehicle id.
    speed_max_mps : float
        Largest speed of a plan.
    seeds : Seeds, optional
        A scene's from attempt to attempt: a crowded one begins from seeds, any other from the second
        attempt on. None tries the conflict tree alone, within `small_crowd_node_budget`.

    Returns
    -------
    tuple
        The corridors, and what `prove_corridors` goes on from where there is a proof to be made.
    """
    paper = config.formulation == "paper"
    build = build_paper_problem if paper else build_problem
    problem = build(scenario, guidance, config, limits, speed_max_mps)
    refused = _refused(problem)
    # Who was handed over need not be where its guidance would have it: seeds write the rows about themselves.
    handed = any(participant.approach is not None for participant in scenario.participants)
    if refused is not None and not (handed and scenario.crowded and seeds is not None and not paper):
        return refused, None
    search = Search(problem)

    def rewritten(frames: Sequence[Guidance]) -> CorridorProblem:
        return build_problem(scenario, frames, config, limits, speed_max_mps)

    if seeds is not None and not paper and not scenario.traffic and (scenario.crowded or seeds.attempt > 0):
        reason = search_seeds(search, scenario, guidance, rewritten, config, seeds)
        if search.z is None and scenario.crowded:
            return refused or _unfound(search, SolveStatus.LIMIT, reason), None
    if not paper and search.z is None:
        tree = grow_tree(search, config, first_try=seeds is None)
        if tree.z is None and (tree.exhausted or seeds is None):
            if tree.open_conflict is not None:
                search.conflicts = (_conflict(problem, tree.open_conflict),)
            where = "" if tree.open_conflict is None else _conflict_text(problem, tree.open_conflict)
            reason = where or "the limits of eq. (9) to (12) contradict each other or the map's bounds"
            return _unfound(search, SolveStatus.INFEASIBLE, reason), None
        if tree.z is not None:
            large_traffic = scenario.traffic and problem.binaries > config.proof_binaries_max
            fill(search, tree.z, config, sized=not large_traffic)
        if not scenario.traffic and (not tree.exhausted or gives_way(search)):
            follow(search, guidance, rewritten, config)
            bring_home(search, guidance)
    if search.z is not None and config.mode == "certified":
        return _outcome(search, config), search
    _prove(search, scenario, config)
    return _outcome(search, config), None


def go_on(
    frames: Sequence[Guidance],
    scenario: Scenario,
    guidance: Sequence[Guidance],
    config: CorridorsConfig,
    limits: Mapping[str, Limits],
    speed_max_mps: float,
) -> Corridors:
    """Corridors about a motion that keeps all rows written about itself, and then better ones beside it.

    Parameters
    ----------
    frames : sequence of Guidance
        Of `handover.motion_before`.
    scenario, guidance, config, limits, speed_max_mps
        As of `find_corridors`.
    """
    began = time.perf_counter()
    problem = with_references(build_problem(scenario, frames, config, limits, speed_max_mps), guidance)
    search = Search(problem, frames=tuple(frames))
    if _refused(problem) is None:
        z = np.zeros(problem.size)
        for block, frame in zip(problem.blocks, frames, strict=True):
            z[block.pivot[1:]] = frame.points_m[1:]
        polished = polish_about(problem, problem.least_cubes(z))
        search.offer(polished, "about the plan before")
        if polished is not None:
            better, _ = improve(problem, problem.least_cubes(polished), config.tree_node_budget // 4)
            search.offer(polish_about(problem, better), "about the plan before")
    status = SolveStatus.INFEASIBLE if search.z is None else SolveStatus.FEASIBLE
    search.record("about the plan before", "daqp, piqp", status, began)
    return _outcome(search, config)


def prove_corridors(search: Search, scenario: Scenario, config: CorridorsConfig) -> Corridors:
    """Bound corridors that were found, as certified mode asks; better ones may turn up on the way."""
    _prove(search, scenario, config)
    return _outcome(search, config)


def bounded(corridors: Corridors, bound: float | None, gap_tolerance: float) -> Corridors:
    """Corridors with a bound that was found for the same problem."""
    if bound is None or corridors.objective is None:
        return corridors
    gap = gap_between(corridors.objective, bound)
    status = SolveStatus.OPTIMAL if gap <= gap_tolerance else corridors.status
    return replace(corridors, bound=bound, gap=gap, status=status)


def _unfound(search: Search, status: SolveStatus, reason: str) -> Corridors:
    return Corridors(
        status,
        reason=reason,
        culprits=search.culprits,
        conflicts=search.conflicts,
        records=tuple(search.records),
    )


def _prove(search: Search, scenario: Scenario, config: CorridorsConfig) -> None:
    """Bound the incumbent as far as the mode asks; where there is none, look for one."""
    paper = config.formulation == "paper"
    certified = config.mode == "certified" or (search.z is None and not scenario.traffic)
    proof.bound_by_parts(search)
    if not certified and search.frames and not (scenario.traffic or scenario.crowded):
        proof.prove_jointly(search, config, quick=True)
    if not certified or search.closed(config.gap_tolerance):
        return
    problem = search.problem
    if not len(problem.separations) or (scenario.traffic and problem.binaries > config.proof_binaries_max):
        return
    if not paper and search.z is not None:
        proof.improve(search, config)
        if scenario.traffic or len(problem.pivot_indices) <= USUAL:
            proof.prove_jointly(search, config)
        else:
            proof.prove_by_groups(search, config)
        if search.closed(config.gap_tolerance):
            return
        problem = proof.probe(search, config)
    if problem.binaries <= config.proof_binaries_max:
        proof.approximate(search, problem, config, PAPER_BIG_M if paper else None)


def _refused(problem: CorridorProblem) -> Corridors | None:
    """What cannot be solved whatever is chosen, with its reason."""
    impossible = problem.impossible.tolist()
    if impossible:
        reason = _conflict_text(problem, impossible[0])
        pairs = tuple(dict.fromkeys(map(problem.pair, impossible)))
        first = {problem.pair(d): _conflict(problem, d) for d in reversed(impossible)}
        conflicts = tuple(first[pair] for pair in pairs)
        return Corridors(SolveStatus.INFEASIBLE, reason=reason, culprits=pairs, conflicts=conflicts)
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
    return Corridors(
        status=SolveStatus.OPTIMAL if search.closed(config.gap_tolerance) else SolveStatus.FEASIBLE,
        corridors=search.problem.corridors(search.z),
        frames=search.frames,
        objective=search.objective,
        bound=search.bound if np.isfinite(search.bound) else None,
        gap=search.gap,
        found_by=search.found_by,
        reason="; ".join(filter(None, [search.note, *_faults(records)])),
        records=records,
    )


def _faults(records: Sequence[SolveRecord]) -> list[str]:
    """What CBC did not do, where the rest went on without it."""
    return [f"{r.stage}: {r.detail}" for r in records if r.solver == "cbc" and r.detail.startswith("CBC ")]


def _none_found(search: Search) -> Corridors:
    if any(r.status is SolveStatus.INFEASIBLE for r in search.records):
        return Corridors(SolveStatus.INFEASIBLE, reason="no corridors satisfy eq. (5) to (12) together")
    died = [r.detail for r in search.records if r.solver == "cbc" and r.status is SolveStatus.ERROR]
    if died:
        return Corridors(SolveStatus.ERROR, reason=f"no corridors were found before {died[-1]}")
    reason = "the node budget ended before corridors were found; raise corridors.tree_node_budget"
    return Corridors(SolveStatus.LIMIT, reason=reason)


def _conflict(problem: CorridorProblem, separation: int) -> Conflict:
    return Conflict(*problem.pair(separation), int(problem.separations.unit[separation]))


def _conflict_text(problem: CorridorProblem, separation: int) -> str:
    first, second = problem.pair(separation)
    equation = "eq. (6)" if problem.separations.obstacle[separation] else "eq. (5)"
    unit = int(problem.separations.unit[separation])
    return f"{first} and {second} cannot be separated in time unit {unit} ({equation})"
