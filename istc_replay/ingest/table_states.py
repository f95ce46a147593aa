"""A piece of a table on the way to states: its times, numbers, names and roles."""

from __future__ import annotations

import math

import polars as pl

from istc_replay.errors import LogError
from istc_replay.ingest.meaning import PLAIN, ROLES
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.states import STATES_SCHEMA, conform
from istc_replay.units import wrap_angle

#: Nanoseconds of one unit of a time.
TIMES_NS = {"time_ns": 1, "time_us": 1_000, "time_ms": 1_000_000, "time_s": 1_000_000_000}
_ID_LIMIT = 256
_ABOVE_ZERO = ("length_m", "width_m", "wheelbase_m")
#: How unknown numbers are written.
_EMPTY = ("", "nan", "null", "none", "na", "n/a")
#: Roles as other tools name them; what is not here is a vehicle.
_ROLE_OF = {
    **dict.fromkeys(("pedestrian", "person", "pedestrians", "walker"), "pedestrian"),
    **dict.fromkeys(("bicycle", "cyclist", "bike"), "bicycle"),
    **dict.fromkeys(("other", "unknown", "static", "animal"), "other"),
}


class Piece:
    """A part of a table on the way to states.

    Parameters
    ----------
    table : DataFrame
        The columns that are wanted, by their names in the file.
    numbers : list of int
        Number of each row in the file.
    unit : str
        What is numbered, for problems: line or row.
    names : dict of str to str
        Names of columns by what they tell.
    problems : Problems
        Is told what is left out.
    unit_of_time : list of int
        Nanoseconds of one unit of times whose name tells none; the first piece decides.
    """

    def __init__(
        self,
        table: pl.DataFrame,
        numbers: list[int],
        unit: str,
        names: dict[str, str],
        problems: Problems,
        unit_of_time: list[int],
    ) -> None:
        self._unit_of_time = unit_of_time
        self._table, self._numbers, self._unit = table, numbers, unit
        self._names, self._problems = names, problems
        self._bad = pl.repeat(value=False, n=table.height, dtype=pl.Boolean, eager=True)

    def states(self) -> pl.DataFrame:
        """Return the states of the rows that are sound; the others are told."""
        columns = {"time_ns": self._times(), "vehicle_id": self._vehicles(), "role": self._roles()}
        for target in PLAIN:
            if target in self._names:
                columns[target] = self._floats(target)
        if "heading_deg" in self._names and "heading_rad" not in columns:
            columns["heading_rad"] = self._floats("heading_deg").radians()
        table = pl.DataFrame(columns)
        if "heading_rad" in columns:
            heading = table["heading_rad"]
            wrapped = pl.Series(wrap_angle(heading.to_numpy()), nan_to_null=True)
            # What is in range stays as it was told, to the bit.
            inside = heading.is_between(-math.pi, math.pi, closed="left")
            table = table.with_columns(heading_rad=pl.when(inside).then(heading).otherwise(wrapped))
        if {"velocity_x_mps", "velocity_y_mps"} <= self._names.keys() and "speed_mps" not in columns:
            table = self._speeds(table)
        missing = table.select(pl.any_horizontal(pl.col("time_ns", "x_m", "y_m").is_null())).to_series()
        self._refuse(missing, "time, x or y is empty")
        return conform(table.filter(~self._bad), STATES_SCHEMA)

    def _speeds(self, table: pl.DataFrame) -> pl.DataFrame:
        x, y = self._floats("velocity_x_mps"), self._floats("velocity_y_mps")
        if "heading_rad" not in table.columns:
            return table.with_columns(speed_mps=(x**2 + y**2).sqrt())
        heading = table["heading_rad"]
        return table.with_columns(speed_mps=x * heading.cos() + y * heading.sin())

    def _column(self, target: str) -> pl.Series:
        return self._table[self._names[target]]

    def _floats(self, target: str) -> pl.Series:
        raw = self._column(target)
        if raw.dtype == pl.String:
            text = raw.str.strip_chars()
            values = text.cast(pl.Float64, strict=False)
            # How other tools write what is not known.
            empty = text.str.to_lowercase().is_in(_EMPTY).fill_null(value=True)
        elif raw.dtype.is_numeric() or raw.dtype == pl.Null:
            values = raw.cast(pl.Float64)
            empty = values.is_null() | values.is_nan().fill_null(value=True)
        else:
            raise LogError(f"column {quoted(raw.name, 40)} holds {raw.dtype}, not numbers")
        sound = values.is_finite().fill_null(value=False)
        rule = "not a finite number"
        if target in _ABOVE_ZERO:
            sound &= (values > 0.0).fill_null(value=False)
            rule = "not a number above 0"
        self._refuse(~(sound | empty), rule, raw)
        return values.set(~sound, None)

    def _times(self) -> pl.Series:
        target = next(name for name in (*TIMES_NS, "time") if name in self._names)
        raw = self._column(target)
        if raw.dtype.is_temporal():
            raw, target = raw.cast(pl.Datetime("ns")).cast(pl.Int64), "time_ns"
        text = raw.str.strip_chars() if raw.dtype == pl.String else raw
        exact_type = raw.dtype == pl.String or raw.dtype.is_integer()
        none = pl.repeat(None, raw.len(), dtype=pl.Int64, eager=True)
        whole = text.cast(pl.Int64, strict=False) if exact_type else none
        about = text.cast(pl.Float64, strict=False)
        factor = TIMES_NS.get(target) or self._plain_factor(about)
        limit = 2**63 // factor - 1
        exact = ((whole >= 0) & (whole <= limit)).fill_null(value=False)
        near = (about.is_finite() & (about >= 0.0) & (about < float(limit))).fill_null(value=False)
        self._refuse(~(exact | near), "no time from 0 up that fits int64 nanoseconds", raw)
        # In parts, since a float of seconds since 1970 times 1e9 has no nanoseconds.
        sound = about.set(~near, 0.0)
        units = sound.floor()
        rounded = units.cast(pl.Int64) * factor + ((sound - units) * factor).round().cast(pl.Int64)
        return (whole.set(~exact, 0) * factor).set(~exact, None).fill_null(rounded)

    def _plain_factor(self, times: pl.Series) -> int:
        """Nanoseconds of one unit of times whose name does not tell it: by the first piece's size."""
        if self._unit_of_time:
            return self._unit_of_time[0]
        size = times.abs().median()
        bounds = ((1e11, "time_s"), (1e14, "time_ms"), (1e17, "time_us"), (math.inf, "time_ns"))
        target = next(name for below, name in bounds if not (isinstance(size, float) and size >= below))
        self._unit_of_time.append(TIMES_NS[target])
        name = quoted(self._names["time"], 40)
        self._problems.add("unit_assumed", f"column {name} is taken as {target}, by the size of its numbers")
        return TIMES_NS[target]

    def _vehicles(self) -> pl.Series:
        raw = self._column("vehicle_id").cast(pl.String)
        lengths = raw.str.len_chars().fill_null(0)
        wrong = (lengths < 1) | (lengths > _ID_LIMIT)
        self._refuse(wrong, f"no id of 1 to {_ID_LIMIT} characters", raw)
        return raw

    def _roles(self) -> pl.Series:
        if "role" not in self._names:
            return pl.repeat(ROLES[0], self._table.height, dtype=pl.String, eager=True)
        raw = self._column("role").cast(pl.String).str.to_lowercase().fill_null("")
        return raw.replace_strict(_ROLE_OF, default=ROLES[0], return_dtype=pl.String)

    def _refuse(self, wrong: pl.Series, rule: str, raw: pl.Series | None = None) -> None:
        """Leave rows out, and tell them once each."""
        for row in (wrong & ~self._bad).arg_true().to_list():
            where = f"{self._unit} {self._numbers[row]}"
            if raw is None:
                detail = f"{where}: {rule}; left out"
            else:
                value, column = quoted(str(raw[row]), 40), quoted(raw.name, 40)
                detail = f"{where}, column {column}: {value} is {rule}; the {self._unit} is left out"
            self._problems.lose("bad_value", detail)
        self._bad |= wrong
