"""The stages that bound eq. (4) from below: relaxations, the conflict tree, probing, outer approximation."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors import cbc, joint_tree, neighbourhoods
from istc_replay.corridors.group_proof import GroupProof
from istc_replay.corridors.incumbent import Search
from istc_replay.corridors.joint_tree import QP_ROUNDING, USUAL
from istc_replay.corridors.miqp import MilpModel, build_milp
from istc_replay.corridors.pivot_qp import PivotQp
from istc_replay.corridors.polish import polish
from istc_replay.datatypes import FloatArray, SolveStatus

if TYPE_CHECKING:
    from istc_replay.config import CorridorsConfig
    from istc_replay.corridors.problem import CorridorProblem

#: Where the first tangents touch, from the incumbent [m]. Wide seeds close the gap in one round
#: where close ones alone need three or more (docs/performance.md).
_SEEDS_M = (-4.0, -2.0, -1.0, -0.3, 0.3, 1.0, 2.0, 4.0)
#: CBC may leave this share of the wanted gap open in each round.
_GAP_SHARE = 0.25
#: About what the cubes' sizes gain by moving pivotal points where only a share s of eq. (3) counts,
#: times s. It decides how good a bound is, not whether it is one.
_DRIFT_COST = 0.2
_LEAST_SHARE = 1e-3
#: Where eq. (3) is at least this, the QP of all of it bounds less than the one of a share.
_FAR_COST = 20.0
#: A quick proof has this part of the nodes.
_QUICK_SHARE = 20
#: Groups have these parts of the QPs of a tree of all; neighbourhoods of two vehicles before them this one
#: where they are as large as a usual problem, of smaller ones more.
_GROUPS_SHARE, _JOINT_SHARE, _PAIRS_SHARE = 2, 5, 3
#: Probing decides a half of the binaries at most, or little more.
_PROBED = 3


def bound_by_parts(search: Search) -> None:
    """Bound eq. (4) by the QP without separations, and by parts where eq. (3) alone has a bound.

    For every share s in [0, 1], eq. (4) is (1 - s) of eq. (3), bounded by the conflict tree, plus the
    rest, bounded by a QP without separations.
    """
    began = time.perf_counter()
    problem, reference_bound = search.problem, search.reference_bound
    shares = [1.0]
    if reference_bound > _DRIFT_COST:
        shares.insert(0, max(float(np.sqrt(_DRIFT_COST / reference_bound)), _LEAST_SHARE))
    far = reference_bound > _FAR_COST and len(problem.separations)
    for share in shares:
        if share == 1.0 and far and np.isfinite(search.bound):
            continue
        z = polish(problem, None, share=share)
        if z is None:
            continue
        if share == 1.0 and not len(problem.separations):
            search.offer(z, "joint polish")
        rest = problem.objective(z) - (1.0 - share) * problem.reference_cost(z)
        rest -= QP_ROUNDING * max(1.0, abs(rest))
        search.bound = max(search.bound, (1.0 - share) * reference_bound + rest)
    known = np.isfinite(search.bound)
    search.record("relaxation", "piqp", SolveStatus.FEASIBLE if known else SolveStatus.ERROR, began)


def improve(search: Search, config: CorridorsConfig) -> None:
    """Make a plan that no tree has searched better: one vehicle or two anew, all others held."""
    if search.z is None or search.exhausted:
        return
    began = time.perf_counter()
    problem = search.problem
    least = problem.least_cubes(search.z)
    two = 4 * max(block.units for block in problem.blocks)
    budget = config.tree_proof_node_budget * USUAL // (_PAIRS_SHARE * two)
    refined, nodes = neighbourhoods.improve(problem, least, budget, together=2)
    search.offer(polish(problem, problem.separations.best(refined)), "neighbourhoods")
    search.record(
        "neighbourhoods", "daqp, piqp", SolveStatus.FEASIBLE, began, objective=search.objective, nodes=nodes
    )


def prove_jointly(search: Search, config: CorridorsConfig, *, quick: bool = False) -> None:
    """Bound eq. (4) by its tree, best first; what it finds on the way is a new incumbent.

    A `quick` proof has a small share of the budget, and bounds by eq. (3) alone.
    """
    if search.z is None:
        return
    began = time.perf_counter()
    budgets = config.tree_proof_node_budget, config.joint_qp_budget
    if quick:
        budgets = config.tree_proof_node_budget // _QUICK_SHARE, 0
    tree = joint_tree.prove(
        search.problem, search.z, config.gap_tolerance, *budgets, config.group_vehicles_max
    )
    search.offer(tree.z, "joint tree")
    search.bound = max(search.bound, tree.bound)
    search.record(
        "joint tree",
        "daqp, piqp",
        SolveStatus.OPTIMAL if search.closed(config.gap_tolerance) else SolveStatus.FEASIBLE,
        began,
        objective=search.objective,
        nodes=tree.nodes + tree.joint_qps,
        detail=f"{tree.joint_qps} QPs of points and cubes",
    )


def prove_by_groups(search: Search, config: CorridorsConfig) -> None:
    """Bound eq. (4) by bounds of small groups of vehicles; their plans together may be a new incumbent."""
    if search.z is None:
        return
    began = time.perf_counter()
    slack = config.gap_tolerance * max(1.0, abs(search.objective))
    proof = GroupProof(search.problem, search.z, slack, config.group_vehicles_max)
    proof.run(config.tree_proof_node_budget / _GROUPS_SHARE)
    proof.put_together()
    proof.close(config.joint_qp_budget // _JOINT_SHARE)
    search.offer(proof.z, "groups")
    search.bound = max(search.bound, proof.bound)
    matter = [sorted(group) for group, weight in proof.packing.weights.items() if weight > 0.5]
    names = [
        "+".join(search.problem.blocks[vehicle].vehicle_id for vehicle in group) for group in sorted(matter)
    ]
    search.record(
        "groups",
        "daqp, piqp",
        SolveStatus.OPTIMAL if search.closed(config.gap_tolerance) else SolveStatus.FEASIBLE,
        began,
        objective=search.objective,
        nodes=proof.nodes + proof.joint_qps,
        detail=f"{len(proof.trees)} groups bounded, of weight: {', '.join(names) or 'none'}",
    )


def probe(search: Search, config: CorridorsConfig) -> CorridorProblem:
    """Leave out options that make two vehicles alone dearer than the incumbent is altogether.

    A problem far too large for the outer approximation is left as it is.
    """
    began = time.perf_counter()
    problem = search.problem
    if problem.binaries > _PROBED * config.proof_binaries_max:
        return problem
    # The sizes of the cubes gain at most this; what is left bounds eq. (3) of anything better.
    share = 0.05
    z = polish(problem, None, share=share)
    qp = PivotQp(problem)
    root = qp.root(tuple(range(len(problem.blocks))), ())
    if z is None or root is None or search.z is None:
        return problem
    rest = problem.objective(z) - (1.0 - share) * problem.reference_cost(z)
    rest -= QP_ROUNDING * max(1.0, abs(rest))
    most = (search.objective + QP_ROUNDING * max(1.0, abs(search.objective)) - rest) / (1.0 - share)
    table = problem.separations
    gap = np.array(table.gap)
    tried = np.argwhere(table.possible).tolist()
    for d, o in tried:
        found = qp.with_option(root, (d, o), most)
        if found is None or found.cost > most:
            gap[d, o] = np.inf
    probed = replace(problem, separations=replace(table, gap=gap))
    search.record(
        "probing",
        "daqp",
        SolveStatus.FEASIBLE,
        began,
        nodes=len(tried),
        binaries=probed.binaries,
        detail=f"{problem.binaries - probed.binaries} of {problem.binaries} binaries decided",
    )
    return probed


def approximate(
    search: Search, problem: CorridorProblem, config: CorridorsConfig, big_m: float | None
) -> None:
    """The full MIQP by outer approximation, until the gap is closed or the budget spent.

    `problem` is the search's, perhaps with fewer options.
    """
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
        new, found = 0, run.status in (SolveStatus.OPTIMAL, SolveStatus.FEASIBLE)
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
            objective=search.objective if search.z is not None else None,
            nodes=run.nodes,
            iterations=run.iterations,
            binaries=milp.binaries,
            detail=run.detail,
        )
        if search.closed(config.gap_tolerance) or not found or nodes_left <= 0 or new == 0:
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
