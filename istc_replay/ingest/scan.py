"""Finding fields in many protobuf messages at once, level by level."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from istc_replay.ingest.batches import Bytes, Ints
from istc_replay.ingest.payload import ITEMS_AT_ONCE, Budget, TooManyItemsError

#: Fields of all messages that are scanned at once.
_STEPS = 4 * ITEMS_AT_ONCE
#: Fewer messages than this are scanned one by one: steps over few cost as much as over many.
_FEW = 64
_VARINT_LIMIT = 10
#: Fields of a message that is scanned alone; one that has more is damaged.
FIELDS_LIMIT = 50_000
#: Outlines tried for messages of one size, sizes for which they are tried, fields of an outline.
_OUTLINES, _SIZES, _OUTLINED = 3, 32, 64
#: Rows, tags, starts and ends of fields.
_Places = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]


class Spans(NamedTuple):
    """Spans of a buffer, all (n,): whose row they belong to, the tag before them, start and end."""

    rows: Ints
    tags: Ints
    starts: Ints
    ends: Ints


def scan(data: Bytes, spans: Spans, wanted: set[int], budget: Budget) -> tuple[dict[int, Spans], Ints]:
    """Find the wanted fields of the messages in spans.

    Parameters
    ----------
    data : array
        The buffer; it must go on for 16 bytes after the last span.
    spans : Spans
        One message each, in the order of the buffer.
    wanted : set of int
        Field numbers.
    budget : Budget
        What may be scanned one by one.

    Returns
    -------
    dict[int, Spans]
        By number, the fields in the order of the buffer: the value without its length, and the
        rows of the messages that hold it.
    array
        Rows of the messages that are damaged, or have too many fields; what stands before the damage
        is given.

    Raises
    ------
    TooManyItemsError
        If several messages have more fields than are decoded at once.
    """
    found: dict[int, list[_Places]] = {number: [] for number in wanted}
    broken: list[Ints] = []
    position = spans.starts.copy()
    active = _by_outlines(data, spans, np.flatnonzero(position < spans.ends), found)
    steps = 0
    while len(active) > _FEW:
        tags, ends = position[active], spans.ends[active]
        tag, size = varints(data, tags)
        number, wire = tag >> np.uint64(3), (tag & np.uint64(7)).astype(np.int64)
        starts = tags + size
        length, length_size = varints(data, np.minimum(starts, len(data) - 16))
        # Lengths beyond the span are damage whatever they are; so they need not be exact.
        length = np.minimum(length, np.uint64(len(data))).astype(np.int64)
        starts = np.where(wire == 2, starts + length_size, starts)
        after = starts + np.select(
            [wire == 0, wire == 1, wire == 2, wire == 5], [length_size, 8, length, 4], 0
        )
        sound = (after <= ends) & (number > 0) & ((wire < 3) | (wire == 5)) & (size <= _VARINT_LIMIT)
        sound &= (wire != 0) | (length_size <= _VARINT_LIMIT)
        if not sound.all():
            broken.append(spans.rows[active[~sound]])
        steps += len(active)
        if steps > _STEPS:
            raise TooManyItemsError(max(len(spans.starts) // 8, 1))
        for one, places in found.items():
            hit = np.flatnonzero((number == one) & sound)
            if len(hit):
                places.append((spans.rows[active[hit]], tags[hit], starts[hit], after[hit]))
        position[active] = after
        active = active[sound & (after < ends)]
    _one_by_one(data, spans, position, active, found, broken, budget)
    return {one: _in_order(places) for one, places in found.items()}, _concatenated(broken)


def _one_by_one(
    data: Bytes,
    spans: Spans,
    position: Ints,
    rows: Ints,
    found: dict[int, list[_Places]],
    broken: list[Ints],
    budget: Budget,
) -> None:
    """Find the fields of a few messages, from where their scan has come to."""
    count = 0
    for done, index in enumerate(rows.tolist()):
        start, end = int(position[index]), int(spans.ends[index])
        row = spans.rows[index : index + 1]
        if not budget.any_left:
            broken.append(row)
            continue
        rest, fields, whole = _one(data[start : end + 16].tobytes(), end - start, set(found))
        budget.spend(fields)
        count += sum(map(len, rest.values()))
        if count > ITEMS_AT_ONCE and done:
            raise TooManyItemsError(done)
        for one, places in rest.items():
            if places:
                columns = np.array(places, np.int64) + start
                found[one].append((np.repeat(row, len(columns)), columns[:, 0], columns[:, 1], columns[:, 2]))
        if not whole:
            broken.append(row)


def _by_outlines(data: Bytes, spans: Spans, rows: Ints, found: dict[int, list[_Places]]) -> Ints:
    """Find the fields of messages that are built as another of their size; returns the rows that are left.

    Where one message's tags and lengths are known, all messages of its size with the same bytes in
    these places have their fields in the same places.
    """
    sizes = spans.ends[rows] - spans.starts[rows]
    kinds, own, counts = np.unique(sizes, return_inverse=True, return_counts=True)
    left = [rows[counts[own] <= _FEW]]
    many = np.flatnonzero(counts > _FEW).tolist()
    for kind in many:
        pending = rows[own == kind]
        for _ in range(_OUTLINES if len(many) <= _SIZES else 0):
            outline = _outline(data, int(spans.starts[pending[0]]), int(kinds[kind]))
            if outline is None:
                break
            fits = outline.fits(data, spans.starts[pending])
            outline.give(spans, pending[fits], found)
            pending = pending[~fits]
            if len(pending) <= _FEW:
                break
        left.append(pending)
    return np.sort(np.concatenate(left))


class _Outline(NamedTuple):
    """Where the fields of a message are, from its start, and the bytes that decide it."""

    fields: list[tuple[int, int, int, int]]  # number, tag, start, end
    places: Ints
    masks: Bytes
    expected: Bytes

    def fits(self, data: Bytes, starts: Ints) -> NDArray[np.bool_]:
        """Tell which messages have the same deciding bytes."""
        fits = np.ones(len(starts), np.bool_)
        for place, mask, expected in zip(self.places.tolist(), self.masks, self.expected, strict=True):
            fits &= (data[starts + place] & mask) == expected
        return fits

    def give(self, spans: Spans, rows: Ints, found: dict[int, list[_Places]]) -> None:
        """Add the places of the wanted fields in these messages."""
        for number, places in found.items():
            own = np.array([field[1:] for field in self.fields if field[0] == number], np.int64)
            if len(own) and len(rows):
                at = (spans.starts[rows][:, None, None] + own).reshape(-1, 3)  # (rows * fields, 3)
                places.append((np.repeat(spans.rows[rows], len(own)), at[:, 0], at[:, 1], at[:, 2]))


def _outline(data: Bytes, start: int, size: int) -> _Outline | None:
    """Make the outline of one message; None if it is damaged or has many fields."""
    raw = data[start : start + size + 16].tobytes()
    fields: list[tuple[int, int, int, int]] = []
    places: list[int] = []
    masks: list[int] = []
    position = 0
    while position < size:
        number, wire, value, after = next_field(raw, position, size)
        if after < 0 or len(fields) >= _OUTLINED:
            return None
        fields.append((number, position, value, after))
        deciding = range(position, value)
        places += deciding
        masks += [0xFF] * len(deciding)
        if wire == 0:  # where a varint ends
            places += range(value, after)
            masks += [0x80] * (after - value)
        position = after
    mask = np.array(masks, np.uint8)
    return _Outline(fields, np.array(places, np.int64), mask, data[start:][places] & mask)


def varints(data: Bytes, positions: Ints) -> tuple[NDArray[np.uint64], Ints]:
    """Read the varints at the positions; a size of 11 means that it is none."""
    first = data[positions]
    value = first.astype(np.uint64)
    size = np.ones(len(positions), np.int64)
    more = np.flatnonzero(first >= 0x80)
    if len(more):
        value[more] &= np.uint64(0x7F)
    for index in range(1, _VARINT_LIMIT + 1):
        if not len(more):
            break
        size[more] = index + 1
        if index == _VARINT_LIMIT:
            break
        byte = data[np.minimum(positions[more] + index, len(data) - 1)]
        value[more] |= (byte & np.uint8(0x7F)).astype(np.uint64) << np.uint64(7 * index)
        more = more[byte >= 0x80]
    return value, size


def varint(data: bytes, position: int, end: int) -> tuple[int, int]:
    """Read one varint; returns it and where it ends, or -1 where it is none."""
    value = shift = 0
    while position < end and shift < 70:
        byte = data[position]
        value |= (byte & 0x7F) << shift
        position, shift = position + 1, shift + 7
        if byte < 0x80:
            return value & (2**64 - 1), position
    return 0, -1


def next_field(data: bytes, position: int, end: int) -> tuple[int, int, int, int]:
    """Read one field: number, wire type, start of its value, and its end, or -1 where it is damaged."""
    tag, start = varint(data, position, end)
    number, wire = tag >> 3, tag & 7
    after = -1
    if start < 0 or not number:
        return number, wire, start, -1
    if wire == 0:
        after = varint(data, start, end)[1]
    elif wire == 2:
        length, start = varint(data, start, end)
        after = start + length if start >= 0 else -1
    elif wire in (1, 5):
        after = start + (8 if wire == 1 else 4)
    return number, wire, start, after if after <= end else -1


def _one(data: bytes, end: int, wanted: set[int]) -> tuple[dict[int, list[tuple[int, int, int]]], int, bool]:
    """Find the fields of one message; returns how many it has as well, and whether it is whole."""
    found: dict[int, list[tuple[int, int, int]]] = {number: [] for number in wanted}
    position = count = 0
    while position < end:
        number, _, start, after = next_field(data, position, end)
        count += 1
        if after < 0 or count > FIELDS_LIMIT:
            return found, count, False
        if number in found:
            found[number].append((position, start, after))
        position = after
    return found, count, True


def _in_order(places: list[_Places]) -> Spans:
    rows, tags, starts, ends = (_concatenated([place[k] for place in places]) for k in range(4))
    if not (np.diff(tags) < 0).any():
        return Spans(rows, tags, starts, ends)
    turn = np.argsort(tags, kind="stable")
    return Spans(rows[turn], tags[turn], starts[turn], ends[turn])


def _concatenated(parts: list[Ints]) -> Ints:
    return np.concatenate(parts) if parts else np.zeros(0, np.int64)
