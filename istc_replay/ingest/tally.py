"""Counting the messages of a walk: how many each channel has, over what span, and which are wanted."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from istc_replay.ingest.batches import Ints, distinct
from istc_replay.ingest.problems import Problems
from istc_replay.ingest.records import Channel

Wanted = Callable[[Channel], bool]
#: Messages of one channel and batch that are told one by one; the others are counted.
_TOLD = 5
_BEYOND = np.uint64(2**63)


class Tally:
    """Counts of one walk; see the attributes of LogFile.

    Parameters
    ----------
    problems : Problems
        Told of messages whose channel nobody declared.
    wants : callable, optional
        Which channels' messages are wanted, asked once a channel; all without it.
    """

    def __init__(self, problems: Problems, wants: Wanted | None) -> None:
        self.messages = 0
        self.counts: dict[Channel, int] = {}
        self.spans: dict[Channel, tuple[int, int]] = {}
        self.start_ns: int | None = None
        self.end_ns: int | None = None
        self._problems, self._wants = problems, wants
        self._wanted: dict[Channel, bool] = {}

    def count(
        self,
        ids: NDArray[np.uint16],
        log_times_ns: NDArray[np.uint64],
        offsets: Ints,
        declared: Mapping[int, Channel],
    ) -> tuple[dict[int, Channel], bool]:
        """Count messages, all arrays (n,); returns the wanted channels by id, and whether these are all."""
        self.messages += len(ids)
        self._span(log_times_ns)
        found, own = distinct(ids)
        order = np.argsort(own, kind="stable")
        bounds = np.searchsorted(own[order], np.arange(len(found) + 1))
        sorted_ns = log_times_ns[order]
        lows = np.minimum.reduceat(sorted_ns, bounds[:-1]).tolist()
        highs = np.maximum.reduceat(sorted_ns, bounds[:-1]).tolist()
        wanted: dict[int, Channel] = {}
        for row, channel_id in enumerate(found.tolist()):
            channel = declared.get(channel_id)
            if channel is None:
                self._nobodys(channel_id, offsets[order[bounds[row] : bounds[row + 1]]])
                continue
            count, low, high = int(bounds[row + 1] - bounds[row]), lows[row], highs[row]
            known = self.spans.get(channel, (low, high))
            self.spans[channel] = min(low, known[0]), max(high, known[1])
            self.counts[channel] = self.counts.get(channel, 0) + count
            if self._is_wanted(channel):
                wanted[channel_id] = channel
        return wanted, len(wanted) == len(found)

    def declared(self, channels: Mapping[int, Channel]) -> None:
        """Note channels that may have no messages."""
        for channel in channels.values():
            self.counts.setdefault(channel, 0)

    def _nobodys(self, channel_id: int, offsets: Ints) -> None:
        detail = f"a message of channel {channel_id}, which is not declared"
        for offset in offsets[:_TOLD].tolist():
            self._problems.lose("unknown_channel", detail, offset)
        if len(offsets) > _TOLD:
            self._problems.add("unknown_channel", detail, times=len(offsets) - _TOLD)

    def _is_wanted(self, channel: Channel) -> bool:
        wanted = self._wanted.get(channel)
        if wanted is None:
            wanted = self._wanted[channel] = self._wants is None or self._wants(channel)
        return wanted

    def _span(self, log_times_ns: NDArray[np.uint64]) -> None:
        known = log_times_ns[log_times_ns < _BEYOND]
        if len(known):
            first, last = int(known.min()), int(known.max())
            self.start_ns = first if self.start_ns is None else min(self.start_ns, first)
            self.end_ns = last if self.end_ns is None else max(self.end_ns, last)
