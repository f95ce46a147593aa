"""States as the decoders give them, gathered into columns."""

from __future__ import annotations

import math
from array import array
from typing import NamedTuple, Protocol

import numpy as np
import polars as pl

from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.records import Message
from istc_replay.states import STATES_SCHEMA, conform

#: Longest payload that is decoded [bytes]: objects take some 60 times their bytes while decoded.
PAYLOAD_LIMIT = 4 * 2**20

_ID_LIMIT = 256
_INT64 = 2**63


class PayloadError(ValueError):
    """A payload or a schema cannot be decoded; `code` is the problem's."""

    def __init__(self, detail: str, code: str = "payload") -> None:
        super().__init__(detail)
        self.code = code


class State(NamedTuple):
    """One vehicle's state in one message; None where the message is silent.

    The position is that of the channel's reference point, in the map frame; the time is the
    message's own.
    """

    vehicle_id: str
    header_ns: int | None
    role: str
    x_m: float | None
    y_m: float | None
    heading_rad: float | None = None
    speed_mps: float | None = None
    acceleration_mps2: float | None = None
    steering_rad: float | None = None
    steering_rate_radps: float | None = None
    jerk_mps3: float | None = None
    length_m: float | None = None
    width_m: float | None = None
    wheelbase_m: float | None = None
    rear_axle_to_centre_m: float | None = None


class Reader(Protocol):
    """Decodes the payloads of one channel."""

    def states(self, data: bytes) -> list[State]:
        """Decode one payload.

        Raises
        ------
        PayloadError
            If the payload cannot be decoded.
        """


_FLOATS = State._fields[3:]


class StateColumns:
    """Columns of the states table, in the order of the file; a NaN in them stands for null."""

    def __init__(self, time_source: str, limit: int, problems: Problems) -> None:
        self._time_source = time_source
        self._limit = limit
        self._problems = problems
        self._texts: dict[str, int] = {}
        self._codes = {name: array("l") for name in ("vehicle_id", "role", "topic")}
        names = ("time_ns", "log_time_ns", "publish_time_ns", "message_index")
        self._ints = {name: array("q") for name in names}
        self._floats = tuple(array("d") for _ in _FLOATS)

    def add(self, state: State, message: Message, message_index: int) -> None:
        """Take in one state; what cannot stand in the table is left out and told."""
        topic = message.channel.topic
        times = self._times(state, message)
        if any(not -_INT64 <= time < _INT64 for time in times):
            worst = max(times, key=abs)
            detail = f"a time of {worst} ns on {quoted(topic)} is beyond int64; its state is left out"
            self._problems.add("time_overflow", detail, message.offset)
            return
        if not 0 < len(state.vehicle_id) <= _ID_LIMIT:
            detail = (
                f"a state on {quoted(topic)} has no vehicle id of 1 to {_ID_LIMIT} characters; it is left out"
            )
            self._problems.add("no_vehicle_id", detail, message.offset, topic)
            return
        if len(self._floats[0]) >= self._limit:
            detail = f"more than {self._limit} states in a file of this size; the rest is left out"
            self._problems.lose("too_many_states", detail, message.offset)
            return
        for column, value in zip(self._ints.values(), (*times, message_index), strict=True):
            column.append(value)
        for column, text in zip(self._codes.values(), (state.vehicle_id, state.role, topic), strict=True):
            column.append(self._texts.setdefault(text, len(self._texts)))
        for name, numbers, number in zip(_FLOATS, self._floats, state[3:], strict=True):
            if number is None:
                number = math.nan
            elif not math.isfinite(number):
                vehicle = quoted(state.vehicle_id)
                detail = f"{name} of vehicle {vehicle} on {quoted(topic)} is {number}; taken as unknown"
                self._problems.add("not_finite", detail, message.offset, topic)
                number = math.nan
            numbers.append(number)

    def _times(self, state: State, message: Message) -> tuple[int, int, int]:
        log_ns, publish_ns = message.log_time_ns, message.publish_time_ns
        if self._time_source == "log":
            return log_ns, log_ns, publish_ns
        if self._time_source == "publish":
            return publish_ns, log_ns, publish_ns
        if state.header_ns is None:
            topic = message.channel.topic
            detail = f"a message on {quoted(topic)} has no time of its own; its log time is taken"
            self._problems.add("no_header_time", detail, message.offset, topic)
            return log_ns, log_ns, publish_ns
        return state.header_ns, log_ns, publish_ns

    def table(self) -> pl.DataFrame:
        """Return the states with the columns of STATES_SCHEMA, in the order of the file."""
        texts = pl.Series(list(self._texts), dtype=pl.String)
        columns: dict[str, pl.Series] = {}
        for name, codes in self._codes.items():
            columns[name] = texts.gather(np.frombuffer(codes, dtype=np.int64)) if codes else texts.head(0)
        for name, integers in self._ints.items():
            columns[name] = pl.Series(np.array(integers, dtype=np.int64))
        for name, floats in zip(_FLOATS, self._floats, strict=True):
            columns[name] = pl.Series(np.array(floats, dtype=np.float64)).fill_nan(None)
        columns["derived"] = pl.Series(np.zeros(len(self._floats[0]), dtype=np.uint8))
        return conform(pl.DataFrame(columns), STATES_SCHEMA)
