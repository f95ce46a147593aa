"""Columns of states, gathered in blocks as the payloads are decoded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from istc_replay.ingest.batches import distinct
from istc_replay.ingest.channels import Format
from istc_replay.ingest.meaning import Floats, Names, States, vehicle_of
from istc_replay.ingest.problems import Problems, quoted

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

_ID_LIMIT = 256
#: Faults of one kind in one block that are told one by one; the others are counted.
_TOLD = 5


@dataclass(frozen=True, slots=True, eq=False)
class Payloads:
    """What a block's payloads carry beside their data; all arrays (n,), one entry a payload."""

    ordinals: Ints  # place in the log
    log_ns: NDArray[np.uint64]
    publish_ns: NDArray[np.uint64]
    topics: Ints  # codes
    indexes: Ints  # place within the topic
    offsets: Ints


@dataclass(slots=True, eq=False)
class Block:
    """States in the order of the log, all arrays (m,); floats are NaN where nothing is told.

    `whole` has the columns of STATES_SCHEMA that are integers, codes of names among them, and
    `ordinal`, `frame` and `child`.
    """

    whole: dict[str, Ints]
    numbers: dict[str, Floats]
    format: str
    family: str
    rank: int

    def only(self, index: Ints | Mask) -> Block:
        """Return the states at the index alone."""
        whole = {name: column[index] for name, column in self.whole.items()}
        numbers = {name: column[index] for name, column in self.numbers.items()}
        return Block(whole, numbers, self.format, self.family, self.rank)


class Gatherer:
    """Makes blocks of states; what cannot stand in the table is left out and told."""

    def __init__(self, time_source: str, limit: int, problems: Problems, names: Names) -> None:
        self._time_source = time_source
        self._left, self._limit, self._full = limit, limit, False
        self._items = 2 * limit  # with those that are no states
        self._problems, self._names = problems, names
        self._pairs: dict[tuple[int, int], int] = {}

    @property
    def full(self) -> bool:
        """No more states are taken; that was told."""
        return self._full

    def block(
        self, states: States, payloads: Payloads, own: dict[int, int], format_: Format, rank: int
    ) -> Block:
        """Make the block of one group's states.

        Parameters
        ----------
        states : States
            Its `rows` are rows of `payloads`.
        payloads : Payloads
            What the payloads carry.
        own : dict[int, int]
            The vehicle that the configuration gives to a topic, both as codes.
        format_ : Format
            What the payloads are read as.
        rank : int
            The block's own.
        """
        rows = states.rows
        topics = payloads.topics[rows]
        time_ns, wild = self._times(states, payloads, topics)
        vehicles = self._vehicles(states, topics, own, format_.many)
        nameless = self._nameless(vehicles)
        offsets = payloads.offsets[rows]
        self._tell(nameless & ~wild, topics, offsets)
        keep = np.flatnonzero(~wild & ~nameless)
        self._items -= len(rows)
        if self._items < 0 and not self._full:
            detail = f"more than {2 * self._limit} items in a file of this size; the rest is left out"
            self._problems.lose("too_many_states", detail, int(offsets[-1]))
            self._full = True
        if len(keep) > self._left:
            detail = f"more than {self._limit} states in a file of this size; the rest is left out"
            self._problems.lose("too_many_states", detail, int(offsets[keep[self._left]]))
            keep = keep[: self._left]
            self._full = True
        self._left -= len(keep)
        whole = {
            "ordinal": payloads.ordinals[rows],
            "time_ns": time_ns,
            "log_time_ns": payloads.log_ns[rows].astype(np.int64),
            "publish_time_ns": payloads.publish_ns[rows].astype(np.int64),
            "message_index": payloads.indexes[rows],
            "topic": topics,
            "vehicle": vehicles,
            "frame": states.frames,
            "child": states.children,
            "role": states.roles,
        }
        numbers = {
            name: values if states.known[name].all() else np.where(states.known[name], values, np.nan)
            for name, values in states.numbers.items()
        }
        for name, column in numbers.items():
            numbers[name] = self._finite(name, column, states.known[name], vehicles, topics, offsets)
        block = Block(whole, numbers, format_.name, format_.family, rank)
        return block if len(keep) == len(rows) else block.only(keep)

    def _times(self, states: States, payloads: Payloads, topics: Ints) -> tuple[Ints, Mask]:
        """Times by the chosen source, and where any time is beyond int64."""
        rows = states.rows
        log_ns, publish_ns = payloads.log_ns[rows], payloads.publish_ns[rows]
        wild = (log_ns >= 2**63) | (publish_ns >= 2**63)
        if self._time_source == "log":
            time_ns = log_ns.astype(np.int64)
        elif self._time_source == "publish":
            time_ns = publish_ns.astype(np.int64)
        else:
            time_ns = np.where(states.stamped, states.header_ns, log_ns.astype(np.int64))
            wild |= states.overflows
            unstamped = ~states.stamped
            for topic, name in self._each(topics[unstamped]):
                detail = f"a message on {quoted(name)} has no time of its own; its log time is taken"
                hit = np.flatnonzero(unstamped & (topics == topic))
                offset = int(payloads.offsets[rows[hit[0]]])
                self._problems.add("no_header_time", detail, offset, name, len(hit))
        if wild.any():
            for topic, name in self._each(topics[wild]):
                hit = np.flatnonzero(wild & (topics == topic))
                detail = f"a time on {quoted(name)} is beyond int64; its state is left out"
                offset = int(payloads.offsets[rows[hit[0]]])
                self._problems.add("time_overflow", detail, offset, name, len(hit))
        return time_ns, wild

    def _each(self, topics: Ints) -> list[tuple[int, str]]:
        return [(topic, self._names.texts[topic]) for topic in np.unique(topics).tolist()]

    def _vehicles(self, states: States, topics: Ints, own: dict[int, int], many: bool) -> Ints:
        """Codes of the vehicles: as told, else by the frame and the topic; -1 where there is none."""
        vehicles = states.vehicles
        if own and not many:
            given = np.array([own.get(topic, -1) for topic in range(max(own) + 1)], np.int64)
            configured = np.where(topics < len(given), given[np.minimum(topics, len(given) - 1)], -1)
            vehicles = np.where(configured >= 0, configured, vehicles)
        open_ = np.flatnonzero(vehicles < 0)
        if not len(open_):
            return vehicles
        children = states.children[open_]
        if many and (children < 0).all():
            return self._numbered(vehicles, open_, states.rows, topics)
        width = len(self._names.texts) + 1
        pairs, places = distinct(topics[open_] * width + children + 1)
        codes = [self._by_frame(pair // width, pair % width - 1) for pair in pairs.tolist()]
        vehicles = vehicles.copy()
        vehicles[open_] = np.array(codes, np.int64)[places]
        return vehicles

    def _by_frame(self, topic: int, child: int) -> int:
        key = (topic, child)
        if key not in self._pairs:
            frame = self._names.texts[child] if child >= 0 else ""
            self._pairs[key] = self._names.code(vehicle_of(self._names.texts[topic], frame))
        return self._pairs[key]

    def _numbered(self, vehicles: Ints, open_: Ints, rows: Ints, topics: Ints) -> Ints:
        """Name items that nothing names by their topic and their place in the message."""
        first = np.zeros(len(rows), np.int64)
        starts = np.flatnonzero(np.diff(rows, prepend=-1))
        first[starts] = starts
        place = np.arange(len(rows)) - np.maximum.accumulate(first)
        vehicles = vehicles.copy()
        width = len(rows)
        pairs, own = distinct(topics[open_] * width + place[open_])
        parts = [divmod(pair, width) for pair in pairs.tolist()]
        names = [f"{vehicle_of(self._names.texts[topic], '')}/{k}" for topic, k in parts]
        vehicles[open_] = np.array([self._names.code(name) for name in names], np.int64)[own]
        return vehicles

    def _nameless(self, vehicles: Ints) -> Mask:
        used = distinct(vehicles)[0]
        bad = [
            code for code in used.tolist() if code < 0 or not 0 < len(self._names.texts[code]) <= _ID_LIMIT
        ]
        return np.isin(vehicles, bad) if bad else np.zeros(len(vehicles), np.bool_)

    def _tell(self, nameless: Mask, topics: Ints, offsets: Ints) -> None:
        for topic, name in self._each(topics[nameless]):
            hit = np.flatnonzero(nameless & (topics == topic))
            rule = f"no vehicle id of 1 to {_ID_LIMIT} characters"
            detail = f"a state on {quoted(name)} has {rule}; it is left out"
            self._problems.add("no_vehicle_id", detail, int(offsets[hit[0]]), name, len(hit))

    def _finite(
        self, name: str, column: Floats, known: Mask, vehicles: Ints, topics: Ints, offsets: Ints
    ) -> Floats:
        """Take what is not finite as unknown, and tell it; returns the column so."""
        wrong = np.flatnonzero(~np.isfinite(column) & known)
        if not len(wrong):
            return column
        texts = self._names.texts
        for count, row in enumerate(wrong[:_TOLD].tolist()):
            topic = texts[topics[row]]
            vehicle = quoted(texts[vehicles[row]] if vehicles[row] >= 0 else "")
            detail = f"{name} of vehicle {vehicle} on {quoted(topic)} is {column[row]}; taken as unknown"
            times = len(wrong) - _TOLD + 1 if count == _TOLD - 1 else 1
            self._problems.add("not_finite", detail, int(offsets[row]), topic, times)
        column = column.copy()  # it may be a view of what was decoded
        column[wrong] = np.nan
        return column
