"""When the windows of a result are shown, and what its parts have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from istc_replay.datatypes import Frame
from istc_replay.export.rerun.chunks import FOREVER_NS, Clock


@dataclass(frozen=True, slots=True, eq=False)
class Span:
    """A window as shown: until `shown_end_ns`, where the next window may begin before its end."""

    index: int
    start_ns: int
    end_ns: int
    shown_end_ns: int
    units: int
    frame: Frame
    summary: dict[str, Any]

    @property
    def duration_s(self) -> float:
        """Length of the window [s]."""
        return (self.end_ns - self.start_ns) / 1e9


@dataclass(frozen=True, slots=True)
class Anchor:
    """What the parts of a result have in common, that is still being made or too long to be held at once.

    Parameters
    ----------
    origin_ns, origin_m
        Where the whole result's `scenario_time` and the view's places begin; None: with its first window.
    from_ns, until_ns
        Starts of the first window here and of the window after the last one: what is before and
        after belongs to other parts. None where there is none.
    first_unit
        Number of its first time unit.
    metres_per_second
        Height of a second; None: as the scene wants.
    """

    origin_ns: int | None = None
    origin_m: tuple[float, float] | None = None
    from_ns: int | None = None
    until_ns: int | None = None
    first_unit: int = 0
    metres_per_second: float | None = None


#: Of a result that is shown whole.
WHOLE = Anchor()


def make_spans(windows: list[dict[str, Any]], until_ns: int) -> tuple[Span, ...]:
    """The windows of a result in order of time, each shown until the next one begins."""
    ordered = sorted(windows, key=lambda w: (w["start_ns"], w["index"]))
    nexts = [*(w["start_ns"] for w in ordered), until_ns][1:]
    return tuple(
        Span(
            index=w["index"],
            start_ns=w["start_ns"],
            end_ns=w["end_ns"],
            shown_end_ns=min(w["end_ns"], following),
            units=max(1, w["units"]),
            frame=Frame(**w["frame"]),
            summary=w,
        )
        for w, following in zip(ordered, nexts, strict=True)
    )


def make_clock(spans: tuple[Span, ...], states: pl.DataFrame, anchor: Anchor) -> Clock:
    """The clock of the view: where its time begins, and the starts of the time units that it shows."""
    if not spans:
        first = int(states["time_ns"].to_numpy().min(initial=FOREVER_NS)) if states.height else 0
        return Clock(first, np.array([first], dtype=np.int64))
    starts = [
        s.start_ns + (s.end_ns - s.start_ns) * np.arange(s.units, dtype=np.int64) // s.units for s in spans
    ]
    shown = [unit[unit < s.shown_end_ns] for unit, s in zip(starts, spans, strict=True)]
    origin = spans[0].start_ns if anchor.origin_ns is None else anchor.origin_ns
    units = np.concatenate([*shown, [spans[-1].end_ns]]).astype(np.int64)
    return Clock(origin, units, anchor.first_unit)
