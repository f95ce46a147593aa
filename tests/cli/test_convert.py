"""`convert` as a user calls it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

DATA = Path(__file__).resolve().parents[1] / "data"


def test_a_recording_becomes_a_log_that_every_command_reads(call: Any, tmp_path: Path) -> None:
    out = tmp_path / "traffic.mcap"
    done = call("convert", DATA / "sumo_fcd.xml", out, "--types", DATA / "sumo_types.rou.xml")
    assert (done.returncode, done.stderr) == (0, "")
    assert "5 road users" in done.stdout
    assert "from SUMO FCD" in done.stdout
    assert call("info", out).returncode == 0


def test_bad_rows_are_told_with_exit_code_3_and_bad_files_in_a_line(call: Any, tmp_path: Path) -> None:
    table, out = tmp_path / "t.csv", tmp_path / "t.mcap"
    table.write_text("vehicle_id,time_s,x_m,y_m\na,0,1,2\na,1,x,2\n")
    done = call("convert", table, out)
    assert done.returncode == 3
    assert "line 3, column 'x_m': 'x' is not a finite number" in done.stdout
    assert out.exists()
    table.write_text("a,b\n1,2\n")
    done = call("convert", table, tmp_path / "none.mcap")
    assert done.returncode == 3
    assert done.stderr.startswith("istc-replay: ")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "none.mcap").exists()
