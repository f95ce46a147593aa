"""What coordination changed: each planned vehicle against its guidance, in traffic the repaired recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.apart import lateral_excursion_m
from istc_replay.bicycle import dense_motion, in_a_row
from istc_replay.datatypes import Change, FloatArray, Guidance, Trajectory, Window
from istc_replay.geometry import box_poses
from istc_replay.guidance.path import Path
from istc_replay.safety.boxes import box_gap

if TYPE_CHECKING:
    from istc_replay.datatypes import Dimensions, WindowPlan

#: Differences below this are rounding: the plan is the guidance [m].
_SAME_M = 1e-6
#: Distances are told of road users that come this near [m], at instants this far apart [s].
_NEAR_M, _SPACING_S = 30.0, 0.1
#: A plan that is ahead at its end is early by the way at no less than this speed [m/s].
_SLOWEST_MPS = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class _Mover:
    """A vehicle's poses (S, 3) at times (S,), by guidance and as planned."""

    trajectory: Trajectory
    guide: Guidance
    planned: FloatArray

    @property
    def changed(self) -> bool:
        return float(np.hypot(*(self.planned - self.guide.poses)[:, :2].T).max()) > _SAME_M


def changes(plan: WindowPlan) -> tuple[Change, ...]:
    """Tell what coordination changed of each vehicle that has a trajectory, in their order."""
    guidance = {guide.vehicle_id: guide for guide in plan.guidance}
    movers = [
        _Mover(trajectory, guide, _planned_poses(trajectory, guide.times_s))
        for trajectory in plan.trajectories
        if (guide := guidance.get(trajectory.vehicle_id)) is not None
    ]
    if not movers:
        return ()
    by_guidance, as_planned = (_clearances(plan, movers, planned=planned) for planned in (False, True))
    found = []
    for row, mover in enumerate(movers):
        clearance = as_planned[row] if np.isfinite(as_planned[row]) else None
        both = clearance is not None and np.isfinite(by_guidance[row])
        gained = float(as_planned[row] - by_guidance[row]) if both else None
        if gained is not None and abs(gained) <= _SAME_M:
            gained = 0.0
        name, values = mover.trajectory.vehicle_id, _differences(mover) if mover.changed else ()
        told = None if clearance is None else float(clearance)
        found.append(Change(name, mover.changed, *(values or (0.0,) * 5), told, gained))
    return tuple(found)


def _differences(mover: _Mover) -> tuple[float, float, float, float, float]:
    guide, planned = mover.guide, mover.planned
    away = float(np.hypot(*(planned - guide.poses)[:, :2].T).max())
    rms, braking = (
        after - before
        for before, after in zip(
            _comfort(guide.times_s, guide.poses), _comfort(guide.times_s, planned), strict=True
        )
    )
    return _delay_s(guide, planned), away, lateral_excursion_m(mover.trajectory, guide), rms, braking


def _planned_poses(trajectory: Trajectory, times_s: FloatArray) -> FloatArray:
    """Box centres and headings (S, 3) of a plan at the times."""
    size = trajectory.dimensions
    step_s = float(trajectory.times_s[1] - trajectory.times_s[0])
    longest_s = min(step_s, float(times_s[1] - times_s[0]))
    dense, _, spacing_s = dense_motion(
        trajectory.states[0], trajectory.controls, step_s, size.wheelbase_m, longest_s
    )
    states = in_a_row(dense)
    at = trajectory.times_s[0] + np.arange(len(states)) * spacing_s
    columns = box_poses(states, size.rear_axle_to_centre_m).T
    return np.stack([np.interp(times_s, at, column) for column in columns], axis=-1)


def _delay_s(guide: Guidance, planned: FloatArray) -> float:
    """How much later the plan's last place was reached than by guidance."""
    path = Path.through(guide.poses[:, :2], guide.poses[:, 2])
    if path.length_m <= _SAME_M:
        return 0.0
    steps = np.hypot(*np.diff(guide.poses[:, :2], axis=0).T)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    arc, _ = path.project(planned[-1, :2])
    end, heading = guide.poses[-1, :2], guide.poses[-1, 2]
    beyond = float((planned[-1, :2] - end) @ [np.cos(heading), np.sin(heading)])
    if beyond > 0.0:
        return -beyond / max(float(steps[-1] / (guide.times_s[-1] - guide.times_s[-2])), _SLOWEST_MPS)
    reached = min(int(np.searchsorted(way, min(arc, way[-1]))), len(way) - 1)
    before = max(reached - 1, 0)
    share = (arc - way[before]) / max(way[reached] - way[before], _SAME_M)
    when = guide.times_s[before] + np.clip(share, 0.0, 1.0) * (guide.times_s[reached] - guide.times_s[before])
    return float(guide.times_s[-1] - when)


def _comfort(times_s: FloatArray, poses: FloatArray) -> tuple[float, float]:
    """Root mean square acceleration, and hardest braking."""
    if len(times_s) < 3:
        return 0.0, 0.0
    step = float(times_s[1] - times_s[0])
    velocity = np.diff(poses[:, :2], axis=0) / step
    acceleration = np.diff(velocity, axis=0) / step
    along = np.diff(np.hypot(*velocity.T)) / step
    return float(np.sqrt((acceleration**2).sum(axis=1).mean())), float(np.max(-along, initial=0.0))


def _clearances(plan: WindowPlan, movers: list[_Mover], *, planned: bool) -> FloatArray:
    """Least gap (V,) of each mover to any other road user; inf where nobody is near."""
    window = plan.scenario.window
    count = round(window.units * window.unit_s / _SPACING_S) + 1
    times = np.asarray(np.arange(count) * _SPACING_S, dtype=np.float64)
    boxes = np.stack([_boxes(m, times, planned=planned) for m in movers])  # (V, T, 5)
    others = np.concatenate([boxes, _obstacle_boxes(plan, window, times)])
    names = [m.trajectory.vehicle_id for m in movers]
    names += [obstacle.obstacle_id for obstacle in plan.scenario.obstacles]
    least = np.full(len(movers), np.inf)
    for row in range(len(movers)):
        apart = np.hypot(*np.moveaxis(others[:, :, :2] - boxes[row, :, :2], -1, 0))
        # A vehicle that enters or leaves within a unit is an obstacle there, but never to itself.
        apart[[name == names[row] for name in names]] = np.nan
        reach = np.hypot(others[:, :, 3], others[:, :, 4]) / 2.0
        who, when = np.nonzero(apart - reach < _NEAR_M)
        gaps = box_gap(boxes[row, when], others[who, when])
        least[row] = np.min(gaps, where=np.isfinite(gaps), initial=np.inf)
    return least


def _boxes(mover: _Mover, times_s: FloatArray, *, planned: bool) -> FloatArray:
    """Boxes (T, 5) at the times, NaN outside of the plan."""
    guide, size = mover.guide, mover.trajectory.dimensions
    poses = mover.planned if planned else guide.poses
    at = np.stack([np.interp(times_s, guide.times_s, column) for column in poses.T], axis=-1)
    inside = (times_s >= guide.times_s[0] - 1e-9) & (times_s <= guide.times_s[-1] + 1e-9)
    return np.column_stack([np.where(inside[:, None], at, np.nan), _spread(size, len(times_s))])


def _spread(size: Dimensions, count: int) -> FloatArray:
    return np.broadcast_to([size.length_m, size.width_m], (count, 2))


def _obstacle_boxes(plan: WindowPlan, window: Window, times_s: FloatArray) -> FloatArray:
    """Boxes (O, T, 5) of the obstacles: what they sweep in the unit of each time."""
    unit = np.minimum((times_s / window.unit_s).astype(int), window.units - 1)
    found = [np.empty((0, len(times_s), 5))]
    for obstacle in plan.scenario.obstacles:
        x_min, x_max, y_min, y_max = obstacle.boxes_m[unit].T
        straight = np.zeros_like(x_min)
        rows = [(x_min + x_max) / 2.0, (y_min + y_max) / 2.0, straight, x_max - x_min, y_max - y_min]
        found.append(np.stack(rows, axis=-1)[None])
    return np.concatenate(found)
