"""Corridors of crowded scenes: seeds of whole motions, and eq. (4) solved about each."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.incumbent import Search, cramped, follow, gives_way
from istc_replay.corridors.relinearise import with_references
from istc_replay.corridors.seed.mending import mended
from istc_replay.corridors.seed.seeding import Seed, make_lattices, plant
from istc_replay.datatypes import SolveStatus, read_only

if TYPE_CHECKING:
    from istc_replay.config import CorridorsConfig
    from istc_replay.corridors.problem import CorridorProblem
    from istc_replay.datatypes import FloatArray, Guidance, Scenario

#: Who steps less in a unit stands [m]; the last pivotal points, as many at most, lie this near to the goal.
_STANDING_M, _AT_GOAL_M, _HELD = 0.05, 0.2, 4
_ROOM_M = 0.4

Rewritten = Callable[[Sequence["Guidance"]], "CorridorProblem"]


def search_seeds(
    search: Search,
    scenario: Scenario,
    guidance: Sequence[Guidance],
    rewritten: Rewritten,
    config: CorridorsConfig,
    attempt: int,
) -> str:
    """Grow corridors from seeds until one has every vehicle arrive, else keep the best.

    Parameters
    ----------
    search : Search
        Gets the incumbent, its problem and frames.
    scenario, guidance
        The window.
    rewritten : callable
        Writes the problem about frames.
    config : CorridorsConfig
        Numbers of seeds and of their rounds.
    attempt : int
        Later attempts take other seeds.

    Returns
    -------
    str
        Why there is no incumbent, where there is none.
    """
    began = time.perf_counter()
    lattices = make_lattices(scenario, guidance, config)
    paths = sum(lattice.shape[1] for lattice in lattices)
    search.record("seed paths", "numpy", SolveStatus.FEASIBLE, began, nodes=paths)
    found: list[Search] = []
    reason = ""
    for number in range(attempt * config.seeds, (attempt + 1) * config.seeds):
        began = time.perf_counter()
        seed = plant(lattices, guidance, config, number)
        clear = seed is not None and not seed.conflicts
        status = SolveStatus.FEASIBLE if clear else SolveStatus.LIMIT
        rounds = None if seed is None else seed.rounds
        search.record(f"seed {number}", "dynamic programme", status, began, iterations=rounds)
        if seed is None:
            return "a vehicle has no way to its goal within the window"
        if seed.conflicts:
            reason = _conflicts_left(search, scenario, seed)
            continue
        own = _grown(seed, guidance, rewritten, config)
        search.records += own.records
        if own.z is None:
            reason = "no corridors about any seed"
            continue
        found.append(own)
        if not gives_way(own):
            break
    best = min(found, key=_rank, default=None)
    if best is not None and (search.z is None or _rank(best) < _rank(search)):
        _take(search, best)
    return reason


def _rank(search: Search) -> tuple[bool, float]:
    """The better the smaller: who has everybody arrive, then the objective."""
    return gives_way(search), search.objective


def _conflicts_left(search: Search, scenario: Scenario, seed: Seed) -> str:
    names = [participant.vehicle_id for participant in scenario.participants]
    search.culprits = tuple((names[i], names[j]) for i, j in seed.conflicts)
    left = [f"{names[i]} and {names[j]} in time unit {units[0]}" for (i, j), units in seed.conflicts.items()]
    return "conflict left: " + ", ".join(left)


def _take(search: Search, best: Search) -> None:
    search.problem, search.z, search.objective = best.problem, best.z, best.objective
    search.frames, search.found_by = best.frames, best.found_by
    search.reference_bound, search.exhausted, search.bound = 0.0, False, -np.inf


def _grown(seed: Seed, guidance: Sequence[Guidance], rewritten: Rewritten, config: CorridorsConfig) -> Search:
    """Eq. (4) about a seed: its own relations, then frames that follow."""
    began = time.perf_counter()

    def anchored(frames: Sequence[Guidance]) -> CorridorProblem:
        return _anchored(rewritten(frames), seed, guidance)

    problem = with_references(anchored(seed.frames), guidance)
    search = Search(problem, frames=seed.frames)
    z = None
    if not len(problem.impossible) and not cramped(problem):
        z = mended(problem, _points(problem, seed))
    search.offer(z, "seed")
    search.record(
        "about the seed",
        "piqp",
        SolveStatus.FEASIBLE if z is not None else SolveStatus.INFEASIBLE,
        began,
        objective=None if z is None else problem.objective(z),
    )
    follow(search, guidance, anchored, config, searched=False)
    return search


def _anchored(problem: CorridorProblem, seed: Seed, guidance: Sequence[Guidance]) -> CorridorProblem:
    """Hold the last pivotal points of vehicles that stop at their goals, where the seed has brought them.

    Frames are those of the seed's own times: who is early or late turns elsewhere, and would come to
    stand beside its goal.
    """
    lower, upper = np.array(problem.lower), np.array(problem.upper)
    for block, frame, guide in zip(problem.blocks, seed.frames, guidance, strict=True):
        goal = guide.points_m[-1]
        there = np.hypot(*(frame.points_m - goal).T) < _AT_GOAL_M
        if np.hypot(*(goal - guide.points_m[-2])) < _STANDING_M and there[-1]:
            last = block.pivot[max(1, block.units + 1 - min(int(there.sum()), _HELD)) :]
            lower[last] = np.maximum(lower[last], goal - _AT_GOAL_M)
            upper[last] = np.minimum(upper[last], goal + _AT_GOAL_M)
            if there.sum() >= 2:  # the last cube holds standing alone: layer 2 must come there too
                half, walls = block.half_gamma_m[-2:].max(axis=0) + _AT_GOAL_M + _ROOM_M, block.cube[-1]
                lower[walls[::2]] = np.maximum(lower[walls[::2]], goal - half)
                upper[walls[1::2]] = np.minimum(upper[walls[1::2]], goal + half)
    return replace(problem, lower=read_only(lower), upper=read_only(upper))


def _points(problem: CorridorProblem, seed: Seed) -> FloatArray:
    """A seed as z, with least cubes."""
    z = np.zeros(problem.size)
    for block, frame in zip(problem.blocks, seed.frames, strict=True):
        z[block.pivot[1:]] = frame.points_m[1:]
    return problem.least_cubes(z)
