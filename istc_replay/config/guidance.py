"""The configuration's section `guidance`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from istc_replay.config.sections import Count, NonNegative, Positive, Section


class GuidanceConfig(Section):
    """Guidance trajectories."""

    source: Literal["auto", "recorded"] = "auto"
    """Path at constant speed; auto: a lane line (its intent, or the lane it is in) where one is told."""
    law: Literal["auto", "recorded", "constant"] = "auto"
    """The repaired recording by its own time, constant speed (the paper), or the former in traffic alone."""
    deviation_max_m: Positive = 1.0
    """A recorded track that no car can follow this closely is an obstacle, not planned."""
    speed_mps: Positive | None = None
    """Constant speed; unset: the recorded mean while moving."""
    stop_deceleration_mps2: Positive = 2.0
    """Braking to the end of a recorded path whose vehicle stands still there."""
    routing: Literal["independent", "coordinated"] = "independent"
    """Routes of scene files: each alone, or each with a view to those routed before it."""
    route_radius_m: Positive = 6.0
    """Preferred turning radius of a route: sharper bends, down to the least radius, have to save length."""
    route_margin_m: NonNegative = 0.3
    """Room that a route keeps between the car-box and an obstacle."""
    route_heading_slack_rad: Annotated[float, Field(ge=0, le=0.6)] = 0.13962634015954636
    """The route keeps its margin for headings this far from its own."""
    route_node_budget: Count = 4000
    """Nodes that one search expands."""
