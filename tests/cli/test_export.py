"""`istc-replay export` as a user calls it."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from ..support.commands import TURN_FIRST, Command, expect_failure


def test_export_writes_the_tables_of_a_log_and_of_a_result(
    call: Command, result: Path, tmp_path: Path
) -> None:
    done = call("export", result, "-o", tmp_path / "result", "--format", "parquet,csv")
    assert done.returncode == 0, done.stderr
    states = pl.read_parquet(tmp_path / "result" / "states.parquet")
    assert set(states["source"].unique()) == {"recorded", "planned", "guidance"}
    assert pl.read_parquet(tmp_path / "result" / "solves.parquet")["wall_s"].null_count() == 0
    assert (tmp_path / "result" / "corridors.csv").is_file()
    assert call("export", TURN_FIRST, "-o", tmp_path / "log").returncode == 0
    recorded = pl.read_parquet(tmp_path / "log" / "states.parquet")
    assert recorded.height == 303


def test_an_unknown_table_format_is_refused(call: Command, tmp_path: Path) -> None:
    expect_failure(call("export", TURN_FIRST, "-o", tmp_path, "--format", "xls"), 2, "xls", "parquet")
