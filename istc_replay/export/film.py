"""What moves in a result, cut into frames: which vehicles and boxes are there at which instants."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from istc_replay.config import VehiclesConfig
from istc_replay.datatypes import FloatArray, Log, WindowPlan
from istc_replay.export.film_tracks import LAST_NS, Block, Track, planned_tracks, recorded_tracks
from istc_replay.export.placing import IntArray

#: Frames stand at least this far apart; further where they would hold too many cars.
_SPACING_NS = 50_000_000
_CARS_FLOOR = 100_000
_CARS_PER_STATE = 4
#: Frames worked on at once.
_FRAMES = 512


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
    planned = planned_tracks(plans, starts_ns)
    shown = [*recorded_tracks(log, planned.dimensions, vehicles), *planned.tracks]
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
