"""The configuration's section `trajectories`: layer 2."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from istc_replay.config.sections import Count, NonNegative, Positive, Section


class TrajectoriesConfig(Section):
    """Layer 2, eq. (13) to (19)."""

    integrator: Literal["gauss", "euler"] = "gauss"
    """gauss: collocation of order 6; euler: the paper's, whose drift from the true motion the solves tell."""
    step_s: Positive = 0.2
    """Control interval, in a unit of T the nearest length that divides T; with euler, 0.1 is the paper's."""
    curvature_weight: NonNegative = 1.0
    """omega_kappa of eq. (13)."""
    steering_rate_weight: NonNegative = 100.0
    """omega_beta of eq. (14)."""
    jerk_weight: NonNegative = 1.0
    """omega_j of eq. (14)."""
    pivotal_x_weight: NonNegative = 1.0
    """omega_px of eq. (15)."""
    pivotal_y_weight: NonNegative = 1.0
    """omega_py of eq. (15)."""
    steering_max_rad: Annotated[float, Field(gt=0, lt=1.5)] = 0.6
    """delta_max of eq. (18)."""
    steering_rate_max_radps: Positive = 0.8
    """Largest steering rate."""
    acceleration_max_mps2: Positive = 3.0
    """a_accmax of eq. (18)."""
    deceleration_max_mps2: Positive = 4.0
    """a_decmax of eq. (18)."""
    jerk_max_mps3: Positive = 8.0
    """Largest jerk."""
    speed_max_mps: Positive = 10.0
    """Largest speed; raised to 1.15 times the fastest recorded speed plus 1 where that is more."""
    margin_m: NonNegative = 0.02
    """The car-box keeps this distance from the walls of its cubes at the knots."""
    quadratic_passes: Annotated[int, Field(ge=0)] = 5
    """Quadratic programmes that lead IPOPT to a solution, at most; 0: IPOPT alone, from the first guess."""
    iteration_budget: Count = 300
    """IPOPT iterations of one solve."""
    feedback_rounds: Annotated[int, Field(ge=0)] = 3
    """How often layer 1 is tightened and solved again for a vehicle that cannot be driven."""
