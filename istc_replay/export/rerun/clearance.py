"""Clearances of the closest pairs of vehicles, as recorded and as planned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from istc_replay.datatypes import FloatArray
from istc_replay.export.rerun.chunks import IntArray
from istc_replay.export.rerun.spans import Span
from istc_replay.export.rerun.stage import Stage
from istc_replay.export.rerun.tracks import Track
from istc_replay.safety.boxes import box_gap

#: Pairs farther apart than this are not of interest [m].
HORIZON_M = 15.0
#: Pairs drawn of either source, and pairs measured in one window: the closest ones.
PAIRS_DRAWN = 3
_PAIRS_MEASURED = 200
_STEP_NS = 100_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Clearance:
    """Signed gaps (S,) [m] of two vehicles' boxes in one window; NaN where one is absent.

    `source` is recorded or planned. Negative gaps are overlaps.
    """

    window: int
    source: str
    pair: tuple[str, str]
    times_ns: IntArray
    gaps_m: FloatArray

    @property
    def least_m(self) -> float:
        """The least gap [m]."""
        return float(np.nanmin(self.gaps_m))

    def overlaps(self) -> list[tuple[int, int, float]]:
        """Stretches of overlap: first and last instant [ns], least gap [m]."""
        inside = np.concatenate([[False], self.gaps_m < 0.0, [False]])
        edges = np.flatnonzero(np.diff(inside.astype(np.int8)))
        return [
            (int(self.times_ns[a]), int(self.times_ns[b - 1]), float(self.gaps_m[a:b].min()))
            for a, b in zip(edges[::2], edges[1::2], strict=True)
        ]


def clearances(stage: Stage) -> list[Clearance]:
    """Gaps of all pairs that come within `HORIZON_M`, window by window, every tenth of a second."""
    found = []
    for span in stage.spans:
        for source, tracks in (("recorded", stage.recorded), ("planned", _planned(stage, span))):
            found += _window(span, source, tracks)
    return found


#: The least gap of each pair by source and pair [m].
Leasts = dict[tuple[str, tuple[str, str]], float]


def add_leasts(leasts: Leasts, found: list[Clearance]) -> None:
    """Add clearances to the least gaps."""
    for clearance in found:
        key = clearance.source, clearance.pair
        leasts[key] = min(clearance.least_m, leasts.get(key, np.inf))


def closest_pairs(leasts: Leasts) -> tuple[tuple[str, str], ...]:
    """The pairs with the least gaps, as recorded and as planned, closest first."""
    chosen: dict[tuple[str, str], float] = {}
    for source in ("recorded", "planned"):
        least = {pair: gap for (own, pair), gap in leasts.items() if own == source}
        for pair in sorted(least, key=lambda pair: (least[pair], pair))[:PAIRS_DRAWN]:
            chosen[pair] = min(least[pair], chosen.get(pair, np.inf))
    return tuple(sorted(chosen, key=lambda pair: (chosen[pair], pair)))


def least_by_vehicle(found: list[Clearance], window: int, source: str) -> dict[str, float]:
    """Each vehicle's least gap to any other in a window [m]; absent where above `HORIZON_M`."""
    least: dict[str, float] = {}
    for clearance in found:
        if (clearance.window, clearance.source) == (window, source):
            for vehicle_id in clearance.pair:
                least[vehicle_id] = min(clearance.least_m, least.get(vehicle_id, np.inf))
    return least


def _planned(stage: Stage, span: Span) -> dict[str, Track]:
    return {vehicle: track for (window, vehicle), track in stage.planned.items() if window == span.index}


def _window(span: Span, source: str, tracks: dict[str, Track]) -> list[Clearance]:
    times = np.append(np.arange(span.start_ns, span.end_ns, _STEP_NS, dtype=np.int64), span.end_ns)
    boxes, ids = [], []
    for vehicle_id, track in sorted(tracks.items()):
        if track.times_ns[0] <= span.end_ns and track.times_ns[-1] >= span.start_ns:
            boxes.append(track.boxes_at(times))
            ids.append(vehicle_id)
    if len(ids) < 2:
        return []
    found = []
    for a, b in _near(np.stack(boxes)):
        gaps = box_gap(boxes[a], boxes[b])
        if np.nanmin(gaps) <= HORIZON_M:
            shown = (
                times < span.shown_end_ns if span.shown_end_ns < span.end_ns else np.ones(len(times), bool)
            )
            if np.isfinite(gaps[shown]).any():
                found.append(Clearance(span.index, source, (ids[a], ids[b]), times[shown], gaps[shown]))
    return found


def _near(boxes: FloatArray) -> list[tuple[int, int]]:
    """Pairs of the boxes (V, T, 5) whose circles come within the horizon, closest first."""
    reach = np.nanmax(np.hypot(boxes[:, :, 3], boxes[:, :, 4]), axis=1, initial=0.0) / 2.0
    pairs = []
    for a in range(len(boxes) - 1):
        offsets = boxes[a + 1 :, :, :2] - boxes[a, :, :2]
        squares = np.einsum("vtc,vtc->vt", offsets, offsets)
        least = np.sqrt(np.min(np.where(np.isnan(squares), np.inf, squares), axis=1))
        bound = least - reach[a] - reach[a + 1 :]
        pairs += [(float(bound[i]), a, a + 1 + int(i)) for i in np.flatnonzero(bound <= HORIZON_M)]
    return [(a, b) for _, a, b in sorted(pairs)[:_PAIRS_MEASURED]]
