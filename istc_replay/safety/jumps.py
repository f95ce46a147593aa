"""Jumps of recorded positions: teleports, and names that were exchanged."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from istc_replay.config import AuditConfig
from istc_replay.datatypes import FloatArray
from istc_replay.safety.bodies import Body
from istc_replay.safety.issues import Issue
from istc_replay.safety.vehicle_samples import Motion
from istc_replay.units import NS_PER_S

IntArray = NDArray[np.int64]

#: What cannot be trusted reaches this far to either side of an instant.
_AROUND_NS = NS_PER_S // 2
#: Two bodies exchanged their names where each jumps to within this of where the other was going [m].
_EXCHANGED_M = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class _Jumps:
    """All jumps of all bodies, sorted by the time of landing; (n,) and (n, 2).

    `ahead_m` is where a body would have been when it landed elsewhere.
    """

    body: IntArray
    before_ns: IntArray
    after_ns: IntArray
    left_m: FloatArray
    landed_m: FloatArray
    ahead_m: FloatArray


def _all_jumps(bodies: list[Body], motions: list[Motion]) -> _Jumps:
    columns: list[list[FloatArray | IntArray]] = []
    for row, (body, motion) in enumerate(zip(bodies, motions, strict=True)):
        k, track = motion.jumps, body.track
        x, y, heading, speed = track.states[k - 1].T
        way = np.nan_to_num(speed) * (track.times_ns[k] - track.times_ns[k - 1]) / NS_PER_S
        ahead = np.stack([x + way * np.cos(heading), y + way * np.sin(heading)], axis=-1)
        columns.append(
            [np.full(k.size, row), track.times_ns[k - 1], track.times_ns[k], track.states[k - 1, :2],
             track.states[k, :2], ahead]
        )  # fmt: skip
    joined = [np.concatenate(parts) for parts in zip(*columns, strict=True)]
    order = np.lexsort((joined[0], joined[2]))
    return _Jumps(*(part[order] for part in joined))


def teleport_issues(bodies: list[Body], motions: list[Motion], audit: AuditConfig) -> list[Issue]:
    """Bodies that are suddenly elsewhere, each disturbance once; two that exchange places switched names."""
    if not bodies:
        return []
    jumps, issues = _all_jumps(bodies, motions), []
    limit = 3.0 * audit.position_sigma_m
    moved = np.hypot(*(jumps.landed_m - jumps.left_m).T)
    last: dict[int, int] = {}  # the issue of each body that may go on
    for k in range(jumps.body.size):
        row, before, after = int(jumps.body[k]), int(jumps.before_ns[k]), int(jumps.after_ns[k])
        start, end = before - _AROUND_NS, after + _AROUND_NS
        partner = _exchanged(jumps, k)
        if partner is not None:
            if partner > row:
                detail = f"{bodies[row].name} and {bodies[partner].name} exchange places: names were switched"
                issues.append(
                    Issue(
                        "data_id_switch",
                        (row, partner),
                        start,
                        after,
                        end,
                        float(moved[k]),
                        "m",
                        limit,
                        "ours",
                        detail,
                    )
                )
            continue
        detail = f"moved {moved[k]:.3g} m in {(after - before) / NS_PER_S:.3g} s"
        issue = Issue(
            "data_teleport",
            (row,),
            start,
            after,
            end,
            float(moved[k]),
            "m",
            limit,
            "v dt + a dt^2 / 2 + 3 sigma",
            detail,
        )
        if row in last and issues[last[row]].end_ns >= start:
            # One disturbance of several jumps is told once, by its largest.
            known = issues[last[row]]
            largest = issue if issue.value > known.value else known
            issues[last[row]] = replace(largest, start_ns=known.start_ns, end_ns=end)
        else:
            last[row] = len(issues)
            issues.append(issue)
    return issues


def _exchanged(jumps: _Jumps, k: int) -> int | None:
    """The body that lands where this one was going while this one lands where it was going."""
    low = int(np.searchsorted(jumps.after_ns, jumps.after_ns[k] - _AROUND_NS))
    high = int(np.searchsorted(jumps.after_ns, jumps.after_ns[k] + _AROUND_NS, side="right"))
    near = slice(low, high)
    fits = (jumps.before_ns[near] < jumps.after_ns[k]) & (jumps.after_ns[near] > jumps.before_ns[k])
    fits &= jumps.body[near] != jumps.body[k]
    fits &= np.hypot(*(jumps.ahead_m[near] - jumps.landed_m[k]).T) <= _EXCHANGED_M
    fits &= np.hypot(*(jumps.landed_m[near] - jumps.ahead_m[k]).T) <= _EXCHANGED_M
    found = np.flatnonzero(fits)
    return int(jumps.body[low + found[0]]) if found.size else None
