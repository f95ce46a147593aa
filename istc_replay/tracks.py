"""What of a recorded track can be planned, in whole time units; and what it sweeps in each."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import polars as pl
from numpy.typing import NDArray

from istc_replay.datatypes import Exclusion, FloatArray, Window, read_only
from istc_replay.geometry import box_corners, rotate, to_frame
from istc_replay.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from istc_replay.config import WindowConfig

#: A recording with a hole longer than this many median sample periods is not planned across it.
HOLE_PERIODS = 3.0
_LEAST_HOLE_S = 0.5
#: Columns of a pose, and of a vehicle's size.
_POSE = ("x_m", "y_m", "heading_rad")
_SIZES = ("length_m", "width_m", "wheelbase_m", "rear_axle_to_centre_m")
#: Backing up faster than this is driving in reverse, which eq. (18) does not know.
_REVERSING_MPS = -0.5
#: Rounding in times [s].
_INSTANT_S = 1e-9
#: A turn is measured over this much way [m].
_TURN_OVER_M = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class UsableTrack:
    """A usable part of a track: whole units, times from the window's start, corridor frame."""

    first_unit: int
    units: int
    times_s: FloatArray  # (S,)
    poses: FloatArray  # (S, 3)
    speeds_mps: FloatArray  # (S,)

    def turned(self, yaw_rad: float) -> UsableTrack:
        """The track in a frame turned by an angle."""
        return replace(self, poses=turned_poses(self.poses, yaw_rad))

    def at_units(self, unit_s: float) -> FloatArray:
        """Poses (K+1, 3) at the unit boundaries."""
        at = np.arange(self.first_unit, self.first_unit + self.units + 1) * unit_s
        return np.stack([np.interp(at, self.times_s, column) for column in self.poses.T], axis=-1)


def turned_poses(poses: FloatArray, yaw_rad: float) -> FloatArray:
    """Poses (S, 3) in a frame that is turned by an angle."""
    return read_only(np.column_stack([rotate(poses[:, :2], -yaw_rad), poses[:, 2] - yaw_rad]))


@dataclass(frozen=True, slots=True, eq=False)
class RoadUser:
    """What a log tells of a road user around one window, map frame.

    `times_ns` (S,) increasing, `poses` (S, 3) x, y, unwrapped heading, and `speeds_mps` (S,) are of
    the states with position and heading; a speed is NaN where it is unknown. `missing` names a
    column that no state has. `sizes` are the first that are told, by the name of the column. `seen_ns`
    (M,) are the times of all its states.
    """

    vehicle_id: str
    seen_ns: NDArray[np.int64]
    times_ns: NDArray[np.int64]
    poses: FloatArray
    speeds_mps: FloatArray
    missing: str
    role: str
    sizes: Mapping[str, float]

    def present(self, start_ns: int, end_ns: int) -> bool:
        """Whether it is seen within a span of time.

        One that is seen there at the first or the last instant alone, and before or after it too, is of the
        window before or of the next.
        """
        first, last = int(self.seen_ns.min()), int(self.seen_ns.max())
        if (first < start_ns and last == start_ns) or (last > end_ns and first == end_ns):
            return False
        return bool(((self.seen_ns >= start_ns) & (self.seen_ns <= end_ns)).any())

    def in_frame(self, window: Window) -> tuple[FloatArray, FloatArray]:
        """Times (S,) [s from the window's start] and poses (S, 3) in the corridor frame."""
        times = (self.times_ns - window.start_ns) / NS_PER_S
        points = to_frame(self.poses[:, :2], window.frame)
        return times, np.column_stack([points, self.poses[:, 2] - window.frame.yaw_rad])


def road_users(states: pl.DataFrame) -> dict[str, RoadUser]:
    """Sort the states of a part of a log by road user."""
    names, rows = np.unique(np.array(states["vehicle_id"].to_list(), dtype=object), return_inverse=True)
    order = np.argsort(rows, kind="stable")
    ends = np.searchsorted(rows[order], np.arange(1, len(names) + 1))
    columns = {name: states[name].cast(pl.Float64).to_numpy() for name in (*_POSE, "speed_mps", *_SIZES)}
    nulls = {name: states[name].is_null().to_numpy() for name in _POSE}
    times, roles = states["time_ns"].to_numpy(), states["role"].to_list()
    found = {}
    for name, own in zip(names.tolist(), np.split(order, ends[:-1]), strict=True):
        found[name] = _road_user(name, own, times, columns, nulls, [roles[row] for row in own.tolist()])
    return found


def _road_user(
    name: str,
    rows: NDArray[np.int64],
    times_ns: NDArray[np.int64],
    columns: Mapping[str, FloatArray],
    nulls: Mapping[str, NDArray[np.bool_]],
    roles: list[str | None],
) -> RoadUser:
    poses = np.stack([columns[column][rows] for column in _POSE], axis=-1)
    known = np.isfinite(poses).all(axis=1)
    times, first = np.unique(times_ns[rows][known], return_index=True)
    poses = poses[known][first]
    poses[:, 2] = np.unwrap(poses[:, 2])
    sizes = {}
    for column in _SIZES:
        told = columns[column][rows]
        told = told[np.isfinite(told) & ((told > 0.0) | (column == "rear_axle_to_centre_m"))]
        if told.size:
            sizes[column] = float(told[0])
    odd = any(role in ("pedestrian", "bicycle", "other") for role in roles)
    return RoadUser(
        vehicle_id=name,
        seen_ns=times_ns[rows],
        times_ns=times,
        poses=poses,
        speeds_mps=columns["speed_mps"][rows][known][first],
        missing=next((column for column in _POSE if nulls[column][rows].all()), ""),
        role=(roles[0] or "other") if odd else "vehicle",
        sizes=sizes,
    )


def usable_track(
    user: RoadUser, window: Window, config: WindowConfig, *, traffic: bool
) -> UsableTrack | Exclusion:
    """Cut a track to the whole units in which it can be planned, or tell why it cannot.

    In `traffic` it must also be recorded often enough, agree with its own speed, and not reverse.
    """
    if user.missing:
        reason = "missing_heading" if user.missing == "heading_rad" else "missing_position"
        return Exclusion(user.vehicle_id, reason, f"no state has {user.missing}")
    if len(user.times_ns) < 2:
        detail = f"{len(user.times_ns)} usable state(s) in the window; two are needed"
        return Exclusion(user.vehicle_id, "one_sample", detail)
    if not np.isfinite(user.speeds_mps).all():
        return Exclusion(user.vehicle_id, "missing_speed", "no speed is recorded, and none can be derived")
    times, poses = user.in_frame(window)
    usable = _unbroken(user, times, poses, window, config)
    fault = _fault(usable, times, user.vehicle_id, config) if traffic else None
    return fault or usable


def _unbroken(
    user: RoadUser, times: FloatArray, poses: FloatArray, window: Window, config: WindowConfig
) -> UsableTrack | Exclusion:
    vehicle_id = user.vehicle_id
    periods = np.diff(times)
    # A hole that lies outside the window is none of its business.
    periods[(times[1:] <= 0.0) | (times[:-1] >= window.units * window.unit_s)] = 0.0
    hole = int(np.argmax(periods))
    if periods[hole] > max(HOLE_PERIODS * float(np.median(np.diff(times))), _LEAST_HOLE_S):
        return Exclusion(
            vehicle_id, "hole", f"nothing recorded for {periods[hole]:.2f} s from {times[hole]:.2f} s on"
        )
    first_unit = max(0, math.ceil(times[0] / window.unit_s - 1e-9))
    end_unit = min(window.units, math.floor(times[-1] / window.unit_s + 1e-9))
    if end_unit - first_unit < min(config.minimum_presence_units, window.units):
        return Exclusion(
            vehicle_id, "short_presence", f"present for {max(0, end_unit - first_unit)} whole time units"
        )
    boundaries = np.arange(first_unit, end_unit + 1) * window.unit_s
    at = np.union1d(times[(times > boundaries[0]) & (times < boundaries[-1])], boundaries)
    return UsableTrack(
        first_unit,
        end_unit - first_unit,
        read_only(at),
        read_only(np.stack([np.interp(at, times, column) for column in poses.T], axis=-1)),
        read_only(np.interp(at, times, user.speeds_mps)),
    )


def _fault(
    usable: UsableTrack | Exclusion, times: FloatArray, vehicle_id: str, config: WindowConfig
) -> Exclusion | None:
    """What of recorded traffic is not fit to be planned: too rare, contradictory, in reverse."""
    if isinstance(usable, Exclusion):
        return None
    rate = 1.0 / float(np.median(np.diff(times)))
    if rate < config.minimum_rate_hz:
        return Exclusion(vehicle_id, "low_rate", f"recorded {rate:.2f} times a second")
    if float(usable.speeds_mps.min()) < _REVERSING_MPS:
        return Exclusion(vehicle_id, "reversing", f"drives at {usable.speeds_mps.min():.2f} m/s")
    seconds = np.diff(usable.times_s)
    moved = np.hypot(*np.diff(usable.poses[:, :2], axis=0).T)
    told = (usable.speeds_mps[1:] + usable.speeds_mps[:-1]) / 2.0 * seconds
    mismatch = abs(float(moved.sum() - told.sum())) / float(seconds.sum())
    if mismatch > config.speed_mismatch_mps:
        detail = f"its speed and its motion differ by {mismatch:.2f} m/s on average"
        return Exclusion(vehicle_id, "speed_mismatch", detail)
    return None


def tightest_radius_m(poses: FloatArray) -> float:
    """Least radius [m] at which recorded poses (S, 3) turn, over two metres of way; inf where they do not."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    if way[-1] < _TURN_OVER_M:
        return math.inf
    begin = np.append(way[way < way[-1] - _TURN_OVER_M], way[-1] - _TURN_OVER_M)
    turned = np.interp(begin + _TURN_OVER_M, way, poses[:, 2]) - np.interp(begin, way, poses[:, 2])
    most = float(np.abs(turned).max())
    return _TURN_OVER_M / most if most > 0.0 else math.inf


def swept_boxes(
    times_s: FloatArray, poses: FloatArray, size_m: tuple[float, float], window: Window
) -> FloatArray:
    """Boxes (N, 4) of what a road user sweeps in each unit of the window, NaN where absent.

    Where it is recorded on both sides of a unit's boundary its pose there is interpolated.
    """
    boundaries = np.arange(window.units + 1) * window.unit_s
    known = (boundaries >= times_s[0] - _INSTANT_S) & (boundaries <= times_s[-1] + _INSTANT_S)
    inside = boundaries[known]
    at = np.union1d(times_s, inside)
    sampled = np.stack([np.interp(at, times_s, column) for column in poses.T], axis=-1)
    corners = box_corners(sampled[:, 0], sampled[:, 1], sampled[:, 2], *size_m)  # (S, 4, 2)
    # A unit is swept by the samples from its start to its end, if there is more than an instant of them.
    first = np.searchsorted(at, boundaries[:-1] - _INSTANT_S)
    end = np.searchsorted(at, boundaries[1:] + _INSTANT_S, side="right")
    last = np.searchsorted(at, boundaries[1:] - _INSTANT_S)  # those before the unit's end
    after = np.searchsorted(at, boundaries[:-1] + _INSTANT_S, side="right")  # those past its start
    swept = np.flatnonzero((end - first >= 2) | (last > after))
    boxes = np.full((window.units, 4), np.nan)
    if swept.size:
        spans = np.stack([first[swept], np.minimum(end[swept], len(at))], axis=-1).ravel()
        low, high = corners.min(axis=1), corners.max(axis=1)  # (S, 2)
        padded = [np.vstack([side, side[-1:]]) for side in (low, high)]  # reduceat wants ends in range
        boxes[swept, 0::2] = np.minimum.reduceat(padded[0], spans)[::2]
        boxes[swept, 1::2] = np.maximum.reduceat(padded[1], spans)[::2]
    return read_only(boxes)
