"""Events: spans of time in which a measure is past a threshold, with hysteresis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from istc_replay.config import AuditConfig
from istc_replay.datatypes import FloatArray
from istc_replay.units import NS_PER_S

IntArray = NDArray[np.int64]

_ROUNDING = 1e-9
#: A bridge spans a sample at least, whatever the rate.
_BRIDGED_PERIODS = 1.5


@dataclass(frozen=True, slots=True)
class Event:
    """Rows of the first sample past the threshold, the worst, and the last before release.

    `level` is the severest threshold that enough samples in a row are past.
    """

    start: int
    worst: int
    end: int
    level: int


def longest_bridge_ns(period_ns: float, audit: AuditConfig) -> float:
    """The longest pause [ns] that an event goes on over, of samples this far apart."""
    return max(audit.bridge_s * NS_PER_S, _BRIDGED_PERIODS * period_ns)


def find_events(
    keys: IntArray,
    times_ns: IntArray,
    badness: FloatArray,
    levels: FloatArray,
    *,
    release: float,
    bridge_ns: FloatArray,
    least_samples: IntArray,
    reach: IntArray | None = None,
) -> list[Event]:
    """Find the events of a measure.

    An event opens at the first level and lasts while the measure is past the release value;
    pauses up to the bridge are bridged. It counts with enough samples in a row past the first
    level, and is as severe as the last level of which this holds.

    Parameters
    ----------
    keys : ndarray
        (n,) whom a sample belongs to; sorted, with times increasing within a key.
    times_ns : ndarray
        (n,) times.
    badness : ndarray
        (n,) measure, larger is worse; NaN is not judged, and in no event.
    levels : ndarray
        (L,) thresholds, increasing.
    release : float
        An event ends where the measure is below this, which is at most the first level.
    bridge_ns : ndarray
        (n,) longest pause after each sample.
    least_samples : ndarray
        (L,) samples in a row that a level takes.
    reach : ndarray, optional
        (n,) the last level that a sample may count for; all by default.
    """
    held = np.flatnonzero(badness >= release)
    if held.size == 0:
        return []
    key, time = keys[held], times_ns[held]
    joined = (np.diff(key) == 0) & (np.diff(time) <= bridge_ns[held][:-1])
    starts = np.concatenate([[0], np.flatnonzero(~joined) + 1])
    ends = np.append(starts[1:], held.size)
    events = []
    bad = badness[held]
    may = np.full(held.size, levels.size) if reach is None else reach[held]
    opened = np.maximum.reduceat(bad, starts) >= levels[0]
    for start, end in zip(starts[opened].tolist(), ends[opened].tolist(), strict=True):
        run = bad[start:end]
        level = _level(run, may[start:end], levels, least_samples)
        if level < 0:
            continue
        first = start + int(np.argmax(run >= levels[0]))
        # Of samples that are as bad but for rounding the first, however the world is turned.
        counting = np.where(may[start:end] >= level, run, -np.inf)
        most = float(counting.max())
        worst = start + int(
            np.argmax(counting >= most - _ROUNDING * abs(most) if np.isfinite(most) else counting == most)
        )
        events.append(Event(int(held[first]), int(held[worst]), int(held[end - 1]), level))
    return events


def _level(run: FloatArray, may: IntArray, levels: FloatArray, least_samples: IntArray) -> int:
    """The last level that enough samples in a row are past, -1 where none is."""
    for level in range(levels.size - 1, -1, -1):
        counts = (run >= levels[level]) & (may >= level)
        past = np.concatenate([[0], counts.astype(np.int8), [0]])
        edges = np.flatnonzero(np.diff(past))
        if edges.size and int((edges[1::2] - edges[::2]).max()) >= least_samples[level]:
            return level
    return -1
