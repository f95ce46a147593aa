"""Tables come back from their files as they were."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import polars as pl
import pyarrow.parquet as pq
import pytest
from polars.testing import assert_frame_equal

from istc_replay.datatypes import Log, Result, WindowPlan
from istc_replay.errors import ExportError
from istc_replay.export.tables import log_tables, result_tables, write_tables
from istc_replay.states import RESULT_STATES_SCHEMA

Plan = tuple[Log, list[WindowPlan]]


def test_parquet_gives_back_every_table(tmp_path: Path, synthetic_result: Result) -> None:
    tables = result_tables(synthetic_result)
    paths = write_tables(tables, tmp_path / "new" / "folder", ["parquet"])
    assert [path.name for path in paths] == [f"{name}.parquet" for name in tables]
    for path, table in zip(paths, tables.values(), strict=True):
        assert_frame_equal(pl.read_parquet(path), table)


def test_another_parquet_reader_sees_the_same_columns(tmp_path: Path, synthetic_result: Result) -> None:
    (path,) = write_tables({"states": synthetic_result.states}, tmp_path, ["parquet"])
    read = pq.read_table(path)
    assert read.column_names == RESULT_STATES_SCHEMA.names()
    assert read["x_m"].to_pylist() == synthetic_result.states["x_m"].to_list()


def test_csv_gives_back_every_number_exactly(tmp_path: Path, synthetic_result: Result) -> None:
    (path,) = write_tables({"states": synthetic_result.states}, tmp_path, ["csv"])
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == RESULT_STATES_SCHEMA.names()
    for name in ("x_m", "heading_rad", "jerk_mps3"):
        assert [float(row[name]) if row[name] else None for row in rows] == synthetic_result.states[
            name
        ].to_list()
    assert [int(row["time_ns"]) for row in rows] == synthetic_result.states["time_ns"].to_list()


def test_csv_joins_lists_by_spaces(tmp_path: Path, synthetic_result: Result) -> None:
    table = pl.DataFrame({"vehicles": [["a", "b"], [], None], "numbers": [[1, 2], [3], []]})
    (path,) = write_tables({"t": table}, tmp_path, ["csv"])
    assert path.read_text().splitlines() == ["vehicles,numbers", "a b,1 2", '"",3', ',""']


@pytest.mark.parametrize("name", ["=1+1", "@x", "-2", 'say "no"', "a,b", "line\nbreak", "ümlaut", ""])
def test_csv_keeps_any_vehicle_id(tmp_path: Path, name: str) -> None:
    (path,) = write_tables({"t": pl.DataFrame({"vehicle_id": [name], "k": [1]})}, tmp_path, ["csv"])
    assert list(csv.reader(io.StringIO(path.read_text(encoding="utf-8"), newline="")))[1] == [name, "1"]


def test_the_same_tables_give_the_same_bytes(tmp_path: Path, synthetic_result: Result) -> None:
    tables = result_tables(synthetic_result)
    first = [path.read_bytes() for path in write_tables(tables, tmp_path / "a", ["parquet", "csv"])]
    assert first == [path.read_bytes() for path in write_tables(tables, tmp_path / "b", ["parquet", "csv"])]


def test_a_logs_states_have_the_columns_of_a_results_states(synthetic_plan: Plan) -> None:
    log = synthetic_plan[0]
    states = log_tables(log)["states"]
    assert states.schema == RESULT_STATES_SCHEMA
    assert states["source"].unique().to_list() == ["recorded"]
    assert_frame_equal(states.select("time_ns", "x_m"), log.states.select("time_ns", "x_m"))


@pytest.mark.parametrize("name", ["../up", "a/b", "", "a.b", "x\0"])
def test_no_table_name_leaves_the_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(ExportError, match="table name"):
        write_tables({name: pl.DataFrame({"a": [1]})}, tmp_path / "out", ["csv"])
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_format_is_told_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="no table format is named 'xlsx'; there are parquet, csv"):
        write_tables({"t": pl.DataFrame({"a": [1]})}, tmp_path, ["xlsx"])  # type: ignore[list-item]


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ExportError, match="cannot be written"):
        write_tables({"t": pl.DataFrame({"a": [1]})}, tmp_path / "file", ["csv"])
