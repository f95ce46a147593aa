"""Recordings that are no MCAP logs: states gathered row by row, what is wrong told by its line."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass
from decimal import Decimal

import polars as pl

from istc_replay.datatypes import Problem, StaticScene
from istc_replay.errors import LogError
from istc_replay.ingest.meaning import PLAIN
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.states import STATES_SCHEMA, conform
from istc_replay.units import NS_PER_S, wrap_angle

#: States that are held: beyond this, a recording is better cut first.
STATES_LIMIT = 20_000_000
_ID_LIMIT = 256
_LAST_S = 9.2e9


@dataclass(frozen=True, slots=True, eq=False)
class ForeignRecording:
    """A recording read from another format than MCAP.

    `states` has the columns of STATES_SCHEMA that the format tells, box centres, sorted by time
    and vehicle; `complete` is False where a part of it was left out.
    """

    kind: str
    states: pl.DataFrame
    scene: StaticScene
    problems: tuple[Problem, ...]
    complete: bool
    notes: tuple[str, ...] = ()


class Gathered:
    """States as they are read."""

    def __init__(self, problems: Problems) -> None:
        self.problems = problems
        self._times = array("q")
        self._codes: dict[str, int] = {}
        self._vehicles, self._roles = array("l"), array("b")
        self._role_codes: dict[str, int] = {}
        self._numbers = {name: array("d") for name in PLAIN}

    def __len__(self) -> int:
        return len(self._times)

    def add(self, time_ns: int, vehicle_id: str, role: str, numbers: dict[str, float | None]) -> None:
        """Take in a state.

        Raises
        ------
        LogError
            If there are more than can be held.
        """
        if len(self._times) >= STATES_LIMIT:
            raise LogError(f"more than {STATES_LIMIT} states: cut the recording into shorter ones first")
        self._times.append(time_ns)
        self._vehicles.append(self._codes.setdefault(vehicle_id, len(self._codes)))
        self._roles.append(self._role_codes.setdefault(role, len(self._role_codes)))
        for name, column in self._numbers.items():
            value = numbers.get(name)
            column.append(math.nan if value is None else value)

    def table(self) -> pl.DataFrame:
        """Return the states, sorted by time and vehicle."""
        columns = {name: pl.Series(name, column, nan_to_null=True) for name, column in self._numbers.items()}
        ids, roles = pl.Series(list(self._codes), dtype=pl.String), pl.Series(list(self._role_codes))
        table = pl.DataFrame(
            {
                "time_ns": pl.Series(self._times, dtype=pl.Int64),
                "vehicle_id": ids.gather(pl.Series(self._vehicles, dtype=pl.UInt32)),
                "role": roles.gather(pl.Series(self._roles, dtype=pl.UInt32)),
                **columns,
            }
        )
        return conform(table.sort("time_ns", "vehicle_id", maintain_order=True), STATES_SCHEMA)


class BadValueError(ValueError):
    """A value that cannot be used; the message names it and the rule."""


def finite(text: str, name: str) -> float:
    """Read a finite number.

    Raises
    ------
    BadValueError
        If it is none.
    """
    try:
        value = float(text)
    except ValueError:
        raise BadValueError(f"{name} is {quoted(text, 40)}, not a number") from None
    if not math.isfinite(value):
        raise BadValueError(f"{name} is {quoted(text, 40)}, not a finite number")
    return value


def above_zero(text: str, name: str) -> float:
    """Read a finite number above 0."""
    value = finite(text, name)
    if value <= 0.0:
        raise BadValueError(f"{name} is {quoted(text, 40)}; it must be above 0")
    return value


def nanoseconds(text: str, name: str, unit_s: float = 1.0) -> int:
    """Read a time in units of unit_s as nanoseconds that fit int64, none below 0.

    Raises
    ------
    BadValueError
        If it is no number, or beyond these.
    """
    time_s = finite(text, name) * unit_s
    if not 0.0 <= time_s < _LAST_S:
        raise BadValueError(f"{name} is {quoted(text, 40)}; it must be from 0 to {_LAST_S:g} s")
    # In decimals: a float of seconds since 1970 has no nanoseconds.
    return round(Decimal(text.strip()) * Decimal(repr(unit_s)) * NS_PER_S)


def turned(heading_rad: float) -> float:
    """Wrap a heading to [-pi, pi); one that is inside stays as it is, to the bit."""
    return heading_rad if -math.pi <= heading_rad < math.pi else float(wrap_angle(heading_rad))


def vehicle_name(text: str) -> str:
    """Check a vehicle's id."""
    if not 0 < len(text) <= _ID_LIMIT:
        raise BadValueError(f"a vehicle id of {len(text)} characters; it must have 1 to {_ID_LIMIT}")
    return text
