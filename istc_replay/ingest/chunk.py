"""The records of one inflated chunk: its messages' places at once, its other records one by one."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np

from istc_replay.ingest.batches import Ints, rows
from istc_replay.ingest.records import RECORD, Buffer, MalformedRecordError, Opcode

#: A message index before its entries: record head, channel id, bytes of entries.
_INDEX = struct.Struct("<BQHI")
_ENTRY = 16


def chunk_records(data: bytes, hint: Ints | None) -> Iterator[tuple[int, Ints | list[int]]]:
    """Give the records of a chunk in order.

    Parameters
    ----------
    data : bytes
        The inflated records.
    hint : array, optional
        Where the message indexes say that messages are. It only saves time: what it says is taken
        where following the records' lengths would give the same.

    Yields
    ------
    tuple
        The opcode with the positions of the messages, or with start and end of another record's
        content.

    Raises
    ------
    MalformedRecordError
        If a record runs past the end of the chunk; what is before it was given.
    """
    position, size = 0, len(data)
    messages: list[int] = []
    unpack, kind, head = RECORD.unpack_from, int(Opcode.MESSAGE), RECORD.size
    damage = ""
    while position < size:
        if position + head > size:
            damage = "a chunk ends inside the head of a record"
            break
        opcode, length = unpack(data, position)
        end = position + head + length
        if end > size or not opcode:
            left = size - position - head
            damage = f"a record of kind {opcode} and {length} bytes where its chunk has {left} left"
            break
        if opcode == kind:
            if hint is not None:
                rest = _all_messages(data, hint[np.searchsorted(hint, position) :], position)
                hint = None
                if rest is not None:
                    yield kind, rest
                    return
            messages.append(position)
        else:
            if messages:  # what is declared holds for the messages behind it
                yield kind, messages
                messages = []
            yield opcode, [position + head, end]
        position = end
    if messages:
        yield kind, messages
    if damage:
        raise MalformedRecordError(damage)


def _all_messages(data: bytes, positions: Ints, first: int) -> Ints | None:
    """Return the positions if from the first on they are all records up to the end, each a message."""
    size = len(data)
    if not len(positions) or positions[0] != first or positions[-1] > size - RECORD.size:
        return None
    view = np.frombuffer(data, np.uint8)
    if (view[positions] != Opcode.MESSAGE).any():
        return None
    lengths = rows(view, positions + 1, 8).view("<u8").reshape(-1)
    if (lengths > size).any():
        return None
    ends = positions + RECORD.size + lengths.astype(np.int64)
    return positions if (ends[:-1] == positions[1:]).all() and ends[-1] == size else None


def indexed_positions(buffer: Buffer, position: int, size: int, chunk_size: int) -> Ints | None:
    """Read the message indexes that begin at position, behind their chunk.

    Returns
    -------
    array or None
        Positions in the chunk, in order, all below chunk_size; None where there are none.
    """
    found = []
    while position + _INDEX.size <= size:
        opcode, length, _, entries = _INDEX.unpack_from(buffer, position)
        start, end = position + _INDEX.size, position + RECORD.size + length
        if opcode != Opcode.MESSAGE_INDEX or end > size or start + entries > end or entries % _ENTRY:
            break
        found.append(np.frombuffer(buffer, "<u8", entries // 8, start)[1::2])
        position = end
    if not found:
        return None
    positions = np.sort(np.concatenate(found))
    return positions[positions < chunk_size].astype(np.int64)
