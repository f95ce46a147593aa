"""Checks of the corridor-cubes, from their coordinates; never from a solver's binaries."""

from __future__ import annotations

import numpy as np

from istc_replay.datatypes import Certificate, FloatArray, Frame
from istc_replay.safety.case import Case, certificate_of
from istc_replay.safety.motion import boxes_of
from istc_replay.safety.sweep import Least
from istc_replay.safety.walls import least_inside, wall_margin

#: A yaw this near to a quarter turn keeps the map's bounds axis-aligned in the corridor frame.
_ALIGNED = 1e-12
#: Stands for an open side of the map, so that differences stay finite [m].
_FAR_M = 1e12


def cubes_disjoint(case: Case) -> Certificate:
    """Cubes of two vehicles at one time are the promised gap apart along an axis, eq. (5)."""
    promised = case.plan.vehicle_gap_m
    if promised is None:
        promised = case.config.corridors.vehicle_gap_m
    least, piece = _least_separation(case, None, promised)
    unit = case.units[least.first, piece] if piece >= 0 else -1
    return certificate_of(
        case,
        "cubes_disjoint",
        least,
        vehicles=tuple(case.walled[row] for row in (least.first, least.second) if row >= 0),
        detail=f"unit {unit}: cubes {least.found + promised:.6f} m apart, promised {promised:g} m",
        unjudged=case.unwalled if len(case.plan.vehicles) > 1 else (),
        allowed=case.config.certificate.tolerance_m,
    )


def obstacles_clear(case: Case) -> Certificate:
    """Cubes keep the promised gap from obstacles along an axis, eq. (6)."""
    promised, obstacles = case.plan.obstacle_gap_m, tuple(case.plan.obstacles)
    if promised is None:
        promised = case.config.corridors.obstacle_gap_m
    least, piece = _least_separation(case, case.obstacles_m, promised)
    unit, name = (case.units[least.first, piece], obstacles[least.second]) if piece >= 0 else (-1, "")
    return certificate_of(
        case,
        "obstacles_clear",
        least,
        vehicles=(case.walled[least.first],) if least.first >= 0 else (),
        detail=f"unit {unit}: cube {least.found + promised:.6f} m from {name!r}, promised {promised:g} m",
        unjudged=(case.unwalled if obstacles else ()) + case.misplaced,
        allowed=case.config.certificate.tolerance_m,
    )


def in_bounds(case: Case) -> Certificate:
    """The cubes are within the map; where the corridor frame is turned, the moving boxes are."""
    bounds, frame = case.bounds, case.plan.frame
    if bounds is None:
        return certificate_of(case, "in_bounds", Least(), vehicles=(), detail="")
    tolerance_m = case.config.certificate.tolerance_m
    walls = np.clip([bounds.x_min_m, bounds.x_max_m, bounds.y_min_m, bounds.y_max_m], -_FAR_M, _FAR_M)
    names, unjudged, what = case.walled, case.unwalled, "cube"
    if not np.isfinite(walls).all():
        least = Least(np.nan, np.nan)
    elif abs(np.sin(2.0 * frame.yaw_rad)) < _ALIGNED:
        least = _least_within(case, _quarter_turned(walls, frame))
    else:
        names, unjudged, what = case.driven, case.unjudged, "box"
        spread = np.broadcast_to(walls, (*case.motion.present.shape, 4))
        least = least_inside(case.motion, spread, tolerance_m, frame)
    return certificate_of(
        case,
        "in_bounds",
        least,
        vehicles=(names[least.first],) if least.first >= 0 else (),
        detail=f"{what} {least.found:.6f} m inside the map",
        unjudged=unjudged,
        allowed=tolerance_m,
    )


def cubes_overlap(case: Case) -> Certificate:
    """At each switch of units the box lies in both cubes, eq. (11) read with its signs right."""
    motion, least = case.motion, Least()
    walls, units = case.walls_m[case.walled_row], case.units[case.walled_row]
    switch = (units[:, :-1] != units[:, 1:]) & (units[:, :-1] >= 0) & (units[:, 1:] >= 0)
    rows, pieces = np.nonzero(switch & motion.judged[:, None])
    if rows.size:
        before, after = walls[rows, pieces], walls[rows, pieces + 1]
        common = np.where([True, False, True, False], np.maximum(before, after), np.minimum(before, after))
        margins = wall_margin(boxes_of(motion.nodes[rows, pieces, -1], motion.dimensions[rows]), common)
        worst = int(np.argmin(margins))
        proven = float(np.min(margins - motion.error_m[rows]))
        least = Least(
            float(margins[worst]), proven, int(rows[worst]), -1, case.seconds(int(pieces[worst]) + 1)
        )
    return certificate_of(
        case,
        "cubes_overlap",
        least,
        vehicles=(case.driven[least.first],) if least.first >= 0 else (),
        detail=f"box {least.found:.6f} m inside the overlap of consecutive cubes",
        unjudged=case.unjudged,
        allowed=case.config.certificate.tolerance_m,
    )


def _least_separation(case: Case, others_m: FloatArray | None, promised_m: float) -> tuple[Least, int]:
    """Least separation of cubes from other boxes (None: from each other) less the promise; the piece."""
    best, at = Least(), -1
    for row, walls in enumerate(case.walls_m):
        begin = row + 1 if others_m is None else 0
        others = (case.walls_m if others_m is None else others_m)[begin:]
        apart = np.maximum(walls[..., 0::2] - others[..., 1::2], others[..., 0::2] - walls[..., 1::2])
        separation = apart.max(axis=-1) - promised_m  # (B, P), NaN where either is absent
        least = np.min(separation, where=~np.isnan(separation), initial=np.inf)
        if least < best.found:
            other, piece = np.unravel_index(int(np.nanargmin(separation)), separation.shape)
            at = int(piece)
            best = Least(float(least), float(least), row, begin + int(other), case.seconds(at))
    return best, at


def _quarter_turned(walls_m: FloatArray, frame: Frame) -> FloatArray:
    """Walls of the map frame in a corridor frame that is a quarter turn or more from it, exactly."""
    c, s = np.round(np.cos(frame.yaw_rad)), np.round(np.sin(frame.yaw_rad))
    x, y = walls_m[:2] - frame.x_m, walls_m[2:] - frame.y_m
    return np.concatenate([np.sort(c * x + s * y), np.sort(c * y - s * x)])


def _least_within(case: Case, bounds_m: FloatArray) -> Least:
    """Least distance of the cubes inward from the bounds x_min, x_max, y_min, y_max."""
    inward = ((case.walls_m - bounds_m) * [1.0, -1.0, 1.0, -1.0]).min(axis=-1)  # (C, P)
    least = float(np.min(inward, where=~np.isnan(inward), initial=np.inf))
    if least == np.inf:
        return Least()
    row, piece = np.unravel_index(int(np.nanargmin(inward)), inward.shape)
    return Least(least, least, int(row), -1, case.seconds(int(piece)))
