"""The unsignalised intersection of the paper, Sec. V-A.

Two roads of 10 m (a lane of 5 m each way) cross at the origin. Vehicle 1 drives straight on
eastbound, vehicle 2 straight on northbound, and vehicle 3 comes from the east and turns left, to
the south. At 5 m/s each, all three meet in the middle.
"""

from __future__ import annotations

import math

import numpy as np

from istc_replay.datatypes import Dimensions, LaneLine, StaticScene, VehicleInfo, read_only
from istc_replay.guidance.curves import Curve, Pose, smooth_curve
from istc_replay.samples.drive import Drive, RecordedScene, box_centres, record_drives
from istc_replay.samples.pace import Pace

#: Vehicles of the paper: 4 m x 2 m, wheelbase 2.7 m, equal overhangs.
CAR = Dimensions(length_m=4.0, width_m=2.0, wheelbase_m=2.7, rear_axle_to_centre_m=1.35)
START_NS = 1_700_000_000_000_000_000

_SPEED_MPS = 5.0
_DURATION_S = 10
_LANE_M = 2.5  # from the road's middle to the lane's
_REACH_M = 60.0  # lanes go this far from the middle
_TURN_RADIUS_M = 7.0
_TURN_RAMP_M = 4.0
_LINE_STEP_M = 0.25
#: Where the box centres start, along their lanes, as distance to the middle of the other road.
#: Chosen so that all pairs collide and the paper's findings show; elsewhere they often do not
#: (docs/method.md).
_START_M = {"1": 21.0, "2": 21.0, "3": 20.0}


def intersection(name: str, priorities: dict[str, float]) -> RecordedScene:
    """Record the intersection with these priority weights eta by vehicle (Table II)."""
    axle = CAR.rear_axle_to_centre_m
    paths = {
        "1": _straight(Pose(-_REACH_M - axle, -_LANE_M, 0.0)),
        "2": _straight(Pose(_LANE_M, -_REACH_M - axle, math.pi / 2)),
        "3": _left_turn(Pose(_REACH_M + axle, _LANE_M, math.pi)),
    }
    scene = StaticScene(
        lane_lines=tuple(_lane_line(vehicle, path) for vehicle, path in paths.items()),
        vehicles=tuple(VehicleInfo(vehicle, priorities[vehicle], CAR) for vehicle in paths),
    )
    drives = [
        Drive(vehicle, CAR, path, Pace(_SPEED_MPS), _REACH_M - _START_M[vehicle])
        for vehicle, path in paths.items()
    ]
    return record_drives(name, scene, drives, START_NS, _DURATION_S)


def _straight(start: Pose) -> Curve:
    return Curve(start, read_only([0.0, 2.0 * _REACH_M]), read_only([0.0, 0.0]))


def _left_turn(start: Pose) -> Curve:
    """A quarter turn whose end lies on the lane that leads away at right angles."""
    angle = math.pi / 2
    arc_m, kappa = _TURN_RADIUS_M * angle, 1.0 / _TURN_RADIUS_M
    alone = smooth_curve(Pose(0.0, 0.0, 0.0), [arc_m], [kappa], _TURN_RAMP_M)
    # Both tangents of the turn have this length, up to the crossing of the two lanes' lines.
    tangent_m = float(alone.points([alone.length_m])[0, 0])
    to_crossing_m = start.x_m + _LANE_M
    after_m = _REACH_M + _LANE_M - tangent_m - CAR.rear_axle_to_centre_m
    lengths = [to_crossing_m - tangent_m, arc_m, after_m]
    return smooth_curve(start, lengths, [0.0, kappa, 0.0], _TURN_RAMP_M)


def _lane_line(vehicle_id: str, path: Curve) -> LaneLine:
    """The line that the box centre follows, with points close together where it bends."""
    bent = np.flatnonzero(path.curvatures_1pm)
    along = [0.0, path.length_m]
    if bent.size:
        first, last = path.breaks_m[bent[0] - 1], path.breaks_m[bent[-1] + 1]
        bend = np.linspace(first, last, math.ceil((last - first) / _LINE_STEP_M) + 1)
        along = [0.0, *bend, path.length_m]
    centres = box_centres(path.poses(along), CAR)
    return LaneLine(f"lane_{vehicle_id}", read_only(np.round(centres, 6) + 0.0, columns=2), vehicle_id)
