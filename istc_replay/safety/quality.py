"""Data quality of recorded states: what is wrong with the data comes before what is judged by it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from istc_replay.config import AuditConfig
from istc_replay.safety.bodies import Body
from istc_replay.safety.clocks import Clock
from istc_replay.safety.issues import Issue
from istc_replay.safety.jumps import teleport_issues
from istc_replay.safety.pair_samples import Pairs
from istc_replay.safety.vehicle_samples import Motion
from istc_replay.units import NS_PER_S, wrap_angle

IntArray = NDArray[np.int64]

#: Recorded speed over travelled speed beyond these is no noise, but another unit.
_SPEED_RATIOS = (0.5, 2.0)


def body_issues(bodies: list[Body], motions: list[Motion], audit: AuditConfig) -> list[Issue]:
    """Gaps, teleports, exchanged names, contradicting headings, frozen poses, implausible units."""
    issues = teleport_issues(bodies, motions, audit)
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
