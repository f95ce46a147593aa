"""Check of recorded traffic: plans stay on the road, or near the recorded path."""

from __future__ import annotations

import numpy as np

from istc_replay.datatypes import Certificate, FloatArray
from istc_replay.geometry import to_map
from istc_replay.lateral import AT_EDGE_M, PATH, RECORDING, ROAD, lateral, lateral_bound
from istc_replay.road import Road, scene_near
from istc_replay.safety.case import Case, certificate_of
from istc_replay.safety.motion import boxes_of
from istc_replay.safety.recorded import Track
from istc_replay.safety.sweep import Least
from istc_replay.units import seconds_to_ns

#: Instants that are looked at are no farther apart [s]; between two of them a point of the box leaves the
#: straight way by an eighth of its largest acceleration [m/s^2] by the square of it.
_STEP_S, _ACCELERATION_MPS2 = 0.05, 12.0
#: The path that was recorded so long before and after the window is looked at [s].
_BEFORE_S, _AFTER_S = 20.0, 2.0
#: The layers tell a recording at the edge from one beside it a little earlier [m].
_EDGE_DOUBT_M = 0.05
_WHAT = {
    ROAD: "on the road's side of its edge",
    PATH: "within its distance from the recorded path",
    RECORDING: "within its distance from the recorded path, which is at the road's edge",
}


def lateral_kept(case: Case) -> Certificate:
    """In traffic, the box stays on the road where lanes or edges tell of it, else near its recorded path.

    What is told of the road is looked at from the recorded path: a plan that leaves the road is one
    that goes farther from the path than the road does. Where the recording itself is at the edge or
    beyond it, or nothing is told, the centre stays near the path.
    """
    best, detail, unknown = Least(), "", []
    rows = np.nonzero(case.motion.judged)[0].tolist() if case.plan.traffic else []
    paths = {row: _path(case, case.tracks.get(case.driven[row])) for row in rows}
    points = np.concatenate([path[:, :2] for path in paths.values()]) if rows else np.empty((0, 2))
    road = Road.of(scene_near(case.scene, points)) if len(points) else None
    for row, path in paths.items():
        name = case.driven[row]
        times, boxes = _boxes(case, row)
        if not len(path):
            unknown.append(name)
            continue
        size = (float(boxes[0, 3]), float(boxes[0, 4]))
        settings = case.config.corridors
        bound = lateral_bound(path, size, road, settings.lateral_m, AT_EDGE_M + _EDGE_DOUBT_M)
        poses = np.column_stack(
            [to_map(boxes[:, :2], case.plan.frame), boxes[:, 2] + case.plan.frame.yaw_rad]
        )
        kept = lateral(name, bound, poses, size)
        proven = kept.margin_m - _ACCELERATION_MPS2 * _STEP_S**2 / 8.0 - float(case.motion.error_m[row])
        if kept.margin_m < best.found:
            best = Least(kept.margin_m, proven, row, -1, float(times[kept.sample]))
            detail = f"{kept.margin_m:.3f} m {_WHAT[kept.bound]}, {kept.excursion_m:.2f} m from it at most"
            if kept.off_road_m > 0.0:
                detail += f"; as recorded {kept.off_road_m:.2f} m off the road"
    if rows:
        unknown += case.unjudged
    return certificate_of(
        case,
        "lateral",
        best,
        vehicles=(case.driven[best.first],) if best.first >= 0 else (),
        detail=detail,
        unjudged=tuple(unknown),
    )


def _boxes(case: Case, row: int) -> tuple[FloatArray, FloatArray]:
    """Instants (T,) and boxes (T, 5) of a vehicle, every piece of time from its start to its end."""
    motion = case.motion
    pieces = np.nonzero(motion.present[row])[0]
    count = max(1, int(np.ceil(float(motion.durations_s[pieces].max(initial=0.0)) / _STEP_S - 1e-9)))
    piece = np.repeat(pieces, count + 1)
    offset = (motion.durations_s[pieces][:, None] * np.linspace(0.0, 1.0, count + 1)).ravel()
    states = motion.at(np.full(piece.size, row), piece, offset)
    return motion.edges_s[piece] + offset, boxes_of(states, motion.dimensions[row])


def _path(case: Case, track: Track | None) -> FloatArray:
    """Recorded poses (S, 3) of a vehicle about the window, map frame."""
    if track is None:
        return np.empty((0, 3))
    first, last = case.plan.start_ns - seconds_to_ns(_BEFORE_S), case.plan.end_ns + seconds_to_ns(_AFTER_S)
    inside = (track.times_ns >= first) & (track.times_ns <= last)
    poses = track.states[inside, :3]
    return poses[np.isfinite(poses).all(axis=1)]
