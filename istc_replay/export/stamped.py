"""Messages with their instants, and their order in a file."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from typing import Any

#: Time [ns], topic, message.
Stamped = tuple[int, str, Any]


def place(stamped: Stamped) -> tuple[int, str]:
    """Where a message stands in a file.

    MCAP's times are unsigned; a log may count from an origin in its midst.
    """
    return max(stamped[0], 0), stamped[1]


def in_order(groups: Iterable[tuple[int, Iterable[Stamped]]]) -> Iterator[Stamped]:
    """Give messages in their order in the file, holding back as few as possible.

    Parameters
    ----------
    groups : iterable of (int, iterable of Stamped)
        The start of each, ascending, and its messages, none of them before it. Messages of one
        topic and instant keep their order.
    """
    held: list[Stamped] = []
    for start_ns, messages_of_group in groups:
        begin = (max(start_ns, 0), "")
        ready = [stamped for stamped in held if place(stamped) < begin]
        held = [stamped for stamped in held if place(stamped) >= begin]
        yield from ready
        held += messages_of_group
        held.sort(key=place)
    yield from held


def merged(*sources: Iterable[Stamped]) -> Iterator[Stamped]:
    """Join messages that are each in their order; of one topic and instant, in that of the sources."""
    return heapq.merge(*sources, key=place)
