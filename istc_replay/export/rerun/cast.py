"""Who is shown in full: with many vehicles, those that matter.

A scene of up to twelve vehicles is shown whole. Of more, the vehicles that one asks for are shown
in full, or else the twelve with the worst findings and the least clearances: window by window in
the scenes, over the whole result in the plots. All the others keep their boxes and their paths;
their names, corridors, trails and plots wait under `quiet`, one click away.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import polars as pl

from istc_replay.export.rerun.clearance import Clearance, Leasts, add_leasts, closest_pairs
from istc_replay.export.rerun.ground import height_of_second, tower_shares
from istc_replay.export.rerun.slots import Presence, presence, slots
from istc_replay.export.rerun.spans import Span
from istc_replay.export.rerun.stage import Stage

#: So many vehicles are shown in full.
LEADING = 12
#: Of results with more states only the starring vehicles are plotted.
_QUIET_STATES = 400_000
SEVERITIES = ("critical", "serious", "minor")


@dataclass(slots=True)
class Survey:
    """What the parts of a result add up to: who matters most, and how high a second is."""

    presence: dict[str, Presence] = field(default_factory=dict)
    leasts: Leasts = field(default_factory=dict)
    shares: list[float] = field(default_factory=list)
    states: int = 0

    def add(self, stage: Stage, found: list[Clearance]) -> None:
        """Add a part."""
        for vehicle_id, (first_ns, last_ns) in presence(stage).items():
            first, last = self.presence.get(vehicle_id, (first_ns, last_ns))
            self.presence[vehicle_id] = min(first, first_ns), max(last, last_ns)
        add_leasts(self.leasts, found)
        self.shares += tower_shares(stage.spans, stage.grounds)
        self.states += stage.states_shown

    @property
    def height_m(self) -> float:
        """Height of a second [m]."""
        return height_of_second(self.shares)


def cast(stage: Stage, found: list[Clearance], focus: Iterable[str], whole: Survey) -> Stage:
    """The stage with its leading vehicles; `focus` names them, where it is not empty."""
    asked = frozenset(focus)
    findings = stage.result.findings
    leading, follows = {}, {}
    for span in stage.spans:
        during = (pl.col("start_ns") <= span.end_ns) & (pl.col("end_ns") >= span.start_ns)
        own = [clearance for clearance in found if clearance.window == span.index]
        leasts: Leasts = {}
        add_leasts(leasts, own)
        order = _ranked(_present(stage, span), findings.filter(during), leasts)
        leading[span.index] = asked or frozenset(order[:LEADING])
        closest = min(own, key=lambda c: (c.least_m, c.pair), default=None)
        follows[span.index] = tuple(sorted(asked)) or (closest.pair if closest else ())
    shared = slots(whole.presence)
    return replace(
        stage,
        starring=asked or frozenset(_ranked(whole.presence, findings, whole.leasts)[:LEADING]),
        leading=leading,
        follows=follows,
        closest=closest_pairs(whole.leasts),
        plots_all=whole.states <= _QUIET_STATES and not shared,
        presence=whole.presence,
        slots=shared,
    )


def _present(stage: Stage, span: Span) -> list[str]:
    present = {vehicle for window, vehicle in stage.planned if window == span.index}
    for vehicle_id, track in stage.recorded.items():
        if track.times_ns[0] <= span.end_ns and track.ends_ns[-1] >= span.start_ns:
            present.add(vehicle_id)
    return sorted(present)


def _ranked(vehicle_ids: Iterable[str], findings: pl.DataFrame, leasts: Leasts) -> list[str]:
    """Vehicles by the severity of their worst finding, then by their least clearance."""
    worst: dict[str, int] = {}
    for severity, vehicles in findings.select("severity", "vehicles").iter_rows():
        rank = SEVERITIES.index(severity) if severity in SEVERITIES else len(SEVERITIES)
        for vehicle_id in vehicles or []:
            worst[vehicle_id] = min(rank, worst.get(vehicle_id, rank))
    least: dict[str, float] = {}
    for (_, pair), gap_m in leasts.items():
        for vehicle_id in pair:
            least[vehicle_id] = min(gap_m, least.get(vehicle_id, np.inf))
    return sorted(vehicle_ids, key=lambda v: (worst.get(v, 9), least.get(v, np.inf), v))
