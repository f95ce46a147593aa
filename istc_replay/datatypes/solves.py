"""How a solve ended, and its record."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class SolveStatus(StrEnum):
    """How a solve ended."""

    OPTIMAL = "optimal"  # proven within the tolerance asked for
    FEASIBLE = "feasible"  # a solution, its optimality not proven
    INFEASIBLE = "infeasible"
    LIMIT = "limit"  # the budget ended first, with no solution
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class SolveRecord:
    """One call of one solver, as the solves table tells it."""

    layer: str  # corridors or trajectory
    stage: str
    solver: str
    status: SolveStatus
    vehicle_id: str | None = None
    objective: float | None = None
    bound: float | None = None
    gap: float | None = None
    wall_s: float | None = None
    iterations: int | None = None
    nodes: int | None = None
    binaries: int | None = None
    detail: str = ""
