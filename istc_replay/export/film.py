"""What moves in a result, cut into frames: which vehicles and boxes are there at which instants."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
import polars as pl

from istc_replay.config import VehiclesConfig
from istc_replay.datatypes import Dimensions, FloatArray, Log, Window, WindowPlan
from istc_replay.export.colours import OBSTACLE, RECORDED, Colour, vehicle_colours
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
#: How long a vehicle of a single state is shown.
_INSTANT_NS = 100_000_000
#: A step longer than this many median steps is a gap, in which the vehicle is not shown.
_GAP_STEPS = 3.0
_LAST_NS = 2**63 - 1


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


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """The film: iterate for (time_ns, cars, blocks) in order of time.

    A car is (track, [x, y, heading], lifetime_ns); it lives until the next frame, or until its
    track ends.
    """

    times_ns: IntArray
    tracks: Sequence[Track]
    blocks: Sequence[Block]

    def __iter__(self) -> Iterator[tuple[int, list[tuple[Track, list[float], int]], list[Block]]]:
        frame, track, poses = self._cars()
        starts = np.searchsorted(frame, np.arange(len(self.times_ns) + 1))
        block_order, block_starts = self._block_order()
        for index, time_ns in enumerate(self.times_ns.tolist()):
            last = index + 1 == len(self.times_ns)
            rows = slice(starts[index], starts[index + 1])
            cars = []
            for number, pose in zip(track[rows].tolist(), poses[rows].tolist(), strict=True):
                shown = self.tracks[number]
                until_ns = shown.end_ns if last else min(shown.end_ns, int(self.times_ns[index + 1]))
                cars.append((shown, pose, until_ns - time_ns))
            here = block_order[block_starts[index] : block_starts[index + 1]]
            yield time_ns, cars, [self.blocks[number] for number in here]

    def _cars(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Frame index (C,), track index (C,) and pose (C, 3) of every car shown, sorted by frame."""
        frames, numbers, poses = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros((0, 3))]
        first, beyond = _spans(self.times_ns, self.tracks)
        for number, track in enumerate(self.tracks):
            shown = np.arange(first[number], beyond[number])
            origin_ns = track.times_ns[0]
            at, known = self.times_ns[shown] - origin_ns, track.times_ns - origin_ns
            columns = [track.poses[:, 0], track.poses[:, 1], np.unwrap(track.poses[:, 2])]
            frames.append(shown)
            numbers.append(np.full(len(shown), number))
            poses.append(np.column_stack([np.interp(at, known, column) for column in columns]))
        frame = np.concatenate(frames)
        order = np.argsort(frame, kind="stable")
        return frame[order], np.concatenate(numbers)[order], np.concatenate(poses)[order]

    def _block_order(self) -> tuple[list[int], IntArray]:
        first, beyond = _spans(self.times_ns, self.blocks)
        counts = beyond - first
        frame = np.concatenate([np.arange(i, j) for i, j in zip(first, beyond, strict=True)] or [first])
        order = np.argsort(frame, kind="stable")
        numbers = np.repeat(np.arange(len(self.blocks)), counts)[order]
        return numbers.tolist(), np.searchsorted(frame[order], np.arange(len(self.times_ns) + 1))


def film(tracks: Sequence[Track], blocks: Sequence[Block]) -> Frames:
    """Choose the frames: every knot and unit start, and the recorded instants between them.

    Where that shows more cars than a few a state, as logs do whose vehicles all have their own
    instants, frames are dropped evenly.
    """
    fixed = [np.array([block.start_ns for block in blocks], dtype=np.int64)]
    fixed += [track.times_ns for track in tracks if track.planned]
    recorded = [np.zeros(0, np.int64)] + [track.times_ns for track in tracks if not track.planned]
    first, between = np.concatenate(fixed), np.concatenate(recorded)
    limit = max(_CARS_FLOOR, _CARS_PER_STATE * sum(len(track.times_ns) for track in tracks))
    spacing_ns = _SPACING_NS
    times_ns = _thinned(first, between, spacing_ns)
    while len(times_ns) > 1 and _shown(times_ns, tracks) + _shown(times_ns, blocks) > limit:
        spacing_ns *= 2
        times_ns = _thinned(first, between, spacing_ns)
    return Frames(times_ns, tracks, blocks)


def _thinned(fixed: IntArray, between: IntArray, spacing_ns: int) -> IntArray:
    """Of each span of spacing_ns keep one instant, a fixed one before one between."""
    times = np.concatenate([fixed, between])
    is_between = np.repeat([False, True], [len(fixed), len(between)])
    order = np.lexsort([times, is_between, times // spacing_ns])
    times = times[order]
    _, kept = np.unique(times // spacing_ns, return_index=True)
    return np.asarray(times[kept])


def _spans(times_ns: IntArray, shown: Sequence[Track] | Sequence[Block]) -> tuple[IntArray, IntArray]:
    """The first frame of each, and the frame after its last."""
    starts = [s.start_ns if isinstance(s, Block) else s.times_ns[0] for s in shown]
    first = np.searchsorted(times_ns, np.array(starts, dtype=np.int64))
    return first, np.searchsorted(times_ns, np.array([s.end_ns for s in shown], dtype=np.int64))


def _shown(times_ns: IntArray, shown: Sequence[Track] | Sequence[Block]) -> int:
    first, beyond = _spans(times_ns, shown)
    return int((beyond - first).sum())


# --- what there is to show -------------------------------------------------------------------


def tracks(log: Log, plans: Sequence[WindowPlan], vehicles: VehiclesConfig) -> list[Track]:
    """List the recorded and planned motions, recorded first, each recording cut at its gaps.

    A vehicle that a later window plans again leaves its earlier plan when the later one begins.
    """
    motions = planned_motions(plans)
    colours = scene_colours(log, plans)
    planned = {motion.vehicle_id: motion.dimensions for motion in motions}
    found: list[Track] = []
    for (vehicle_id,), states in log.states.group_by("vehicle_id", maintain_order=True):
        found += _recorded_tracks(str(vehicle_id), states, planned.get(str(vehicle_id)), vehicles)
    begins: dict[str, int] = {}
    latest_first: list[Track] = []
    for motion in reversed(motions):
        latest_first += _planned_track(motion, colours[motion.vehicle_id], begins.get(motion.vehicle_id))
        begins[motion.vehicle_id] = int(motion.times_ns[0])
    return found + latest_first[::-1]


def scene_colours(log: Log, plans: Sequence[WindowPlan]) -> dict[str, Colour]:
    """Give each vehicle its colour, the same as in every view of the result."""
    ids = set(log.states["vehicle_id"].unique())
    ids |= {participant.vehicle_id for plan in plans for participant in plan.scenario.participants}
    return vehicle_colours(ids)


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


def _planned_track(motion: PlannedMotion, colour: Colour, replaced_ns: int | None) -> Iterator[Track]:
    name = topic_name(motion.vehicle_id)
    until_ns = _LAST_NS if replaced_ns is None else replaced_ns
    kept = motion.times_ns < until_ns
    if kept.any():
        yield Track(
            entity_id=f"planned/{name}",
            frame_id=f"vehicle/{name}",
            label=name,
            colour=colour,
            opacity=0.9,
            length_m=motion.dimensions.length_m,
            width_m=motion.dimensions.width_m,
            planned=True,
            times_ns=motion.times_ns[kept],
            poses=motion.poses[kept],
            end_ns=min(_end_ns(motion.times_ns[kept], _step_ns(motion.times_ns)), until_ns),
        )


def _step_ns(times_ns: IntArray) -> int:
    steps = np.diff(times_ns)
    steps = steps[steps > 0]
    return int(np.median(steps)) if len(steps) else _INSTANT_NS


def _end_ns(times_ns: IntArray, step_ns: int) -> int:
    return min(int(times_ns[-1]) + max(step_ns, 1), _LAST_NS)


def _first_known(sizes_m: pl.Series, default_m: float) -> float:
    known = sizes_m.drop_nulls()
    return float(known[0]) if len(known) else default_m


def blocks(plans: Sequence[WindowPlan], colours: Mapping[str, Colour]) -> list[Block]:
    """List the corridor-cubes and the obstacles' boxes, each for its unit.

    Where windows lie over each other, the later window's are shown.
    """
    found: list[Block] = []
    for plan, following in zip_longest(plans, plans[1:]):
        until_ns = _LAST_NS if following is None else following.scenario.window.start_ns
        found += [
            block._replace(end_ns=min(block.end_ns, until_ns))
            for block in _window_blocks(plan, colours)
            if block.start_ns < until_ns
        ]
    return found


def _window_blocks(plan: WindowPlan, colours: Mapping[str, Colour]) -> Iterator[Block]:
    window = plan.scenario.window
    for corridor in plan.corridors.corridors if plan.corridors is not None else ():
        name = f"corridor/{topic_name(corridor.vehicle_id)}"
        for row, box in enumerate(corridor.cubes_m):
            yield _block(name, window, corridor.first_unit + row, box, 0.1, colours[corridor.vehicle_id], 0.3)
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
