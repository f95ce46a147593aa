"""Layouts: where the fields of a payload stand, found by parsing one and checked on all others.

A parser reads one payload byte by byte and notes which of its bytes decide where everything stands
(lengths, tags, encapsulation) and where the wanted fields are. Every payload of the same size
whose deciding bytes are the same has its fields in the same places: they are read as columns.
A payload that fits no known layout is parsed itself, so nothing is ever read by a wrong one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from istc_replay.ingest.batches import Bytes, Ints, rows
from istc_replay.ingest.payload import ITEMS_AT_ONCE, PayloadError, TooManyItemsError

#: A leaf that the payload leaves out: unknown, or zero by the rule of its encoding.
NULL, ZERO = -1, -2
#: Layouts that are kept, and tried on a payload of their size.
_KEPT = 256
#: Items of all layouts that are kept.
_KEPT_ITEMS = 50_000
_WORD = 8
#: Mixes the words of a text into a hash.
_FACTOR = np.uint64(0x9E3779B97F4A7C15)


class Leaf(NamedTuple):
    """One wanted field: a numpy type code, `varint`, `int` or `zigzag` (varints), `text` or `bytes`."""

    kind: str
    start: int = NULL
    size: int = 0


@dataclass(slots=True)
class Layout:
    """What the parser notes of one payload: its deciding bytes, and its leaves by item and name."""

    size: int
    items: list[dict[str, Leaf]] = field(default_factory=list)
    fixed: list[tuple[int, int, int]] = field(default_factory=list)  # start, end, mask of each byte

    def fix(self, start: int, end: int, mask: int = 0xFF) -> None:
        """Note that the masked bits of these bytes decide where things stand."""
        self.fixed.append((start, end, mask))


class Column(NamedTuple):
    """Values of one leaf, (m,): numbers, or codes into `texts`; `valid` is None where all are."""

    values: NDArray[Any]
    valid: NDArray[np.bool_] | None = None
    texts: list[Any] | None = None

    def texts_at(self, rows: Ints) -> Ints:
        """The rows (m,) of which it tells texts."""
        if self.texts is None:
            return rows[:0]
        return rows if self.valid is None else rows[self.valid]


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """Items of many payloads: the payload's row of each (m,) in order, and the columns by name.

    `bad` has the payloads that cannot be decoded, by row; `texts` the rows of payloads with a text in
    place of a number, by name, as far as the column does not show it.
    """

    rows: Ints
    columns: dict[str, Column]
    bad: list[tuple[int, PayloadError]]
    texts: tuple[tuple[str, Ints], ...] = ()


class _Compiled:
    """A layout ready to be compared with many payloads."""

    def __init__(self, layout: Layout, payload: Bytes) -> None:
        self.layout = layout
        last = [end for _, end, _ in layout.fixed]
        last += [leaf.start + leaf.size for item in layout.items for leaf in item.values()]
        self.width = -(-max(last, default=0) // _WORD) * _WORD  # whole words
        mask = np.zeros(self.width, np.uint8)
        for start, end, bits in layout.fixed:
            mask[start:end] |= bits
        words = np.flatnonzero(mask.view(np.uint64))
        self._words = words
        self._mask = mask.view(np.uint64)[words]
        self._expected = payload[: self.width].view(np.uint64)[words] & self._mask

    def fits(self, table: NDArray[np.uint64]) -> NDArray[np.bool_]:
        """Tell which rows (n, words) have the same deciding bytes."""
        fits = np.ones(len(table), np.bool_)
        for word, mask, expected in zip(self._words.tolist(), self._mask, self._expected, strict=True):
            fits &= (table[:, word] & mask) == expected
        return fits


class Decoder:
    """Decodes payloads by layouts; `parse` makes the layout of one payload.

    Parameters
    ----------
    parse : callable
        From the bytes of a payload to its Layout; raises PayloadError.
    kinds : dict[str, str]
        The kind of every leaf, so that columns agree where a leaf is missing.
    """

    def __init__(self, parse: Callable[[bytes], Layout], kinds: dict[str, str]) -> None:
        self._parse = parse
        self._kinds = kinds
        self._known: dict[int, list[_Compiled]] = {}
        self._count = self._weight = 0

    def decode(self, data: Bytes, starts: Ints, ends: Ints) -> Decoded:
        """Decode the payloads that these spans of data hold; data must go on for 16 bytes after."""
        parts: list[tuple[Ints, dict[str, Column]]] = []
        bad: list[tuple[int, PayloadError]] = []
        sizes = ends - starts
        for size in np.unique(sizes).tolist():
            pending = np.flatnonzero(sizes == size)
            for known in list(self._known.get(size, ())):
                pending = self._by(known, data, starts, pending, parts)
                if not len(pending):
                    break
            while len(pending):
                start = int(starts[pending[0]])
                try:
                    layout = self._parse(data[start : start + size].tobytes())
                except PayloadError as error:
                    bad.append((int(pending[0]), error))
                    pending = pending[1:]
                    continue
                compiled = _Compiled(layout, data[start:])
                self._keep(size, compiled)
                pending = self._by(compiled, data, starts, pending, parts)
        return joined_parts(parts, bad, self._kinds)

    def _keep(self, size: int, compiled: _Compiled) -> None:
        weight = max(len(compiled.layout.items), 1)
        self._count += 1
        self._weight += weight
        if self._count > _KEPT or self._weight > _KEPT_ITEMS:
            self._known, self._count, self._weight = {}, 1, weight
        self._known.setdefault(size, []).append(compiled)

    def _by(
        self,
        compiled: _Compiled,
        data: Bytes,
        starts: Ints,
        pending: Ints,
        parts: list[tuple[Ints, dict[str, Column]]],
    ) -> Ints:
        """Decode what fits the layout; returns the rows that do not."""
        table = rows(data, starts[pending], compiled.width)
        fits = compiled.fits(table.view(np.uint64))
        taken = pending
        left = pending[:0]
        if not fits.all():
            taken, left, table = pending[fits], pending[~fits], table[fits]
        layout = compiled.layout
        if len(taken) and layout.items:
            count = len(layout.items)
            if count * len(taken) > ITEMS_AT_ONCE and len(starts) > 1:
                raise TooManyItemsError(max(ITEMS_AT_ONCE // count, 1))
            columns = {
                name: _column(table, [item.get(name, Leaf(kind)) for item in layout.items])
                for name, kind in self._kinds.items()
            }
            parts.append((np.repeat(taken, count), columns))
        return left


def joined_parts(
    parts: list[tuple[Ints, dict[str, Column]]], bad: list[tuple[int, PayloadError]], kinds: dict[str, str]
) -> Decoded:
    """Join what was decoded apart, in the order of the payloads; a payload's items stay in theirs."""
    bad = sorted(bad, key=lambda entry: entry[0])
    if len(parts) == 1:
        return Decoded(parts[0][0], parts[0][1], bad)
    if not parts:
        none = np.zeros((0, _WORD), np.uint8)
        return Decoded(
            np.zeros(0, np.int64), {name: _column(none, [Leaf(kind)]) for name, kind in kinds.items()}, bad
        )
    order = np.concatenate([part[0] for part in parts])
    turn = np.argsort(order, kind="stable")
    columns = {name: joined([part[1][name] for part in parts], turn) for name in kinds}
    return Decoded(order[turn], columns, bad)


def joined(columns: Sequence[Column], turn: Ints) -> Column:
    """Join columns and put their values in the order of turn."""
    valid = None
    if any(column.valid is not None for column in columns):
        masks = [np.ones(len(c.values), np.bool_) if c.valid is None else c.valid for c in columns]
        valid = np.concatenate(masks)[turn]
    if columns[0].texts is None:
        return Column(np.concatenate([column.values for column in columns])[turn], valid)
    codes: dict[Any, int] = {}
    values = []
    for column in columns:
        own = [codes.setdefault(text, len(codes)) for text in column.texts or []]
        values.append(np.array(own or [0], np.int64)[column.values])
    return Column(np.concatenate(values)[turn], valid, list(codes))


def take(column: Column, index: Ints) -> Column:
    """Pick values of a column."""
    valid = None if column.valid is None else column.valid[index]
    return Column(column.values[index], valid, column.texts)


def _column(table: Bytes, leaves: list[Leaf]) -> Column:
    """Read one leaf of all items; (n, width) rows give (n * items,) values, items together."""
    count = len(leaves)
    kind = leaves[0].kind
    parts = [_leaf(table, leaf) for leaf in leaves]
    nulls = [leaf.start == NULL for leaf in leaves]
    valid = np.tile(~np.array(nulls), len(table)) if any(nulls) else None
    if kind in ("text", "bytes"):
        codes: dict[Any, int] = {}
        own = np.empty((len(table), count), np.int64)
        for index, raw in enumerate(parts):
            own[:, index] = _codes(raw, kind, codes)
        return Column(own.reshape(-1), valid, list(codes))
    values = parts[0] if count == 1 else np.stack(parts, axis=1).reshape(-1)
    return Column(values, valid)


def _leaf(table: Bytes, leaf: Leaf) -> NDArray[Any]:
    """Read one leaf of each row: as bytes, or as float64, int64 or uint64."""
    raw = table[:, leaf.start : leaf.start + leaf.size] if leaf.start >= 0 else table[:, :0]
    if leaf.kind in ("text", "bytes"):
        return raw
    if leaf.kind in ("varint", "int", "zigzag"):
        value = np.zeros(len(table), np.uint64)
        for index in range(min(leaf.size, 10)):
            value |= (raw[:, index].astype(np.uint64) & np.uint64(0x7F)) << np.uint64(7 * index)
        if leaf.kind == "zigzag":
            value = (value >> np.uint64(1)) ^ (~(value & np.uint64(1)) + np.uint64(1))
        return value if leaf.kind == "varint" else value.view(np.int64)
    dtype = np.dtype(leaf.kind)
    wide = {"f": "f8", "i": "i8", "u": "u8" if dtype.itemsize == 8 else "i8"}[dtype.kind]
    if leaf.start < 0:
        return np.zeros(len(table), wide)
    return np.ascontiguousarray(raw).view(dtype).reshape(-1).astype(wide, copy=False)


def _codes(raw: Bytes, kind: str, codes: dict[Any, int]) -> Ints | int:
    """Code the rows' texts, adding new ones to codes."""
    if not len(raw):
        return 0
    if not raw.shape[1]:
        return codes.setdefault("" if kind == "text" else b"", len(codes))
    if (raw == raw[0]).all():
        return codes.setdefault(_text(raw[0].tobytes(), kind), len(codes))
    count, size = raw.shape
    padded = np.zeros((count, -(-size // _WORD) * _WORD), np.uint8)
    padded[:, :size] = raw
    first, own = coded(padded.view(np.uint64))
    known = [codes.setdefault(_text(raw[row].tobytes(), kind), len(codes)) for row in first.tolist()]
    return np.array(known, np.int64)[own]


def coded(words: NDArray[np.uint64]) -> tuple[Ints, Ints]:
    """Return the places of the different rows of words (n, k), and for each row which of them it is."""
    mixed = np.zeros(len(words), np.uint64)
    for word in range(words.shape[1]):
        mixed = (mixed ^ words[:, word]) * _FACTOR
        mixed ^= mixed >> np.uint64(29)
    found = np.unique(mixed)
    own = np.searchsorted(found, mixed)
    first = np.empty(len(found), np.int64)
    first[own[::-1]] = np.arange(len(words))[::-1]
    if not (words == words[first[own]]).all():  # two of one hash
        _, first, own = np.unique(words, axis=0, return_index=True, return_inverse=True)
    return first, own.reshape(-1)


def _text(raw: bytes, kind: str) -> Any:
    if kind == "bytes":
        return raw
    try:
        return raw.rstrip(b"\0").decode("utf-8")
    except UnicodeDecodeError:
        return None  # as if it were left out
