"""States from tables: CSV and Parquet, our own columns or others by name or by the configuration."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import polars as pl

from istc_replay.datatypes import StaticScene
from istc_replay.errors import LogError
from istc_replay.ingest.foreign import STATES_LIMIT, ForeignRecording
from istc_replay.ingest.meaning import PLAIN
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.table_files import CsvFile, ParquetFile
from istc_replay.ingest.table_states import TIMES_NS, Piece
from istc_replay.ingest.xml_stream import Progress
from istc_replay.states import STATES_SCHEMA, conform

SUFFIXES = (".csv", ".tsv", ".parquet")
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
        source = (
            ParquetFile(path, progress) if path.suffix == ".parquet" else CsvFile(path, problems, progress)
        )
        names = _recognised(path, source.columns, columns)
        height = 0
        for piece, numbers in source.pieces(sorted(set(names.values()))):
            parts.append(Piece(piece, numbers, source.unit, names, problems, unit_of_time).states())
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
    if not any(target in names for target in TIMES_NS):
        plain = next((lower[name] for name in _PLAIN_TIMES if name in lower), None)
        if plain is not None:
            names["time"] = plain
    lacking = [name for name in ("vehicle_id", "x_m", "y_m") if name not in names]
    if not {"time", *TIMES_NS} & names.keys():
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
