"""States from tables: CSV and Parquet, our own columns or others by name or by the configuration."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import polars as pl

from istc_replay.datatypes import StaticScene
from istc_replay.errors import LogError
from istc_replay.ingest.foreign import STATES_LIMIT, ForeignRecording
from istc_replay.ingest.meaning import PLAIN, ROLES
from istc_replay.ingest.parquet import ParquetTable
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.xml_stream import Progress
from istc_replay.states import STATES_SCHEMA, conform
from istc_replay.units import wrap_angle

SUFFIXES = (".csv", ".tsv", ".parquet")
_ROWS = 50_000
_ID_LIMIT = 256
#: The longest field of a CSV file [characters].
_FIELD = 10_000
#: Nanoseconds of one unit of a time.
_TIMES_NS = {"time_ns": 1, "time_us": 1_000, "time_ms": 1_000_000, "time_s": 1_000_000_000}
#: Names that other tools give these columns, in lower case.
_ALSO = {
    "vehicle_id": ("id", "track_id", "trackid", "object_id", "agent_id", "vehicle", "car_id", "name"),
    "role": ("type", "class", "agent_type", "object_type", "object_category"),
    "time_ns": ("timestamp_ns", "stamp_ns", "t_ns"),
    "time_us": ("timestamp_us", "t_us"),
    "time_ms": ("timestamp_ms", "t_ms"),
    "time_s": ("timestamp_s", "t_s", "time_sec", "seconds"),
    "x_m": ("x", "x_center", "xcenter", "position_x", "center_x"),
    "y_m": ("y", "y_center", "ycenter", "position_y", "center_y"),
    "heading_rad": ("psi_rad", "yaw_rad", "yaw", "psi", "theta", "heading"),
    "heading_deg": ("yaw_deg", "psi_deg"),
    "speed_mps": ("speed", "v", "v_mps"),
    "velocity_x_mps": ("vx", "vx_mps", "xvelocity", "velocity_x"),
    "velocity_y_mps": ("vy", "vy_mps", "yvelocity", "velocity_y"),
    "acceleration_mps2": ("acceleration", "a", "accel"),
    "length_m": ("length",),
    "width_m": ("width",),
}
#: Times without a unit, which their size tells.
_PLAIN_TIMES = ("time", "timestamp", "t", "stamp")
_ABOVE_ZERO = ("length_m", "width_m", "wheelbase_m")
#: How unknown numbers are written.
_EMPTY = ("", "nan", "null", "none", "na", "n/a")
#: Roles as other tools name them; what is not here is a vehicle.
_ROLE_OF = {
    **dict.fromkeys(("pedestrian", "person", "pedestrians", "walker"), "pedestrian"),
    **dict.fromkeys(("bicycle", "cyclist", "bike"), "bicycle"),
    **dict.fromkeys(("other", "unknown", "static", "animal"), "other"),
}
#: The longest header of a CSV file [characters].
_HEADER = 2**20


def read_table(path: Path, columns: Mapping[str, str], progress: Progress) -> ForeignRecording:
    """Read states from a CSV or Parquet file; positions are box centres of the map frame.

    Parameters
    ----------
    path : Path
        A file whose name ends in .csv, .tsv or .parquet.
    columns : mapping of str to str
        Names of columns by what they tell; what it does not name is recognised by its name.
    progress : callable
        Told bytes or rows read, and those in all.

    Raises
    ------
    LogError
        If it cannot be read, lacks a column that is needed, or holds no state.
    """
    problems = Problems()
    parts: list[pl.DataFrame] = []
    unit_of_time: list[int] = []
    try:
        source = _Parquet(path, progress) if path.suffix == ".parquet" else _Csv(path, problems, progress)
        names = _recognised(path, source.columns, columns)
        height = 0
        for piece, numbers in source.pieces(sorted(set(names.values()))):
            parts.append(_Piece(piece, numbers, source.unit, names, problems, unit_of_time).states())
            height += parts[-1].height
            if height > STATES_LIMIT:
                raise LogError(f"{path}: more than {STATES_LIMIT} states: cut it into shorter ones first")
    except (OSError, pl.exceptions.PolarsError, csv.Error, UnicodeError) as error:
        reason = " ".join((getattr(error, "strerror", None) or str(error)).split())[:300]
        raise LogError(f"{path}: cannot be read: {reason}") from None
    states = pl.concat(parts) if parts else pl.DataFrame(schema=STATES_SCHEMA)
    if states.is_empty():
        why = f": {problems.first_loss}" if problems.first_loss else ""
        raise LogError(f"{path}: holds no state{why}")
    told = ", ".join(f"{target} from {quoted(name, 40)}" for target, name in names.items() if target != name)
    return ForeignRecording(
        "table",
        conform(states.sort("time_ns", "vehicle_id", maintain_order=True), STATES_SCHEMA),
        StaticScene(),
        problems.found(),
        not problems.lost,
        (told,) if told else (),
    )


# --- the files -----------------------------------------------------------------------------------


class _Csv:
    """A CSV file in pieces of texts; an empty field is null."""

    unit = "line"

    def __init__(self, path: Path, problems: Problems, progress: Progress) -> None:
        self._path, self._problems, self._progress = path, problems, progress
        with self._open() as stream:
            head = stream.readline(_HEADER)
        self._delimiter = max(",;\t|", key=head.count)
        self.columns = [name.strip() for name in next(csv.reader([head], delimiter=self._delimiter), [])]

    def _open(self) -> TextIO:
        return self._path.open(encoding="utf-8-sig", errors="replace", newline="")

    def pieces(self, wanted: Sequence[str]) -> Iterator[tuple[pl.DataFrame, list[int]]]:
        """Give the wanted columns and the lines that they stand on, many rows at a time."""
        places = [self.columns.index(name) for name in wanted]
        csv.field_size_limit(_FIELD)
        size = self._path.stat().st_size
        with self._open() as stream:
            reader = csv.reader(stream, delimiter=self._delimiter)
            next(reader, None)
            rows = self._rows(reader)
            while piece := list(islice(rows, _ROWS)):
                cells = [[row[place] or None for row, _ in piece] for place in places]
                table = pl.DataFrame(
                    dict(zip(wanted, cells, strict=True)), schema=dict.fromkeys(wanted, pl.String)
                )
                yield table, [line for _, line in piece]
                self._progress(stream.buffer.tell(), size)

    def _rows(self, reader: Any) -> Iterator[tuple[list[str], int]]:
        count = len(self.columns)
        while True:
            try:
                row = next(reader)
            except StopIteration:
                return
            except csv.Error as error:
                self._problems.lose("bad_row", f"line {reader.line_num}: left out: {error}")
                continue
            if len(row) == count:
                yield row, reader.line_num
            elif row:
                detail = f"line {reader.line_num}: {len(row)} fields where the header has {count}; left out"
                self._problems.lose("bad_row", detail)


class _Parquet:
    """A Parquet file in pieces."""

    unit = "row"

    def __init__(self, path: Path, progress: Progress) -> None:
        self._table, self._progress = ParquetTable(path), progress
        self.columns = self._table.columns

    def pieces(self, wanted: Sequence[str]) -> Iterator[tuple[pl.DataFrame, list[int]]]:
        """Give the wanted columns and the numbers of their rows, from 1."""
        start = 0
        for piece in self._table.pieces(wanted, _ROWS):
            yield piece, list(range(start + 1, start + 1 + piece.height))
            start += piece.height
            self._progress(start, self._table.height)


# --- the columns ---------------------------------------------------------------------------------


def _recognised(path: Path, columns: Sequence[str], given: Mapping[str, str]) -> dict[str, str]:
    """Return the names of the columns by what they tell."""
    names: dict[str, str] = {}
    for target, name in given.items():
        if name not in columns:
            raise LogError(f"{path}: ingest.columns names {quoted(name, 40)}; it has {_listed(columns)}")
        names[target] = name
    lower = {name.lower(): name for name in reversed(columns)}
    for target in (*_ALSO, *PLAIN):
        if target not in names:
            known = (target, *_ALSO.get(target, ()))
            found = next((lower[name] for name in known if name in lower), None)
            if found is not None and found not in names.values():
                names[target] = found
    if not any(target in names for target in _TIMES_NS):
        plain = next((lower[name] for name in _PLAIN_TIMES if name in lower), None)
        if plain is not None:
            names["time"] = plain
    lacking = [name for name in ("vehicle_id", "x_m", "y_m") if name not in names]
    if not {"time", *_TIMES_NS} & names.keys():
        lacking.append("time_ns or time_s")
    if lacking:
        raise LogError(
            f"{path}: no column tells {', '.join(lacking)}; it has {_listed(columns)}; "
            "[ingest.columns] of the configuration can name them"
        )
    return names


def _listed(columns: Sequence[str]) -> str:
    shown = ", ".join(quoted(name, 40) for name in columns[:20])
    return shown + (" ..." if len(columns) > 20 else "") if columns else "no header"


class _Piece:
    """A part of a table on the way to states."""

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
        target = next(name for name in (*_TIMES_NS, "time") if name in self._names)
        raw = self._column(target)
        if raw.dtype.is_temporal():
            raw, target = raw.cast(pl.Datetime("ns")).cast(pl.Int64), "time_ns"
        text = raw.str.strip_chars() if raw.dtype == pl.String else raw
        exact_type = raw.dtype == pl.String or raw.dtype.is_integer()
        none = pl.repeat(None, raw.len(), dtype=pl.Int64, eager=True)
        whole = text.cast(pl.Int64, strict=False) if exact_type else none
        about = text.cast(pl.Float64, strict=False)
        factor = _TIMES_NS.get(target) or self._plain_factor(about)
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
        self._unit_of_time.append(_TIMES_NS[target])
        name = quoted(self._names["time"], 40)
        self._problems.add("unit_assumed", f"column {name} is taken as {target}, by the size of its numbers")
        return _TIMES_NS[target]

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
