"""Corridors of crowded scenes: seeds of whole motions, and eq. (4) solved about each."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.incumbent import Search, cramped, follow, gives_way
from istc_replay.corridors.relinearise import with_references
from istc_replay.corridors.seed.mending import Mended, mended
from istc_replay.corridors.seed.repair import Repair
from istc_replay.corridors.seed.seeding import frames_of, make_lattices
from istc_replay.datatypes import Conflict, SolveRecord, SolveStatus, read_only

if TYPE_CHECKING:
    from istc_replay.config import CorridorsConfig
    from istc_replay.corridors.problem import CorridorProblem
    from istc_replay.corridors.seed.lattice import Lattice
    from istc_replay.datatypes import FloatArray, Guidance, Scenario

#: Who steps less in a unit stands [m]; the last pivotal points, as many at most, lie this near to the goal.
_STANDING_M, _AT_GOAL_M, _HELD = 0.05, 0.2, 4
_ROOM_M = 0.4
#: What a seed keeps apart beyond what layer 1 missed.
_MORE_M = 0.1

Rewritten = Callable[[Sequence["Guidance"]], "CorridorProblem"]


@dataclass(slots=True)
class Seeds:
    """What the rounds of a scene keep of its seeds; each attempt plants others."""

    attempt: int = 0
    lattices: tuple[Lattice, ...] = ()
    grown: _Growth | None = None  # the seed of the incumbent
    resumed: bool = False

    def again(self, undrivable: Sequence[tuple[int, int]] = ()) -> None:
        """Begin another attempt: with the last seed where vehicles (by number) are undrivable in units."""
        self.attempt += 1
        self.resumed = bool(undrivable) and self.grown is not None
        if self.grown is not None:
            for number, unit in undrivable:
                self.grown.repair.slow(number, unit)


def search_seeds(
    search: Search,
    scenario: Scenario,
    guidance: Sequence[Guidance],
    rewritten: Rewritten,
    config: CorridorsConfig,
    seeds: Seeds,
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
    seeds : Seeds
        Kept from attempt to attempt.

    Returns
    -------
    str
        Why there is no incumbent, where there is none.
    """
    if not seeds.lattices:
        began = time.perf_counter()
        seeds.lattices = make_lattices(scenario, guidance, config)
        paths = sum(len(lattice.paths) for lattice in seeds.lattices)
        search.record("seed paths", "numpy", SolveStatus.FEASIBLE, began, nodes=paths)
    names = [participant.vehicle_id for participant in scenario.participants]
    found: list[tuple[Search, _Growth]] = []
    reason = ""
    for growth in _growths(seeds, config):
        own = growth.run(guidance, rewritten, config)
        search.records += growth.records
        if own is None:
            reason, search.conflicts = growth.why_not(names)
            search.culprits = tuple((c.first, c.second) for c in search.conflicts)
            continue
        found.append((own, growth))
        if not gives_way(own):
            break
    best, seeds.grown = min(found, key=lambda pair: _rank(pair[0]), default=(None, None))
    if best is not None and (search.z is None or _rank(best) < _rank(search)):
        _take(search, best)
    return reason


def _growths(seeds: Seeds, config: CorridorsConfig) -> Iterator[_Growth]:
    """The seed that is resumed, then those of this attempt."""
    if seeds.resumed and seeds.grown is not None:
        yield seeds.grown
    for number in range(seeds.attempt * config.seeds, (seeds.attempt + 1) * config.seeds):
        yield _Growth(Repair(seeds.lattices, config.vehicle_gap_m, number))


def _rank(search: Search) -> tuple[bool, float]:
    """The better the smaller: who has everybody arrive, then the objective."""
    return gives_way(search), search.objective


def _take(search: Search, best: Search) -> None:
    search.problem, search.z, search.objective = best.problem, best.z, best.objective
    search.frames, search.found_by = best.frames, best.found_by
    search.reference_bound, search.exhausted, search.bound = 0.0, False, -np.inf


@dataclass(slots=True)
class _Growth:
    """One seed: its motions are repaired, and repaired again where layer 1 cannot follow them."""

    repair: Repair
    records: list[SolveRecord] = field(default_factory=list)
    missed: list[Conflict] = field(default_factory=list)

    def run(
        self, guidance: Sequence[Guidance], rewritten: Rewritten, config: CorridorsConfig
    ) -> Search | None:
        """The corridors about the seed, where there are any."""
        self.records = []
        for _ in range(1 + config.seed_feedbacks):
            if not self._repaired(config):
                return None
            search, missed = _grown(frames_of(self.repair, guidance), guidance, rewritten, config)
            self.records += search.records
            if search.z is not None:
                return search
            if not missed:
                return None
            self._give_way(search.problem, missed)
        return None

    def why_not(self, names: Sequence[str]) -> tuple[str, tuple[Conflict, ...]]:
        """In one line why there are no corridors, and what conflicts are left."""
        if self.repair.no_way is not None:
            return f"{names[self.repair.no_way]} has no way to its goal within the window", ()
        conflicts = self.repair.conflicts()
        left = [Conflict(names[i], names[j], units[0]) for (i, j), units in conflicts.items()] or self.missed
        if not left:
            return "no corridors about any seed", ()
        told = ", ".join(f"{c.first} and {c.second} in time unit {c.unit}" for c in left)
        return f"conflict left: {told}", tuple(left)

    def _repaired(self, config: CorridorsConfig) -> bool:
        began, before = time.perf_counter(), self.repair.rounds
        clear = self.repair.run(config.seed_rounds, config.seed_improvements)
        self.records.append(
            SolveRecord(
                "corridors",
                f"seed {self.repair.seed}",
                "dynamic programme",
                SolveStatus.FEASIBLE if clear else SolveStatus.LIMIT,
                wall_s=time.perf_counter() - began,
                iterations=self.repair.rounds - before,
            )
        )
        return clear

    def _give_way(self, problem: CorridorProblem, missed_m: Mapping[int, float]) -> None:
        """Have the seed keep clear of what layer 1 missed: the worst of each pair of road users."""
        table = problem.separations
        worst: dict[tuple[str, str], int] = {}
        for d in sorted(missed_m, key=lambda d: (-missed_m[d], d)):
            worst.setdefault(problem.pair(d), d)
        for d in worst.values():
            first, second, unit = int(table.first[d]), int(table.second[d]), int(table.unit[d])
            if table.obstacle[d]:
                self.repair.bar(first, unit)
            else:
                self.repair.keep_apart(first, second, unit, missed_m[d] + _MORE_M)
        self.missed = [Conflict(*pair, int(table.unit[d])) for pair, d in worst.items()]


def _grown(
    frames: tuple[Guidance, ...],
    guidance: Sequence[Guidance],
    rewritten: Rewritten,
    config: CorridorsConfig,
) -> tuple[Search, Mapping[int, float]]:
    """Eq. (4) about a seed: its own relations, then frames that follow; or what is missed."""
    began = time.perf_counter()

    def anchored(some: Sequence[Guidance]) -> CorridorProblem:
        return _anchored(rewritten(some), frames, guidance)

    problem = with_references(anchored(frames), guidance)
    search = Search(problem, frames=frames)
    found = Mended(missed_m=dict.fromkeys(problem.impossible.tolist(), 0.0))
    if not found.missed_m and not cramped(problem):
        found = mended(problem, _points(problem, frames))
    search.offer(found.z, "seed")
    search.record(
        "about the seed",
        "piqp",
        SolveStatus.INFEASIBLE if found.z is None else SolveStatus.FEASIBLE,
        began,
        objective=None if found.z is None else problem.objective(found.z),
    )
    follow(search, guidance, anchored, config, searched=False)
    return search, found.missed_m


def _anchored(
    problem: CorridorProblem, frames: Sequence[Guidance], guidance: Sequence[Guidance]
) -> CorridorProblem:
    """Hold the last pivotal points of vehicles that stop at their goals, where the seed has brought them.

    Frames are those of the seed's own times: who is early or late turns elsewhere, and would come to
    stand beside its goal.
    """
    lower, upper = np.array(problem.lower), np.array(problem.upper)
    for block, frame, guide in zip(problem.blocks, frames, guidance, strict=True):
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


def _points(problem: CorridorProblem, frames: Sequence[Guidance]) -> FloatArray:
    """A seed as z, with least cubes."""
    z = np.zeros(problem.size)
    for block, frame in zip(problem.blocks, frames, strict=True):
        z[block.pivot[1:]] = frame.points_m[1:]
    return problem.least_cubes(z)
