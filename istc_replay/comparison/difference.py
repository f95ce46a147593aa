"""What a comparison tells, as plain data.

A and B are the two results. Windows are compared by their index and vehicles by their names, each
from its window's start, so that two logs can be compared as well as two plans of one log.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Change:
    """A figure that differs: its name, and what it is in A and in B (None where there is none)."""

    key: str
    a: Any
    b: Any


@dataclass(frozen=True, slots=True)
class Crossing:
    """Who is first at the place that two vehicles share, and how long before the other [s]."""

    first: str
    second: str
    lead_s: float


@dataclass(frozen=True, slots=True)
class PairChange:
    """Two vehicles that share a place in another order, or at another distance in time.

    None where they share none. `recorded` is the recording of A.
    """

    pair: tuple[str, str]
    recorded: Crossing | None
    a: Crossing | None
    b: Crossing | None

    @property
    def reversed(self) -> bool:
        """Whether the other one goes first."""
        return self.a is not None and self.b is not None and self.a.first != self.b.first


@dataclass(frozen=True, slots=True)
class VehicleChange:
    """One vehicle in one window; what does not differ is None or left out.

    `moved_m` is the largest distance between the two plans at one instant, `moved_at_s` that
    instant from the window's start; `recorded_moved_m` the same of the recordings. `delay_s` is
    how much later B passes the place where A has done 95 % of its way, None where B does not come
    there. `walls_m` is the largest
    shift of a wall of a corridor-cube, `cubes` how many of them differ.
    """

    vehicle_id: str
    figures: tuple[Change, ...]
    moved_m: float | None = None
    moved_at_s: float | None = None
    delay_s: float | None = None
    walls_m: float | None = None
    cubes: int = 0
    recorded_moved_m: float | None = None


@dataclass(frozen=True, slots=True)
class WindowChange:
    """One window: figures of the whole, checks of the certificate, vehicles, and who goes first."""

    index: int
    figures: tuple[Change, ...]
    checks: tuple[Change, ...]
    vehicles: tuple[VehicleChange, ...]
    pairs: tuple[PairChange, ...]

    @property
    def differs(self) -> bool:
        """Whether anything does."""
        return bool(self.figures or self.checks or self.vehicles or self.pairs)


@dataclass(frozen=True, slots=True)
class Comparison:
    """All that differs between two results.

    `inputs` are differences of the logs, `settings` of the configuration by dotted key, `versions`
    of the programs. `windows` are those that differ; `only_a` and `only_b` the vehicles and windows
    that only one of the two has.
    """

    inputs: tuple[Change, ...]
    settings: tuple[Change, ...]
    versions: tuple[Change, ...]
    vehicles_only_a: tuple[str, ...]
    vehicles_only_b: tuple[str, ...]
    windows_only_a: tuple[int, ...]
    windows_only_b: tuple[int, ...]
    windows: tuple[WindowChange, ...]
    findings: tuple[Change, ...]

    @property
    def same_outcome(self) -> bool:
        """Whether vehicles, windows, plans, certificates and findings are the same."""
        only = self.vehicles_only_a + self.vehicles_only_b + self.windows_only_a + self.windows_only_b
        return not (only or self.windows or self.findings)

    @property
    def same(self) -> bool:
        """Whether nothing differs at all."""
        return self.same_outcome and not (self.inputs or self.settings or self.versions)
