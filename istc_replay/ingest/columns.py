"""States as the decoders give them, gathered into columns."""

from __future__ import annotations

from typing import NamedTuple, Protocol

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


_KEYS = ("time_ns", "log_time_ns", "publish_time_ns", "message_index", "topic")
_SCHEMA = pl.Schema(
    {name: STATES_SCHEMA[name] for name in (*_KEYS, "vehicle_id", "role", *State._fields[3:])}
)
_FLOATS = State._fields[3:]
_BATCH = 8192


class StateColumns:
    """The states of a log as columns, in the order of the file."""

    def __init__(self, time_source: str, limit: int, problems: Problems) -> None:
        self._time_source = time_source
        self._limit = limit
        self._problems = problems
        self._count = 0
        self._rows: list[tuple[object, ...]] = []
        self._offsets: list[int] = []
        self._batches: list[pl.DataFrame] = []

    def add(self, state: State, message: Message, message_index: int) -> None:
        """Take in one state; what cannot stand in the table is left out and told."""
        topic = message.channel.topic
        times = self._times(state, message)
        if max(times) >= _INT64 or min(times) < -_INT64:
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
        if self._count >= self._limit:
            detail = f"more than {self._limit} states in a file of this size; the rest is left out"
            self._problems.lose("too_many_states", detail, message.offset)
            return
        self._count += 1
        self._rows.append((*times, message_index, topic, state.vehicle_id, *state[2:]))
        self._offsets.append(message.offset)
        if len(self._rows) == _BATCH:
            self._close_batch()

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

    def _close_batch(self) -> None:
        values = zip(*self._rows, strict=True)
        batch = pl.DataFrame(
            [
                pl.Series(name, column, dtype)
                for (name, dtype), column in zip(_SCHEMA.items(), values, strict=True)
            ]
        )
        for name in _FLOATS:
            wrong = (~batch[name].is_finite()).arg_true()
            for row in wrong:
                self._tell_not_finite(batch, name, row)
            if len(wrong):
                finite = pl.when(pl.col(name).is_finite()).then(name)
                batch = batch.with_columns(finite.alias(name))
        self._batches.append(batch)
        self._rows, self._offsets = [], []

    def _tell_not_finite(self, batch: pl.DataFrame, name: str, row: int) -> None:
        topic, vehicle = batch["topic"][row], quoted(batch["vehicle_id"][row])
        detail = f"{name} of vehicle {vehicle} on {quoted(topic)} is {batch[name][row]}; taken as unknown"
        self._problems.add("not_finite", detail, self._offsets[row], topic)

    def table(self) -> pl.DataFrame:
        """Return the states with the columns of STATES_SCHEMA, in the order of the file."""
        if self._rows:
            self._close_batch()
        states = pl.concat([pl.DataFrame(schema=_SCHEMA), *self._batches])
        return conform(states.with_columns(derived=pl.lit(0)), STATES_SCHEMA)
