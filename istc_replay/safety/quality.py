"""Data quality of recorded states: what is wrong with the data comes before what is judged by it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from istc_replay.config import AuditConfig
from istc_replay.datatypes import FloatArray
from istc_replay.safety.bodies import Body
from istc_replay.safety.clocks import Clock
from istc_replay.safety.pair_samples import Pairs
from istc_replay.safety.vehicle_samples import Motion
from istc_replay.units import NS_PER_S, wrap_angle

IntArray = NDArray[np.int64]

#: What cannot be trusted reaches this far to either side of an instant.
_AROUND_NS = NS_PER_S // 2
#: Recorded speed over travelled speed beyond these is no noise, but another unit.
_SPEED_RATIOS = (0.5, 2.0)
#: Two bodies exchanged their names where each jumps to within this of where the other was going [m].
_EXCHANGED_M = 2.0


@dataclass(frozen=True, slots=True)
class Issue:
    """Something wrong with the data of some bodies in a span of time.

    `doubtful` says that states in the span cannot be trusted; a gap has none to doubt.
    """

    rule: str
    bodies: tuple[int, ...]
    start_ns: int
    worst_ns: int
    end_ns: int
    value: float
    unit: str
    threshold: float
    source: str
    detail: str
    doubtful: bool = True


def body_issues(bodies: list[Body], motions: list[Motion], audit: AuditConfig) -> list[Issue]:
    """Gaps, teleports, exchanged names, contradicting headings, frozen poses, implausible units."""
    issues = _teleports(bodies, motions, audit)
    for row, (body, motion) in enumerate(zip(bodies, motions, strict=True)):
        issues += _gaps(row, body, audit)
        issues += _frozen(row, body, audit)
        if body.is_vehicle:
            issues += _headings(row, body, motion, audit)
            issues += _units(row, body, motion, audit)
    return issues


def clock_issues(clocks: list[Clock], bodies: list[Body]) -> list[Issue]:
    """Stamps that do not increase, and clocks that step or drift, as `clocks` found them."""
    rows = {body.name: row for row, body in enumerate(bodies)}
    issues = []
    for clock in clocks:
        who = tuple(sorted(rows[name] for name in clock.vehicles if name in rows))
        if who:
            issues.append(
                Issue(
                    clock.rule,
                    who,
                    clock.start_ns,
                    clock.worst_ns,
                    clock.end_ns,
                    clock.value,
                    clock.unit,
                    clock.threshold,
                    clock.source,
                    clock.detail,
                )
            )
    return issues


def overlap_issues(pairs: Pairs, bodies: list[Body], times_ns: IntArray) -> list[Issue]:
    """Boxes that overlap at the first common time of a pair: recorded so, not collided."""
    issues = []
    fresh = np.flatnonzero(np.diff(pairs.key, prepend=-1) != 0)
    for start, end in pairwise([*fresh.tolist(), pairs.key.size]):
        i, j = int(pairs.first[start]), int(pairs.second[start])
        joint = max(int(bodies[row].track.times_ns[0]) for row in (i, j))
        gap, bound = pairs["gap_m"][start:end], pairs["gap_bound_m"][start]
        if pairs.time_ns[start] != times_ns[np.searchsorted(times_ns, joint)] or not gap[0] < -bound:
            continue
        last = start + int(np.argmax(np.append(gap, np.inf) > 0.0)) - 1
        worst = start + int(np.argmin(gap[: last + 1 - start]))
        depth = float(-pairs["gap_m"][worst])
        detail = f"overlap by {depth:.3g} m from the first state on"
        instants = (int(pairs.time_ns[start]), int(pairs.time_ns[worst]), int(pairs.time_ns[last]))
        issues.append(
            Issue("data_overlap", (i, j), *instants, depth, "m", float(bound), "sampling bound", detail)
        )
    return issues


def doubtful_spans(issues: list[Issue], count: int) -> list[IntArray]:
    """(n, 2) merged spans of doubtful data, one array a body."""
    spans: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    for issue in sorted(issues, key=lambda issue: issue.start_ns):
        if not issue.doubtful:
            continue
        for row in issue.bodies:
            if spans[row] and issue.start_ns <= spans[row][-1][1]:
                start, end = spans[row][-1]
                spans[row][-1] = (start, max(end, issue.end_ns))
            else:
                spans[row].append((issue.start_ns, issue.end_ns))
    return [np.asarray(own, dtype=np.int64).reshape(-1, 2) for own in spans]


def is_doubtful(spans: IntArray, start_ns: IntArray, end_ns: IntArray) -> NDArray[np.bool_]:
    """(n,) whether spans of time touch doubtful ones."""
    if spans.shape[0] == 0:
        return np.zeros(np.shape(start_ns), dtype=bool)
    # Doubtful spans are disjoint and sorted: the first that ends late enough decides.
    row = np.searchsorted(spans[:, 1], start_ns)
    inside = row < spans.shape[0]
    return np.asarray(inside & (spans[np.minimum(row, spans.shape[0] - 1), 0] <= end_ns))


def _gaps(row: int, body: Body, audit: AuditConfig) -> list[Issue]:
    times, limit = body.track.times_ns, audit.gap_periods * body.track.period_ns
    issues = []
    for k in np.flatnonzero(np.diff(times) > limit).tolist():
        start, end = int(times[k]), int(times[k + 1])
        pause = (end - start) / NS_PER_S
        detail = f"no state for {pause:.6g} s: not judged there"
        issues.append(
            Issue(
                "data_gap",
                (row,),
                start,
                start,
                end,
                pause,
                "s",
                limit / NS_PER_S,
                "ours",
                detail,
                doubtful=False,
            )
        )
    return issues


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


def _teleports(bodies: list[Body], motions: list[Motion], audit: AuditConfig) -> list[Issue]:
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


def _headings(row: int, body: Body, motion: Motion, audit: AuditConfig) -> list[Issue]:
    forward = np.where(body.track.states[:, 3] < 0.0, np.pi, 0.0)
    with np.errstate(invalid="ignore"):
        raw = np.abs(wrap_angle(motion.course_rad - body.track.states[:, 2] - forward))
        # In a tight bend the centre's course is ahead of the heading: that is no contradiction.
        off = np.fmin(raw, np.abs(motion.side_slip_rad))
        wrong = (off > audit.heading_course_rad) & (motion.travel_mps > audit.heading_speed_mps)
    issues = []
    for start, end in _runs(wrong, audit.frozen_samples):
        worst = start + int(np.argmax(off[start:end]))
        detail = f"the heading is {np.degrees(off[worst]):.0f} degrees off the course"
        issues.append(
            Issue(
                "data_heading",
                (row,),
                int(body.track.times_ns[start]),
                int(body.track.times_ns[worst]),
                int(body.track.times_ns[end - 1]),
                float(off[worst]),
                "rad",
                audit.heading_course_rad,
                "ours",
                detail,
            )
        )
    return issues


def _frozen(row: int, body: Body, audit: AuditConfig) -> list[Issue]:
    states = body.track.states
    with np.errstate(invalid="ignore"):
        same = (np.diff(states[:, :3], axis=0, prepend=np.nan) == 0.0).all(axis=1)
        same &= np.abs(states[:, 3]) > audit.moving_mps
    issues = []
    for start, end in _runs(same, audit.frozen_samples):
        since, until = int(body.track.times_ns[start - 1]), int(body.track.times_ns[end - 1])
        speed = float(np.abs(states[start:end, 3]).max())
        detail = f"the pose repeats {end - start} times at {speed:.3g} m/s"
        count = float(end - start)
        issues.append(
            Issue(
                "data_frozen",
                (row,),
                since,
                until,
                until,
                count,
                "samples",
                audit.frozen_samples,
                "ours",
                detail,
            )
        )
    return issues


def _units(row: int, body: Body, motion: Motion, audit: AuditConfig) -> list[Issue]:
    track = body.track
    start, end = int(track.times_ns[0]), int(track.times_ns[-1])
    found: list[tuple[float, str, float, str]] = []
    if (
        body.dimensions_source == "log"
        and not audit.length_least_m <= track.length_m <= audit.length_implausible_m
    ):
        found.append((track.length_m, "m", audit.length_implausible_m, f"a length of {track.length_m:.4g} m"))
    with np.errstate(invalid="ignore", divide="ignore"):
        speed = np.abs(track.states[:, 3])
        fastest = float(np.nanmax(speed, initial=0.0))
        moving = motion.travel_mps > audit.heading_speed_mps
        ratio = float(np.median(speed[moving] / motion.travel_mps[moving])) if moving.any() else np.nan
    if fastest > audit.speed_implausible_mps:
        found.append((fastest, "m/s", audit.speed_implausible_mps, f"a speed of {fastest:.4g} m/s"))
    if ratio < _SPEED_RATIOS[0] or ratio > _SPEED_RATIOS[1]:
        detail = f"recorded speeds are {ratio:.3g} times those of the positions: not in m/s, or not in m"
        found.append((ratio, "", _SPEED_RATIOS[1], detail))
    issues = [
        Issue("data_units", (row,), start, start, end, value, unit, limit, "ours", detail)
        for value, unit, limit, detail in found
    ]
    if body.dimension_change_m > audit.dimension_change_m:
        detail = f"length or width changes by {body.dimension_change_m:.3g} m: the largest is used"
        change = body.dimension_change_m
        issues.append(
            Issue(
                "data_dimensions",
                (row,),
                start,
                start,
                end,
                change,
                "m",
                audit.dimension_change_m,
                "ours",
                detail,
            )
        )
    return issues


def _runs(flags: NDArray[np.bool_], least: int) -> list[tuple[int, int]]:
    """Half-open runs of True of a least length."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= least]
