"""How motions of two results differ: distances at one instant, delays along the way, orders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from istc_replay.comparison.difference import Crossing, PairChange, VehicleChange
from istc_replay.datatypes import FloatArray, Result
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.encroachment import encroachments
from istc_replay.safety.recorded import Track, recorded_tracks
from istc_replay.units import NS_PER_S

#: Motions are compared this often, but at no more than this many instants of a window.
_STEP_S, _MOST_TIMES = 0.1, 1000
#: Plans nearer than this are the same [m]; leads in time are known to a step either way.
_MOVED_M = 1e-6
_LEAD_S = 1.5 * _STEP_S
#: Where along A's way the delay counts, since plans may end in a long last metre; how near B must
#: come to that place, and how finely its time is told.
_DELAY_SHARE, _PLACE_M, _FINE_NS = 0.95, 5.0, 10_000_000
#: The delay along a shorter way says nothing [m].
_LEAST_WAY_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class WindowMotions:
    """The motions of one window: tracks by vehicle, and the instants looked at."""

    start_ns: int
    times_s: FloatArray
    recorded: dict[str, Track]
    planned: dict[str, Track]

    def poses(self, tracks: dict[str, Track], name: str, times_s: FloatArray) -> FloatArray:
        """(T, 3) x, y, heading at times from the window's start; NaN where absent."""
        at_ns = self.start_ns + np.round(times_s * NS_PER_S).astype(np.int64)
        return tracks[name].at(at_ns)[:, :3]

    def boxes(self, tracks: dict[str, Track]) -> FloatArray:
        """(T, V, 5) boxes of all tracks at the window's instants."""
        boxes = np.full((len(self.times_s), len(tracks), 5), np.nan)
        for column, (name, track) in enumerate(tracks.items()):
            boxes[:, column, :3] = self.poses(tracks, name, self.times_s)
            boxes[:, column, 3:] = track.length_m, track.width_m
        return boxes

    def figures(self) -> dict[str, float | None]:
        """The least gap of two planned boxes at the instants looked at [m]."""
        if len(self.planned) < 2:
            return {"planned.min_separation_m": None}
        boxes = self.boxes(self.planned)
        i, j = np.triu_indices(len(self.planned), k=1)
        gaps = [box_gap(row[i], row[j]) for row in boxes]
        least = np.nanmin(gaps) if np.isfinite(gaps).any() else np.nan
        return {"planned.min_separation_m": float(least) if np.isfinite(least) else None}


def window_motions(result: Result, entry: dict[str, Any]) -> WindowMotions:
    """Gather the motions of a window, given its entry in the summary."""
    start_ns, end_ns = int(entry["start_ns"]), int(entry["end_ns"])
    spans = pl.col("time_ns").is_between(start_ns, end_ns)
    planned = result.states.filter(pl.col("source") == "planned", pl.col("window") == entry["index"])
    duration_s = max((end_ns - start_ns) / NS_PER_S, _STEP_S)
    steps = min(int(np.ceil(duration_s / _STEP_S - 1e-9)), _MOST_TIMES)
    return WindowMotions(
        start_ns=start_ns,
        times_s=np.linspace(0.0, duration_s, steps + 1),
        recorded=recorded_tracks(result.states.filter(spans)),
        planned=recorded_tracks(planned.drop("source")),
    )


def compare_motions(a: WindowMotions, b: WindowMotions) -> dict[str, VehicleChange]:
    """Compare the plans, and the recordings, of vehicles that both have; those that differ."""
    found = {}
    for name in a.recorded.keys() | a.planned.keys():
        planned = _moved(a, b, a.planned, b.planned, name)
        recorded = _moved(a, b, a.recorded, b.recorded, name)
        if planned is not None or recorded is not None:
            found[name] = VehicleChange(
                name,
                (),
                moved_m=None if planned is None else planned[0],
                moved_at_s=None if planned is None else planned[1],
                delay_s=None if planned is None else _delay_s(a.planned[name], b.planned[name], a, b),
                recorded_moved_m=None if recorded is None else recorded[0],
            )
    return found


def _moved(
    a: WindowMotions, b: WindowMotions, of_a: dict[str, Track], of_b: dict[str, Track], name: str
) -> tuple[float, float] | None:
    """The largest distance at one instant and that instant; None where there is none."""
    if name not in of_a or name not in of_b:
        return None
    times_s = a.times_s if len(a.times_s) <= len(b.times_s) else b.times_s
    apart = a.poses(of_a, name, times_s) - b.poses(of_b, name, times_s)
    distances = np.hypot(apart[:, 0], apart[:, 1])
    if not np.isfinite(distances).any():
        return None
    at = int(np.nanargmax(distances))
    return (float(distances[at]), float(times_s[at])) if distances[at] > _MOVED_M else None


def _delay_s(one: Track, two: Track, a: WindowMotions, b: WindowMotions) -> float | None:
    """How much later B passes the place where A has done most of its way."""
    way = _way(one)
    if not way[-1] > _LEAST_WAY_M:
        return None
    at_ns = float(np.interp(_DELAY_SHARE * way[-1], way, one.times_ns - a.start_ns))
    place = one.at(np.array([a.start_ns + round(at_ns)]))[0, :2]
    times_ns = np.arange(two.times_ns[0], two.times_ns[-1] + 1, _FINE_NS)
    distances = np.hypot(*(two.at(times_ns)[:, :2] - place).T)
    if not np.nanmin(distances, initial=np.inf) <= _PLACE_M:
        return None
    return float((times_ns[np.nanargmin(distances)] - b.start_ns - at_ns) / NS_PER_S)


def _way(track: Track) -> FloatArray:
    """(S,) length driven until each sample."""
    steps = np.hypot(*np.diff(track.states[:, :2], axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


# --- who goes first --------------------------------------------------------------------------


def compare_pairs(a: WindowMotions, b: WindowMotions) -> tuple[PairChange, ...]:
    """Pairs whose order, or whose lead in time, differs between the plans."""
    of_a, of_b = crossings(a, a.planned), crossings(b, b.planned)
    changed = []
    for pair in sorted(of_a.keys() | of_b.keys()):
        one, two = of_a.get(pair), of_b.get(pair)
        if one is not None and two is not None and one.first == two.first:
            if abs(one.lead_s - two.lead_s) <= _LEAD_S:
                continue
        elif not all(name in motions.planned for name in pair for motions in (a, b)):
            continue  # who has no plan in one of the two is told as such
        changed.append((pair, one, two))
    recorded = crossings(a, a.recorded) if changed else {}
    return tuple(PairChange(pair, recorded.get(pair), one, two) for pair, one, two in changed)


def crossings(motions: WindowMotions, tracks: dict[str, Track]) -> dict[tuple[str, str], Crossing]:
    """Of each pair whose boxes come to the same place: who is there first, and the least lead.

    A lead of 0 is contact.
    """
    names = list(tracks)
    boxes = motions.boxes(tracks)
    longest_s = float(motions.times_s[-1])
    earlier, later, first, second = encroachments(
        boxes, motions.times_s, longest_s=longest_s, least_angle_rad=0.0
    )
    leads_s = motions.times_s[later] - motions.times_s[earlier]
    pairs = np.minimum(first, second) * len(names) + np.maximum(first, second)
    order = np.lexsort((earlier, leads_s, pairs))
    _, least = np.unique(pairs[order], return_index=True)
    found: dict[tuple[str, str], Crossing] = {}
    for row in order[least].tolist():
        ahead, behind = names[first[row]], names[second[row]]
        pair = (min(ahead, behind), max(ahead, behind))
        found[pair] = Crossing(ahead, behind, float(leads_s[row]))
    return found
