"""Chunks of the Rerun view: columns in, small chunks out, on three timelines."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray
from rerun.chunk import Chunk

from istc_replay.datatypes import FloatArray

IntArray = NDArray[np.int64]

#: The component columns of a slice of rows.
Columns = Callable[[slice], Iterable[rr.ComponentColumn]]

#: A chunk beyond these may be dropped by the web viewer.
CHUNK_ROWS = 4096
CHUNK_BYTES = 384 * 1024

#: What is shown until this time is never cleared.
FOREVER_NS = int(np.iinfo(np.int64).max)

_LABEL_LENGTH = 32
#: Latin, Greek and Cyrillic: what the viewer's font is sure to have.
_DRAWN = frozenset(
    chr(c)
    for c in (*range(0x20, 0x180), *range(0x386, 0x3CF), *range(0x400, 0x460), 0x2013, 0x2014, 0x2026)
    if chr(c).isprintable() and c != 0x149 and (c < 0x180 or c >= 0x400 or chr(c).isalpha())
)
#: A row's identity and its three times.
_INDEX_BYTES = 54.0


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """The three timelines: absolute `time`, `scenario_time` and `time_unit`.

    `origin_ns` is the start of the first window. `unit_starts_ns` are the starts of all time
    units of all windows and the last end: `time_unit` counts through the windows.
    """

    origin_ns: int
    unit_starts_ns: IntArray
    first_unit: int = 0

    def units(self, times_ns: ArrayLike) -> IntArray:
        """Number of the time unit that each instant (S,) lies in; one less than the first before it."""
        times = np.asarray(times_ns, dtype=np.int64)
        return np.searchsorted(self.unit_starts_ns, times, side="right") - 1 + self.first_unit

    def columns(self, times_ns: ArrayLike, units: ArrayLike | None = None) -> list[rr.TimeColumn]:
        """Index columns of a chunk whose rows hold from the instants (S,) on."""
        times = np.asarray(times_ns, dtype=np.int64)
        return [
            rr.TimeColumn("time", timestamp=times.astype("datetime64[ns]")),
            rr.TimeColumn("scenario_time", duration=(times - self.origin_ns).astype("timedelta64[ns]")),
            rr.TimeColumn("time_unit", sequence=self.units(times) if units is None else np.asarray(units)),
        ]


def plain(text: object) -> str:
    """Untrusted text on one line, in characters that the viewer can draw; others become `?`.

    Rerun's viewer ends at once on a character that its one font lacks.
    """
    return "".join(c if c in _DRAWN else "?" for c in str(text))


def label(identifier: str) -> str:
    """A short name for an untrusted identifier; different identifiers stay different."""
    drawn = plain(identifier)
    if drawn == identifier and 0 < len(drawn) <= _LABEL_LENGTH:
        return drawn
    digest = hashlib.sha256(identifier.encode("utf-8", "surrogatepass")).hexdigest()[:8]
    return f"{drawn[: _LABEL_LENGTH - 10]}\N{HORIZONTAL ELLIPSIS}#{digest}"


def entity(*parts: str) -> str:
    """The path of an entity, each part escaped."""
    return str(rr.new_entity_path(list(parts)))


def static(path: str, *columns: Iterable[rr.ComponentColumn]) -> Chunk:
    """A chunk of one row that holds at all times."""
    return Chunk.from_columns(path, [], [column for group in columns for column in group])


def each(archetype: Any, **values: Any) -> Columns:
    """Columns with one value a row."""
    return lambda rows: archetype.columns(**{name: value[rows] for name, value in values.items()})


def ragged(archetype: Any, counts: ArrayLike, **values: Any) -> Columns:
    """Columns with counts[row] values in each row, all rows' values one after the other."""
    lengths = np.asarray(counts, dtype=np.int64)
    offsets = np.concatenate([[0], np.cumsum(lengths)])

    def columns(rows: slice) -> Iterable[rr.ComponentColumn]:
        part = slice(int(offsets[rows.start]), int(offsets[rows.stop]))
        own = archetype.columns(**{name: value[part] for name, value in values.items()})
        return own.partition(lengths[rows])  # type: ignore[no-any-return]

    return columns


def same(archetype: Any, **values: Any) -> Columns:
    """Columns with the same value in each row."""
    return lambda rows: archetype.columns(
        **{name: [value] * (rows.stop - rows.start) for name, value in values.items()}
    )


def shown(
    clock: Clock,
    path: str,
    times_ns: ArrayLike,
    ends_ns: ArrayLike,
    *columns: Columns,
    row_bytes: float = 64.0,
) -> list[Chunk]:
    """Chunks of rows that each hold from their time to their end.

    Parameters
    ----------
    times_ns, ends_ns : array_like
        (S,) ascending; a row ends where the next begins, or is cleared at its end.
    columns : callable
        Give the component columns of a slice of rows.
    row_bytes : float
        Mean size of a row's values, to keep chunks small.
    """
    times, ends = np.asarray(times_ns, dtype=np.int64), np.asarray(ends_ns, dtype=np.int64)
    chunks = []
    cleared = (ends < np.append(times[1:], FOREVER_NS)) & (ends < FOREVER_NS)
    if cleared.any():
        # Made first, a clear loses against a state of the same instant; and on `time_unit` it
        # must not strike the state that it ends.
        units = np.maximum(clock.units(ends[cleared]), clock.units(times[cleared]) + 1)
        flags = rr.Clear.columns(is_recursive=np.zeros(len(units), dtype=bool))
        chunks.append(Chunk.from_columns(path, clock.columns(ends[cleared], units), flags))
    size = int(max(1, min(CHUNK_ROWS, CHUNK_BYTES // (row_bytes + _INDEX_BYTES))))
    for start in range(0, len(times), size):
        rows = slice(start, min(start + size, len(times)))
        own = [column for group in columns for column in group(rows)]
        chunks.append(Chunk.from_columns(path, clock.columns(times[rows]), own))
    return chunks


def ui_radius(points: float) -> Any:
    """A line's or point's radius in points of the screen, whatever the zoom."""
    return rr.components.Radius.ui_points(points)


def quaternions(headings_rad: ArrayLike) -> FloatArray:
    """Turns about z as quaternions x, y, z, w; (S, 4)."""
    half = np.asarray(headings_rad, dtype=np.float64) / 2.0
    return np.stack([np.zeros_like(half), np.zeros_like(half), np.sin(half), np.cos(half)], axis=-1)


def at_height(points_m: ArrayLike, z: ArrayLike) -> FloatArray:
    """Points (P, 2) at a height, or at one each; (P, 3)."""
    points = np.asarray(points_m, dtype=np.float64)
    return np.column_stack([points, np.broadcast_to(np.asarray(z, dtype=np.float64), len(points))])
