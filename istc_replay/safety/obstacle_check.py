"""Whether the obstacles that a plan keeps clear of are those that there are."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from istc_replay.datatypes import Certificate, FloatArray
from istc_replay.geometry import box_corners, to_frame
from istc_replay.safety.case import Case, certificate_of
from istc_replay.safety.plan import IntArray
from istc_replay.safety.sweep import Least


def obstacles_known(case: Case) -> Certificate:
    """The scene's obstacles, and road users that stay as recorded, are in the plan's obstacle boxes.

    A standing obstacle is covered in every time unit, a road user's recorded centre at every
    sample. What has no box where it should is missing by an infinite margin.
    """
    names = tuple(case.plan.obstacles)
    rows = {name: row for row, name in enumerate(names)}
    least, whose = Least(), ""
    for name, margins, times_s in _covered(case, rows):
        if margins.size and float(margins.min()) < least.found:
            worst = int(np.argmin(margins))
            least = Least(float(margins[worst]), float(margins[worst]), -1, -1, float(times_s[worst]))
            whose = name
    missing = "is missing from" if least.found == -np.inf else f"{-least.found:.6f} m out of"
    return certificate_of(
        case,
        "obstacles_known",
        least,
        vehicles=(whose,) if least.found < -case.config.certificate.tolerance_m else (),
        detail=f"{whose!r} {missing} the plan's obstacles"
        if least.found < 0.0
        else f"all are inside the plan's obstacles, {whose!r} by {least.found:.6f} m",
        unjudged=case.misplaced,
        allowed=case.config.certificate.tolerance_m,
    )


def _covered(case: Case, rows: dict[str, int]) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Of each that should be covered: its name, margins inside its boxes, and when [s]."""
    starts = case.edges_ns[:-1] / 1e9
    for o in case.scene.obstacles:
        corners = to_frame(box_corners(o.x_m, o.y_m, o.heading_rad, o.length_m, o.width_m), case.plan.frame)
        pieces = np.arange(starts.size)
        yield o.obstacle_id, _inside(case, rows.get(o.obstacle_id), pieces, corners[None]), starts
    for name in case.plan.as_recorded:
        track = case.tracks.get(name)
        if track is None:
            continue
        times = track.times_ns - case.plan.start_ns
        own = (times >= case.edges_ns[0]) & (times <= case.edges_ns[-1])
        times, points = times[own], to_frame(track.states[own, :2], case.plan.frame)
        # Units are closed: at a boundary either box will do.
        either = [
            _inside(case, rows.get(name), _pieces(case, times, side), points[:, None])
            for side in ("left", "right")
        ]
        yield name, np.maximum(*either), times / 1e9


def _pieces(case: Case, times_ns: IntArray, side: str) -> IntArray:
    found = np.searchsorted(case.edges_ns, times_ns, side=side) - 1  # type: ignore[call-overload]
    return np.asarray(np.clip(found, 0, case.edges_ns.size - 2))


def _inside(case: Case, row: int | None, pieces: IntArray, points: FloatArray) -> FloatArray:
    """(n,) least margin of points (n or 1, m, 2) inside an obstacle's box of each piece; -inf without one."""
    if row is None:
        return np.full(pieces.size, -np.inf)
    x_min, x_max, y_min, y_max = case.obstacles_m[row, pieces].T[:, :, None]
    x, y = points[..., 0], points[..., 1]
    margins = np.minimum.reduce([x - x_min, x_max - x, y - y_min, y_max - y]).min(axis=1)
    return np.where(np.isnan(margins), -np.inf, margins)
