"""Messages by the batch: many records of one buffer as columns, so that none is handled alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from istc_replay.ingest.records import Buffer, Channel, Message

Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]

#: A message's record up to its data, byte for byte.
HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Messages of one buffer, in file order; all arrays have the shape (n,).

    `starts` and `ends` span the payloads in the buffer, `channel_ids` are keys of `channels`,
    `offsets` are the bytes of the file where the records, or their chunks, stand. The times are
    unsigned 64-bit integers [ns], so may pass int64.
    """

    buffer: Buffer
    channels: dict[int, Channel]
    channel_ids: NDArray[np.uint16]
    sequences: NDArray[np.uint32]
    log_times_ns: NDArray[np.uint64]
    publish_times_ns: NDArray[np.uint64]
    starts: Ints
    ends: Ints
    offsets: Ints

    def __len__(self) -> int:
        return len(self.starts)

    def messages(self) -> Iterator[Message]:
        """Give the messages one by one."""
        columns = (
            self.channel_ids,
            self.sequences,
            self.log_times_ns,
            self.publish_times_ns,
            self.starts,
            self.ends,
            self.offsets,
        )
        for channel, sequence, log_ns, publish_ns, start, end, offset in zip(
            *(column.tolist() for column in columns), strict=True
        ):
            data = self.buffer[start:end]
            yield Message(self.channels[channel], sequence, log_ns, publish_ns, data, offset)


def rows(data: Bytes, starts: Ints, size: int) -> Bytes:
    """Copy the size bytes at each of the starts, shape (n, size).

    Every start + size must lie within the data.
    """
    if not len(starts) or not size:
        return np.empty((len(starts), size), np.uint8)
    # One element of this view is a whole row, so that a row is copied at once.
    windows: NDArray[np.void] = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    return windows[starts].view(np.uint8).reshape(len(starts), size)


def heads(data: Bytes, positions: Ints) -> NDArray[np.void]:
    """Read the message records' heads at the positions, shape (n,) of HEAD."""
    return rows(data, positions, HEAD.itemsize).view(HEAD).reshape(-1)


def distinct(values: NDArray[Any]) -> tuple[NDArray[Any], Ints]:
    """Return the different numbers, in order, and for each value its place among them."""
    if len(values) and values.dtype.kind in "iu":
        low, high = int(values.min()), int(values.max())
        if high - low < 4 * len(values) + 1024:
            # A table is faster than sorting.
            offsets = (values - values.dtype.type(low)).astype(np.int64)
            there = np.zeros(high - low + 1, np.bool_)
            there[offsets] = True
            ranks = np.cumsum(there) - 1
            return np.flatnonzero(there).astype(values.dtype) + values.dtype.type(low), ranks[offsets]
    found, own = np.unique(values, return_inverse=True)
    return found, own.reshape(-1)
