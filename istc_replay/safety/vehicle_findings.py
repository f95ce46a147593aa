"""Findings of single vehicles: braking, jerk, turning, speed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from istc_replay.config import AuditConfig
from istc_replay.datatypes import FloatArray
from istc_replay.safety.bodies import Body
from istc_replay.safety.events import find_events, longest_bridge_ns
from istc_replay.safety.findings import Finding, make_finding
from istc_replay.safety.rules import VEHICLE_RULES, Rule
from istc_replay.safety.vehicle_samples import Motion

IntArray = NDArray[np.int64]


def vehicle_findings(
    bodies: list[Body], motions: list[Motion], spans: list[IntArray], audit: AuditConfig
) -> list[Finding]:
    """Findings of single vehicles."""
    found = []
    for row, (body, motion) in enumerate(zip(bodies, motions, strict=True)):
        if not body.is_vehicle:
            continue
        times = body.track.times_ns
        bridge = longest_bridge_ns(body.track.period_ns, audit)
        for rule in VEHICLE_RULES:
            values, thresholds = vehicle_values(rule, body, motion, audit), rule.thresholds(audit)
            if values is None or not thresholds:
                continue
            levels = np.array([level for _, level, _ in thresholds])
            events = find_events(
                np.zeros(times.size, dtype=np.int64),
                times,
                values,
                levels,
                release=rule.release(audit),
                bridge_ns=np.full(times.size, bridge),
                least_samples=np.full(levels.size, audit.least_samples),
            )
            for event in events:
                when = tuple(int(times[k]) for k in (event.start, event.worst, event.end))
                place = (float(body.track.states[event.worst, 0]), float(body.track.states[event.worst, 1]))
                value = float(values[event.worst])
                found.append(
                    make_finding(rule, audit, event.level, (row,), when, place, value, "", bodies, spans)
                )
    return found


def vehicle_values(rule: Rule, body: Body, motion: Motion, audit: AuditConfig) -> FloatArray | None:
    """(S,) values of a rule of single vehicles, larger is worse; None where it does not apply."""
    speed = body.track.states[:, 3]
    if rule.name == "speed_limit":
        return None if audit.speed_limit_mps is None else np.abs(speed) - audit.speed_limit_mps
    if rule.name == "braking":
        # Slowing down is against the way it drives, forwards or backwards.
        values = -motion.acceleration_mps2 * np.where(speed < 0.0, -1.0, 1.0)
        return np.where(np.isfinite(values), values, np.nan)
    values = np.abs(getattr(motion, rule.column))
    return np.where(np.isfinite(values), values, np.nan)
