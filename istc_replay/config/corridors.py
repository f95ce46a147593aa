"""The configuration's section `corridors`: layer 1."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from istc_replay.config.sections import Count, NonNegative, Positive, Section


class CorridorsConfig(Section):
    """Layer 1, eq. (1) to (12)."""

    formulation: Literal["pivot_overlap", "paper"] = "pivot_overlap"
    """Our reading, or the printed equations (with a loose big M and the diagonal car-box)."""
    mode: Literal["certified", "fast"] = "certified"
    """certified: prove the gap with the full MIQP; fast: the incumbent alone."""
    area_weight: NonNegative = 0.5
    """omega_area of eq. (2)."""
    reference_weight: Positive = 10.0
    """omega_ref of eq. (3)."""
    forward_m: Positive = 10.0
    """gamma_s+: longest step of a pivotal point in a second, and reach of a cube, eq. (9), (12)."""
    backward_m: NonNegative = 1.0
    """Reach of a cube behind its pivotal point, eq. (9)."""
    sideways_m: NonNegative = 1.5
    """Reach of a cube to either side of its pivotal point, eq. (9)."""
    paper_backward_m: NonNegative = 5.0
    """gamma_s-, used by the paper's formulation alone."""
    paper_relaxation: Positive = 2.0
    """alpha of eq. (9), used by the paper's formulation alone."""
    vehicle_gap_m: NonNegative = 0.3
    """gamma_v2v of eq. (5)."""
    obstacle_gap_m: NonNegative = 0.2
    """gamma_v2o of eq. (6)."""
    heading_slack_rad: NonNegative = 0.4363323129985824
    """The car-box is held for headings this far from the guidance's, eq. (7)."""
    cone: NonNegative = 0.4
    """mu: sideways step per forward step of a pivotal point, eq. (12)."""
    acceleration_mps2: Positive = 1.5
    """Largest second difference of the pivotal points forward."""
    deceleration_mps2: Positive = 3.0
    """Largest second difference backward."""
    lateral_acceleration_mps2: Positive = 1.5
    """Largest second difference sideways."""
    lateral_m: Positive = 1.5
    """A plan of traffic that leaves its path sideways by more is not accepted, where no road is told."""
    frame_rounds: Annotated[int, Field(ge=0)] = 5
    """How often a hard scene's frames, eq. (9) to (12), are written anew about its plan."""
    gap_tolerance: Positive = 1e-3
    """Certified means (objective - bound) / max(1, |objective|) at most this."""
    seeds: Count = 4
    """Seeds tried in one attempt at a crowded scene, until every vehicle arrives."""
    seed_rounds: Count = 60
    """Rounds of repair of one seed."""
    seed_improvements: Annotated[int, Field(ge=0)] = 20
    """Rounds that make a repaired seed cheaper."""
    seed_feedbacks: Annotated[int, Field(ge=0)] = 6
    """How often a seed is repaired anew where layer 1 cannot follow it."""
    group_vehicles_max: Count = 8
    """Vehicles in conflict that are planned at once; of larger groups one is planned against the others."""
    tree_node_budget: Count = 1000
    """QPs of the conflict tree that finds corridors."""
    small_crowd_node_budget: Count = 300
    """The same where four vehicles among standing obstacles are tried before seeds."""
    tree_proof_node_budget: Count = 4000
    """QPs of pivotal points in the tree of eq. (4), certified mode; half as many where groups are bounded."""
    joint_qp_budget: Annotated[int, Field(ge=0)] = 300
    """QPs of points and cubes together in the tree of eq. (4), certified mode."""
    milp_node_budget: Count = 20_000
    """Nodes of all branch-and-bound runs of one proof."""
    proof_binaries_max: Count = 400
    """What the tree of eq. (4) leaves open goes to CBC unless more binaries are left after probing."""
    rounds: Count = 12
    """Rounds of the outer approximation."""
    emergency_stop_s: Positive = 300.0
    """Wall-clock stop of one solver call; reported when it strikes."""
