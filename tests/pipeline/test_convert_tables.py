"""Tables of any tool as logs."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config
from istc_replay.errors import LogError
from istc_replay.ingest.log import read_log
from istc_replay.pipeline.convert import Converted
from istc_replay.pipeline.tables import export_tables
from istc_replay.states import STATES_SCHEMA

SAMPLES = Path(__file__).resolve().parents[2] / "sample_logs"
Convert = Callable[..., tuple[Converted, pl.DataFrame]]


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_an_exported_table_comes_back_as_it_was(kind: str, convert: Convert, tmp_path: Path) -> None:
    source = SAMPLES / "intersection_odometry.mcap"
    export_tables(source, tmp_path, [kind], Config())  # type: ignore[list-item]
    done, states = convert(tmp_path / f"states.{kind}")
    assert done.complete
    known = [
        name for name in STATES_SCHEMA if name.endswith(("_m", "_rad", "_mps", "_mps2")) or name == "time_ns"
    ]
    before = read_log(source).states.sort("vehicle_id", "time_ns")
    assert states.select("vehicle_id", *known).equals(before.select("vehicle_id", *known))


def test_the_state_table_with_all_its_columns_is_read(convert: Convert, tmp_path: Path) -> None:
    before = read_log(SAMPLES / "intersection_osi.mcap").states
    path = tmp_path / "states.parquet"
    before.write_parquet(path)
    _, states = convert(path)
    same = ("vehicle_id", "time_ns", "x_m", "y_m", "heading_rad", "speed_mps", "length_m", "role")
    assert states.select(same).equals(before.select(same))


def test_other_names_units_and_separators_are_understood(convert: Convert) -> None:
    text = (
        "track_id;frame;timestamp_ms;agent_type;x;y;vx;vy;psi_rad;length;width\n"
        "1;1;100;car;1.5;2.5;3;4;0.9272952180016122;4.5;1.8\n"
        "1;2;200;car;1.8;2.9;3;4;0.9272952180016122;4.5;1.8\n"
        "P2;1;100;pedestrian/bicycle;9;9;0;0;;;\n"
    )
    done, states = convert("tracks.csv", "\ufeff" + text)
    assert done.complete
    assert states["time_ns"].to_list() == [100_000_000, 200_000_000, 100_000_000]
    assert states["speed_mps"][0] == pytest.approx(5.0)
    assert states["heading_rad"][2] is None
    assert states.filter(vehicle_id="1")["length_m"].to_list() == [4.5, 4.5]
    assert any("x_m from 'x'" in note for note in done.notes)


def test_columns_can_be_named_in_the_configuration(convert: Convert) -> None:
    text = "who,when,east,north,kurs\nA,1700000000.25,10,20,90\n"
    config = (
        '[ingest.columns]\nvehicle_id = "who"\ntime_s = "when"\n'
        'x_m = "east"\ny_m = "north"\nheading_deg = "kurs"\n'
    )
    _, states = convert("t.csv", text, config)
    assert states["time_ns"].to_list() == [1_700_000_000_250_000_000]
    assert states["heading_rad"][0] == pytest.approx(math.pi / 2)
    with pytest.raises(
        LogError, match="no column tells vehicle_id, x_m, y_m, time_ns or time_s; it has 'who'"
    ):
        convert("t.csv", text)
    with pytest.raises(LogError, match=r"ingest.columns names 'nord'"):
        convert("t.csv", text, config.replace('"north"', '"nord"'))


@pytest.mark.parametrize(
    ("times", "expected_ns"),
    [
        (["0.1", "0.2"], [100_000_000, 200_000_000]),
        (["1700000000.5", "1700000001"], [1_700_000_000_500_000_000, 1_700_000_001_000_000_000]),
        (["1700000000500", "1700000000600"], [1_700_000_000_500_000_000, 1_700_000_000_600_000_000]),
        (
            ["1700000000500000123", "1700000000500000124"],
            [1_700_000_000_500_000_123, 1_700_000_000_500_000_124],
        ),
    ],
)
def test_times_without_a_unit_are_told_by_their_size(
    times: list[str], expected_ns: list[int], convert: Convert
) -> None:
    rows = "".join(f"a,{time},0,0\n" for time in times)
    done, states = convert("t.csv", "id,timestamp,x,y\n" + rows)
    assert states["time_ns"].to_list() == expected_ns
    assert {p.code for p in done.problems} == {"unit_assumed"}


def test_bad_cells_are_left_out_by_line_and_column(convert: Convert) -> None:
    text = (
        "vehicle_id,time_s,x_m,y_m,length_m\n"
        "a,0,0,0,4\n"
        "a,1,zero,0,4\n"  # line 3
        "a,-1,0,0,4\n"
        "a,2,0\n"
        '"a\nb",3,0,inf,4\n'  # lines 6 and 7
        ",4,0,0,4\n"
        "a,6,,0,4\n"
        "a,7,7,7,\n"
    )
    done, states = convert("t.csv", text)
    assert states["x_m"].to_list() == [0.0, 7.0]
    assert not done.complete
    details = sorted(p.detail for p in done.problems if p.code != "bad_row")
    assert details[-1].startswith("line 9: time, x or y is empty")
    assert "line 3, column 'x_m': 'zero' is not a finite number" in details[0]
    assert "line 4, column 'time_s': '-1' is no time" in details[1]
    assert "line 7, column 'y_m': 'inf' is not a finite number" in details[2]
    assert "line 8, column 'vehicle_id'" in details[3]
    assert [p.detail for p in done.problems if p.code == "bad_row"] == [
        "line 5: 3 fields where the header has 5; left out"
    ]


@pytest.mark.parametrize("name", ["t.csv", "t.tsv", "t.parquet"])
@pytest.mark.parametrize(
    "data", [b"", b"\x00" * 100, b"\xff\xfe" * 50, b'"' * 5000, b"PAR1" + b"x" * 40 + b"PAR1"]
)
def test_what_is_no_table_is_refused_in_a_line(name: str, data: bytes, convert: Convert) -> None:
    with pytest.raises(LogError) as error:
        convert(name, data)
    assert "\n" not in str(error.value)


def test_half_a_million_rows_are_read_in_pieces(convert: Convert) -> None:
    count = 120_000
    table = pl.DataFrame({"id": np.arange(count) % 7, "time_s": np.arange(count) / 100, "x": 1.0, "y": 2.0})
    done, states = convert("t.csv", table.write_csv())
    assert states.height == done.states == count
    assert done.vehicles == 7
