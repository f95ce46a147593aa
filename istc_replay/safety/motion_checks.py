"""Checks of the continuous motion that the written controls cause."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from istc_replay.datatypes import Certificate, FloatArray, Frame
from istc_replay.geometry import to_frame, to_map
from istc_replay.safety.case import Case, certificate_of
from istc_replay.safety.motion import boxes_of, integrate, speed_extreme_s
from istc_replay.safety.plan import WrittenPlan
from istc_replay.safety.sweep import Least, least_gap, moving_bodies, standing_bodies
from istc_replay.safety.walls import least_inside
from istc_replay.units import NS_PER_S, wrap_angle

#: The planned and the recorded start may be this far apart [m].
START_TOLERANCE_M = 0.05
#: A plan that is handed over may differ from the one before by this, in metres, radians, m/s and m/s^2.
SEAM_TOLERANCE = 1e-3
_SEAM_NS, _SEAM_STEP_S = 1_000, 0.01
#: Largest acceleration of a recorded vehicle; it bounds what lies between two samples [m/s^2].
_RECORDED_ACCELERATION_MPS2 = 10.0
#: What a knot says, what is limited, and their units.
_LIMITED = (
    ("steering", "rad"),
    ("speed", "m/s"),
    ("acceleration", "m/s^2"),
    ("steering rate", "rad/s"),
    ("jerk", "m/s^3"),
)
_KNOT = (
    ("position", "m"),
    ("heading", "rad"),
    ("steering", "rad"),
    ("speed", "m/s"),
    ("acceleration", "m/s^2"),
)


def start(case: Case) -> Certificate:
    """The plan starts where the vehicle was recorded, eq. (8).

    Between two samples the recorded position is known to a t_before t_after / 2 only: what is
    outside of the tolerance by less than that is inconclusive.
    """
    handed = case.plan.handed_over  # these are judged where they were handed over
    unknown, starts = [name for name in case.plan.vehicles if name not in {*case.driven, *handed}], []
    for row, name in enumerate(case.driven):
        if name in handed:
            continue
        plan, track = case.plan.plans[name], case.tracks.get(name)
        time_ns = case.plan.start_ns + int(plan.knots_ns[0])
        recorded = np.full(4, np.nan) if track is None else track.at(np.array([time_ns]))[0]
        away = float(np.hypot(*(to_frame(recorded[:2], case.plan.frame) - plan.states[0, :2])))
        if track is None or not np.isfinite(away):
            unknown.append(name)
            continue
        proven = START_TOLERANCE_M - away
        found = proven + track.sampling_bound_m(time_ns, _RECORDED_ACCELERATION_MPS2)
        detail = f"{away:.4f} m and {plan.states[0, 4] - recorded[3]:.3f} m/s from the recorded start"
        least = Least(proven if proven >= 0.0 else found, proven, row, -1, float(plan.knots_ns[0]) / NS_PER_S)
        starts.append((found >= 0.0, proven, least, detail))  # failures first, then by margin
    _, _, least, detail = min(starts, key=lambda entry: entry[:2], default=(True, 0.0, Least(), ""))
    return certificate_of(
        case, "start", least, vehicles=_names(case, least), detail=detail, unjudged=tuple(unknown)
    )


def seam(case: Case) -> Certificate:
    """A plan that was handed over starts where the plan before has led, in state and controls.

    Position, heading, steering, speed and acceleration must agree; steering rate and jerk are held
    from there on. The tolerance holds with the same number for each in its unit.
    """
    best, quantity, unknown = Least(), 0, []
    before = case.plan.before
    for row, name in enumerate(case.driven):
        if name not in case.plan.handed_over:
            continue
        plan, led = case.plan.plans[name], None
        if before is not None and name in before.plans:
            led = _led_to(before, name, case.plan.start_ns + int(plan.knots_ns[0]), case.plan.frame)
        if led is None:
            unknown.append(name)
            continue
        change = plan.states[0] - led
        change[2] = wrap_angle(change[2])
        off = np.array([np.hypot(*change[:2]), *np.abs(change[2:])])
        column = int(np.argmax(off))
        margin = SEAM_TOLERANCE - float(off[column])
        if margin < best.found:
            best, quantity = Least(margin, margin, row, -1, float(plan.knots_ns[0]) / NS_PER_S), column
    unknown += [
        name for name in case.plan.vehicles if name in case.plan.handed_over and name not in case.driven
    ]
    return certificate_of(
        case,
        "seam",
        best,
        vehicles=_names(case, best),
        detail=f"{SEAM_TOLERANCE - best.found:.2g} {_KNOT[quantity][1]} of {_KNOT[quantity][0]} off",
        unjudged=tuple(unknown),
        unit=_KNOT[quantity][1],
    )


def _led_to(before: WrittenPlan, name: str, time_ns: int, frame: Frame) -> FloatArray | None:
    """The state (6,) of the box centre that a written plan causes at an instant, in another frame."""
    plan, at_ns = before.plans[name], time_ns - before.start_ns
    if not plan.knots_ns[0] - _SEAM_NS <= at_ns <= plan.knots_ns[-1] + _SEAM_NS:
        return None
    knots = np.append(plan.knots_ns[plan.knots_ns < at_ns - _SEAM_NS], at_ns)
    count = len(knots)
    state = plan.states[0]
    if count > 1:
        part = replace(plan, knots_ns=knots, states=plan.states[:count], controls=plan.controls[: count - 1])
        motion = integrate([part], knots, _SEAM_STEP_S, SEAM_TOLERANCE / 10.0)
        if motion is None or not motion.judged[0]:
            return None
        last = motion.nodes[0, -1, -1]
        state = np.concatenate([boxes_of(last[None], motion.dimensions[:1])[0, :3], last[3:]])
    points = to_frame(to_map(state[:2], before.frame), frame)
    return np.array([*points, state[2] + before.frame.yaw_rad - frame.yaw_rad, *state[3:]])


def dynamics(case: Case) -> Certificate:
    """The written knots are those of the bicycle, eq. (17), re-integrated from the first alone.

    The drift tolerance holds for the position in metres, and with the same number for heading,
    steering, speed and acceleration in their units.
    """
    tolerance, largest = case.config.certificate.drift_tolerance_m, np.zeros(5)
    best, quantity = Least(), 0
    for row in np.nonzero(case.motion.judged)[0].tolist():
        plan = case.plan.plans[case.driven[row]]
        change = _at_knots(case, row) - plan.states
        change[:, 2] = wrap_angle(change[:, 2])
        drift = np.column_stack([np.hypot(change[:, 0], change[:, 1]), np.abs(change[:, 2:])])  # (S, 5)
        largest = np.maximum(largest, drift.max(axis=0))
        knot, column = np.unravel_index(int(np.argmax(drift)), drift.shape)
        margin = tolerance - float(drift[knot, column])
        if margin < best.found:
            quantity, proven = int(column), margin - float(case.motion.error_m[row])
            best = Least(margin, proven, int(row), -1, float(plan.knots_ns[knot]) / NS_PER_S)
    drifts = (f"{what} {value:.2g} {unit}" for (what, unit), value in zip(_KNOT, largest, strict=True))
    return certificate_of(
        case,
        "dynamics",
        best,
        vehicles=_names(case, best),
        detail="largest drift of knots: " + ", ".join(drifts),
        unjudged=case.unjudged,
        unit=_KNOT[quantity][1],
    )


def limits(case: Case) -> Certificate:
    """Steering, speed, acceleration and their rates keep eq. (18), over whole steps and at knots.

    Of margins in different units the least in parts of its limit is told.
    """
    low, high = _limits(case)
    tolerance, best, quantity, least_share = case.config.certificate.limit_tolerance, Least(), 0, np.inf
    for row in range(len(case.driven)):
        times_s, samples = _samples(case, row)
        margins = np.minimum(high - samples, samples - low)
        shares = np.where(np.isnan(samples), np.inf, (margins + tolerance) / high)
        sample, column = np.unravel_index(int(np.argmin(shares)), shares.shape)
        if shares[sample, column] < least_share:
            least_share, quantity = float(shares[sample, column]), int(column)
            margin = float(margins[sample, column])
            best = Least(margin, margin, row, -1, float(times_s[sample]))
    name, unit = _LIMITED[quantity]
    return certificate_of(
        case,
        "limits",
        best,
        vehicles=_names(case, best),
        detail=f"{name} nearest its limits {low[quantity]:g} to {high[quantity]:g} {unit}",
        unjudged=case.unjudged,
        allowed=tolerance,
        unit=unit,
    )


def in_corridor(case: Case) -> Certificate:
    """All corners stay in the cube of each closed time unit, eq. (19), in continuous time."""
    tolerance_m = case.config.certificate.tolerance_m
    least = least_inside(case.motion, case.walls_m[case.walled_row], tolerance_m)
    return certificate_of(
        case,
        "in_corridor",
        least,
        vehicles=_names(case, least),
        detail=f"corners {least.found:.6f} m inside, at least {least.proven:.6f} m at all times",
        unjudged=case.unjudged,
        allowed=tolerance_m,
    )


def separation(case: Case) -> Certificate:
    """Two planned boxes stay apart in continuous time, whatever their cubes."""
    limit_m = case.config.certificate.separation_m
    least = least_gap(moving_bodies(case.motion), None, case.motion.edges_s, limit_m, _error_m(case))
    return certificate_of(
        case,
        "separation",
        replace(least, found=least.found - limit_m, proven=least.proven - limit_m),
        vehicles=tuple(case.driven[row] for row in (least.first, least.second) if row >= 0),
        detail=f"boxes {least.found:.6f} m apart, at least {least.proven:.6f} m at all times",
        unjudged=case.unjudged if len(case.plan.vehicles) > 1 else (),
        strict=True,
    )


def obstacle_separation(case: Case) -> Certificate:
    """Planned boxes stay clear of obstacles' boxes in continuous time."""
    obstacles = standing_bodies(case.obstacles_m)
    least = least_gap(moving_bodies(case.motion), obstacles, case.motion.edges_s, 0.0, _error_m(case))
    name = tuple(case.plan.obstacles)[least.second] if least.second >= 0 else ""
    return certificate_of(
        case,
        "obstacle_separation",
        least,
        vehicles=_names(case, least),
        detail=f"box {least.found:.6f} m from {name!r}, at least {least.proven:.6f} m at all times",
        unjudged=(case.unjudged if case.plan.obstacles else ()) + case.misplaced,
        strict=True,
    )


def _names(case: Case, least: Least) -> tuple[str, ...]:
    return (case.driven[least.first],) if least.first >= 0 else ()


def _error_m(case: Case) -> float:
    """What the integration may add to the distance of two boxes."""
    return 2.0 * float(np.max(case.motion.error_m, where=case.motion.judged, initial=0.0))


def _limits(case: Case) -> tuple[FloatArray, FloatArray]:
    """(5,) lowest and (5,) highest values of `_LIMITED`."""
    limit, plan = case.config.trajectories, case.plan
    fastest = max(
        (track.fastest_mps(plan.start_ns, plan.end_ns) for track in case.tracks.values()), default=0.0
    )
    speed = max(limit.speed_max_mps, 1.15 * fastest + 1.0)
    rates = [limit.steering_rate_max_radps, limit.jerk_max_mps3]
    high = [limit.steering_max_rad, speed, limit.acceleration_max_mps2, *rates]
    low = [-limit.steering_max_rad, 0.0, -limit.deceleration_max_mps2, *(-rate for rate in rates)]
    return np.array(low), np.array(high)


def _samples(case: Case, row: int) -> tuple[FloatArray, FloatArray]:
    """Times (m,) and values (m, 5) of `_LIMITED`, NaN where not sampled, of one vehicle.

    Steering and acceleration are linear in a piece and extreme at its ends; the speed also where
    the acceleration is zero.
    """
    motion, plan = case.motion, case.plan.plans[case.driven[row]]
    pieces = np.nonzero(motion.present[row])[0]
    begin, held, length = motion.edges_s[pieces], motion.controls[row, pieces], motion.durations_s[pieces]
    turning = speed_extreme_s(motion.nodes[row, pieces, 0], held, length)
    times, values = [plan.knots_ns / NS_PER_S], [plan.states[:, 3:]]
    for offset in (np.zeros_like(length), length, turning):
        times.append(begin + offset)
        values.append(motion.at(np.full(pieces.size, row), pieces, offset)[:, 3:])
    states = np.concatenate(values)
    rates = np.full((states.shape[0], 2), np.nan)
    rates[plan.knots_ns.size :][: pieces.size] = held
    return np.concatenate(times), np.column_stack([states, rates])


def _at_knots(case: Case, row: int) -> FloatArray:
    """(S, 6) re-integrated states of the box centre at the knots."""
    motion, knots_ns = case.motion, case.plan.plans[case.driven[row]].knots_ns
    piece = np.searchsorted(case.edges_ns, knots_ns[:-1])
    last = np.searchsorted(case.edges_ns, knots_ns[-1]) - 1
    states = np.vstack([motion.nodes[row, piece, 0], motion.nodes[row, last, -1]])
    boxes = boxes_of(states, motion.dimensions[row])
    return np.column_stack([boxes[:, :3], states[:, 3:]])
