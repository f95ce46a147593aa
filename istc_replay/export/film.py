"""What moves in a result, cut into frames: which vehicles and boxes are there at which instants."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import polars as pl

from istc_replay.config import VehiclesConfig
from istc_replay.datatypes import Dimensions, FloatArray, Log, Window, WindowPlan
from istc_replay.export.colours import OBSTACLE, RECORDED, Colour, vehicle_colour
from istc_replay.export.placing import (
    IntArray,
    PlannedMotion,
    planned_motions,
    topic_name,
    unit_span_ns,
)
from istc_replay.geometry import to_map

#: Frames stand at least this far apart; further where they would hold too many cars.
_SPACING_NS = 50_000_000
_CARS_FLOOR = 100_000
_CARS_PER_STATE = 4
#: Frames worked on at once.
_FRAMES = 512
#: How long a vehicle of a single state is shown.
_INSTANT_NS = 100_000_000
#: A step longer than this many median steps is a gap, in which the vehicle is not shown.
_GAP_STEPS = 3.0
LAST_NS = 2**63 - 1


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """An unbroken motion and its looks: `times_ns` (S,), `poses` (S, 3) in the map frame.

    It is to be seen from the first of its times until before `end_ns`.
    """

    entity_id: str
    frame_id: str
    label: str
    colour: Colour
    opacity: float
    length_m: float
    width_m: float
    planned: bool
    times_ns: IntArray
    poses: FloatArray
    end_ns: int


class Block(NamedTuple):
    """A box that is to be seen from start_ns until before end_ns; `pose` is x, y, yaw in the map frame."""

    entity_id: str
    start_ns: int
    end_ns: int
    pose: tuple[float, float, float]
    length_m: float
    width_m: float
    height_m: float
    colour: Colour
    opacity: float


class Frame(NamedTuple):
    """What is to be seen from `time_ns` on; a car is (track, [x, y, heading], lifetime_ns)."""

    time_ns: int
    cars: list[tuple[Track, list[float], int]]
    blocks: list[Block]


@dataclass(frozen=True, slots=True, eq=False)
class Film:
    """The instants of the frames, the motions shown, and each plan's vehicle, start and end [ns]."""

    times_ns: IntArray
    tracks: Sequence[Track]
    planned: Sequence[tuple[str, int, int]]

    def spans(self) -> Iterator[tuple[int, int]]:
        """Cut all time into spans of few frames each, start and end."""
        cuts = [-LAST_NS, *self.times_ns[_FRAMES::_FRAMES].tolist(), LAST_NS]
        return itertools.pairwise(cuts)

    def frames(self, windows: Iterable[tuple[int, Iterable[Block]]]) -> Iterator[Frame]:
        """Give the frames in order of time; a car lives until the next one, or until its track ends.

        Parameters
        ----------
        windows : iterable of (int, iterable of Block)
            Their starts, ascending, and what is to be seen in each.
        """
        boxes = _boxes(self.times_ns, windows)
        for first in range(0, len(self.times_ns), _FRAMES):
            rows = slice(first, min(first + _FRAMES, len(self.times_ns)))
            frame, number, poses = self._cars(rows)
            starts = np.searchsorted(frame, np.arange(rows.start, rows.stop + 1))
            for index in range(rows.start, rows.stop):
                time_ns = int(self.times_ns[index])
                last = index + 1 == len(self.times_ns)
                own = slice(starts[index - first], starts[index - first + 1])
                cars = []
                for row, pose in zip(number[own].tolist(), poses[own].tolist(), strict=True):
                    track = self.tracks[row]
                    until_ns = track.end_ns if last else min(track.end_ns, int(self.times_ns[index + 1]))
                    cars.append((track, pose, until_ns - time_ns))
                yield Frame(time_ns, cars, next(boxes))

    def _cars(self, rows: slice) -> tuple[IntArray, IntArray, FloatArray]:
        """Frame index (C,), track index (C,) and pose (C, 3) of the cars in some frames, sorted by frame."""
        frames, numbers, poses = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros((0, 3))]
        times_ns = self.times_ns[rows]
        first, beyond = _spans(times_ns, [(track.times_ns[0], track.end_ns) for track in self.tracks])
        for number in np.flatnonzero(beyond > first).tolist():
            track = self.tracks[number]
            shown = np.arange(first[number], beyond[number])
            origin_ns = track.times_ns[0]
            at, known = times_ns[shown] - origin_ns, track.times_ns - origin_ns
            columns = [track.poses[:, 0], track.poses[:, 1], np.unwrap(track.poses[:, 2])]
            frames.append(shown + rows.start)
            numbers.append(np.full(len(shown), number))
            poses.append(np.column_stack([np.interp(at, known, column) for column in columns]))
        frame = np.concatenate(frames)
        order = np.argsort(frame, kind="stable")
        return frame[order], np.concatenate(numbers)[order], np.concatenate(poses)[order]


def _boxes(times_ns: IntArray, windows: Iterable[tuple[int, Iterable[Block]]]) -> Iterator[list[Block]]:
    """The blocks of one frame after the other; windows are taken when their time has come."""
    coming = iter(windows)
    following = next(coming, None)
    waiting: dict[int, list[Block]] = {}
    for index, time_ns in enumerate(times_ns.tolist()):
        while following is not None and following[0] <= time_ns:
            own = list(following[1])
            first, beyond = _spans(times_ns, [(block.start_ns, block.end_ns) for block in own])
            for block, begin, end in zip(own, first.tolist(), beyond.tolist(), strict=True):
                for frame in range(begin, end):
                    waiting.setdefault(frame, []).append(block)
            following = next(coming, None)
        yield waiting.pop(index, [])


def film(log: Log, plans: Iterable[WindowPlan], starts_ns: Sequence[int], vehicles: VehiclesConfig) -> Film:
    """Choose the frames: every knot and unit start, and the recorded instants between them.

    Where that shows more cars than a few a state, as logs do whose vehicles all have their own
    instants, frames are dropped evenly.
    """
    planned = _planned(plans, starts_ns)
    shown = [*_recorded(log, planned.dimensions, vehicles), *planned.tracks]
    fixed = [np.array([start_ns for start_ns, _ in planned.boxes], dtype=np.int64)]
    fixed += [track.times_ns for track in shown if track.planned]
    recorded = [np.zeros(0, np.int64)] + [track.times_ns for track in shown if not track.planned]
    first, between = np.concatenate(fixed), np.concatenate(recorded)
    limit = max(_CARS_FLOOR, _CARS_PER_STATE * sum(len(track.times_ns) for track in shown))
    spans = planned.boxes + [(int(track.times_ns[0]), track.end_ns) for track in shown]
    spacing_ns = _SPACING_NS
    times_ns = _thinned(first, between, spacing_ns)
    while len(times_ns) > 1 and _shown(times_ns, spans) > limit:
        spacing_ns *= 2
        times_ns = _thinned(first, between, spacing_ns)
    return Film(times_ns, shown, planned.spans)


def _thinned(fixed: IntArray, between: IntArray, spacing_ns: int) -> IntArray:
    """Of each span of spacing_ns keep one instant, a fixed one before one between."""
    times = np.concatenate([fixed, between])
    is_between = np.repeat([False, True], [len(fixed), len(between)])
    order = np.lexsort([times, is_between, times // spacing_ns])
    times = times[order]
    _, kept = np.unique(times // spacing_ns, return_index=True)
    return np.asarray(times[kept])


def _spans(times_ns: IntArray, spans: Sequence[tuple[int, int]]) -> tuple[IntArray, IntArray]:
    """The first frame of each span of time, and the frame after its last."""
    ends = np.array(spans, dtype=np.int64).reshape(-1, 2)
    return np.searchsorted(times_ns, ends[:, 0]), np.searchsorted(times_ns, ends[:, 1])


def _shown(times_ns: IntArray, spans: Sequence[tuple[int, int]]) -> int:
    first, beyond = _spans(times_ns, spans)
    return int((beyond - first).sum())


# --- what there is to show -------------------------------------------------------------------


@dataclass(slots=True)
class _Planned:
    """The planned motions of all windows, and the spans of the boxes beside them."""

    tracks: list[Track] = field(default_factory=list)
    dimensions: dict[str, Dimensions] = field(default_factory=dict)
    spans: list[tuple[str, int, int]] = field(default_factory=list)
    boxes: list[tuple[int, int]] = field(default_factory=list)


def _planned(plans: Iterable[WindowPlan], starts_ns: Sequence[int]) -> _Planned:
    found = _Planned()
    for plan, until_ns in zip(plans, [*starts_ns[1:], LAST_NS], strict=False):
        found.boxes += [(block.start_ns, block.end_ns) for block in blocks(plan, until_ns)]
        for motion in planned_motions(plan):
            found.tracks.append(_planned_track(motion))
            found.dimensions[motion.vehicle_id] = motion.dimensions
            found.spans.append((motion.vehicle_id, int(motion.times_ns[0]), int(motion.times_ns[-1])))
    begins: dict[str, int] = {}
    kept: list[Track] = []
    for track, (vehicle_id, begin_ns, _) in zip(reversed(found.tracks), reversed(found.spans), strict=True):
        kept += _until(track, begins.get(vehicle_id, LAST_NS))
        begins[vehicle_id] = begin_ns
    found.tracks = kept[::-1]
    return found


def _recorded(log: Log, planned: Mapping[str, Dimensions], vehicles: VehiclesConfig) -> Iterator[Track]:
    """Give the recorded motions, each cut at its gaps."""
    for (vehicle_id,), states in log.states.group_by("vehicle_id", maintain_order=True):
        yield from _recorded_tracks(str(vehicle_id), states, planned.get(str(vehicle_id)), vehicles)


def _recorded_tracks(
    vehicle_id: str, states: pl.DataFrame, planned: Dimensions | None, vehicles: VehiclesConfig
) -> Iterator[Track]:
    states = states.sort("time_ns", maintain_order=True)
    name = topic_name(vehicle_id)
    usual = planned or vehicles
    times_ns = states["time_ns"].to_numpy()
    poses = states.select("x_m", "y_m", pl.col("heading_rad").fill_nan(0.0).fill_null(0.0)).to_numpy()
    step_ns = _step_ns(times_ns)
    cuts = np.flatnonzero(np.diff(times_ns) > _GAP_STEPS * step_ns) + 1
    for rows in np.split(np.arange(len(times_ns)), cuts):
        yield Track(
            entity_id=f"recorded/{name}",
            frame_id=f"recorded/{name}",
            label="" if planned else name,
            colour=RECORDED,
            opacity=0.4,
            length_m=_first_known(states["length_m"], usual.length_m),
            width_m=_first_known(states["width_m"], usual.width_m),
            planned=False,
            times_ns=times_ns[rows],
            poses=poses[rows],
            end_ns=_end_ns(times_ns[rows], step_ns),
        )


def _planned_track(motion: PlannedMotion) -> Track:
    name = topic_name(motion.vehicle_id)
    return Track(
        entity_id=f"planned/{name}",
        frame_id=f"vehicle/{name}",
        label=name,
        colour=vehicle_colour(motion.vehicle_id),
        opacity=0.9,
        length_m=motion.dimensions.length_m,
        width_m=motion.dimensions.width_m,
        planned=True,
        times_ns=motion.times_ns,
        poses=motion.poses,
        end_ns=_end_ns(motion.times_ns, _step_ns(motion.times_ns)),
    )


def _until(track: Track, until_ns: int) -> list[Track]:
    """A planned motion as far as no later window plans its vehicle again; nothing where it is all later."""
    kept = track.times_ns < until_ns
    if kept.all():
        return [replace(track, end_ns=min(track.end_ns, until_ns))]
    if not kept.any():
        return []
    step_ns = track.end_ns - int(track.times_ns[-1])
    times_ns = track.times_ns[kept]
    return [
        replace(
            track,
            times_ns=times_ns,
            poses=track.poses[kept],
            end_ns=min(int(times_ns[-1]) + step_ns, until_ns),
        )
    ]


def _step_ns(times_ns: IntArray) -> int:
    steps = np.diff(times_ns)
    steps = steps[steps > 0]
    return int(np.median(steps)) if len(steps) else _INSTANT_NS


def _end_ns(times_ns: IntArray, step_ns: int) -> int:
    return min(int(times_ns[-1]) + max(step_ns, 1), LAST_NS)


def _first_known(sizes_m: pl.Series, default_m: float) -> float:
    known = sizes_m.drop_nulls()
    return float(known[0]) if len(known) else default_m


def blocks(plan: WindowPlan, until_ns: int) -> Iterator[Block]:
    """List a window's corridor-cubes and obstacles' boxes, each for its unit, until the next window."""
    for block in _window_blocks(plan):
        if block.start_ns < until_ns:
            yield block._replace(end_ns=min(block.end_ns, until_ns))


def _window_blocks(plan: WindowPlan) -> Iterator[Block]:
    window = plan.scenario.window
    for corridor in plan.corridors.corridors if plan.corridors is not None else ():
        name, colour = f"corridor/{topic_name(corridor.vehicle_id)}", vehicle_colour(corridor.vehicle_id)
        for row, box in enumerate(corridor.cubes_m):
            yield _block(name, window, corridor.first_unit + row, box, 0.1, colour, 0.3)
    for obstacle in plan.scenario.obstacles:
        name = f"obstacle/{topic_name(obstacle.obstacle_id)}"
        for k, box in enumerate(obstacle.boxes_m):
            if not np.isnan(box).any():
                yield _block(name, window, k, box, 0.5, OBSTACLE, 0.4)


def _block(
    name: str, window: Window, k: int, box: FloatArray, height_m: float, colour: Colour, opacity: float
) -> Block:
    x_min, x_max, y_min, y_max = box.tolist()
    x, y = to_map([(x_min + x_max) / 2.0, (y_min + y_max) / 2.0], window.frame).tolist()
    start_ns, end_ns = unit_span_ns(window, k)
    pose = (x, y, window.frame.yaw_rad)
    return Block(name, start_ns, end_ns, pose, x_max - x_min, y_max - y_min, height_m, colour, opacity)
