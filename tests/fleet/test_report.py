"""The report of a fleet: its data set holds what the logs' tables hold, and its page leads to them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from istc_replay.errors import LogError
from istc_replay.fleet.report import write_report

from .conftest import RunFleet


@pytest.fixture(scope="module")
def reported(run_fleet: RunFleet, fleet_logs: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fleet of two logs, one of an odd name, a damaged and an unreadable one, with its report."""
    folder = tmp_path_factory.mktemp("reported")
    logs = folder / "in"
    fleet_logs.write_logs(logs, 1)
    (logs / "<b>odd [x]\n%20.mcap").write_bytes(fleet_logs.varied_log(5))
    data = fleet_logs.varied_log(3)
    (logs / "cut.mcap").write_bytes(data[: len(data) - 400])
    (logs / "text.mcap").write_text("no log")
    run_fleet(folder / "out", logs, products=("report.html",))
    write_report(folder / "out")
    return folder / "out"


def scan(folder: Path, table: str) -> pl.LazyFrame:
    return pl.scan_parquet(folder / "report" / "tables" / table / "*.parquet")


def test_the_data_set_holds_every_table_of_every_log(reported: Path) -> None:
    names = {p.name for p in (reported / "logs").iterdir()}
    assert len(names) == 3
    tables = {p.stem for p in (reported / "logs").rglob("*.parquet")}
    assert {"states", "corridors", "solves", "findings", "encounters", "against_plan"} <= tables
    for table in tables:
        joined = scan(reported, table).collect()
        assert joined.columns[0] == "log"
        assert set(joined["log"].unique()) <= names
        for name in names:
            own = pl.read_parquet(reported / "logs" / name / "tables" / f"{table}.parquet", glob=False)
            assert_frame_equal(joined.filter(pl.col("log") == name).drop("log"), own)


def test_the_logs_table_has_a_row_a_log_with_its_figures(reported: Path) -> None:
    logs = {row["log"]: row for row in scan(reported, "logs").collect().iter_rows(named=True)}
    assert {name: row["outcome"] for name, row in logs.items()} == {
        "log_00000": "done",
        "<b>odd [x]_%20": "done",
        "cut": "inconclusive",
        "text": "failed",
    }
    summary = json.loads((reported / "logs/log_00000/summary.json").read_text())
    row = logs["log_00000"]
    assert row["vehicles_certified"] == summary["totals"]["vehicles_certified"] == 3
    assert row["critical"] == summary["audit"]["counts"]["critical"] > 0
    assert row["least_gap_m"] == summary["windows"][0]["recorded"]["min_separation_m"] < 0.0
    encounters = scan(reported, "encounters").filter(pl.col("log") == "log_00000").collect()
    assert row["least_ttc_s"] == encounters["least_ttc_s"].filter(encounters["least_ttc_s"].is_finite()).min()
    assert logs["text"]["error"].startswith("not an MCAP log")
    assert scan(reported, "windows").collect().height == 3
    against = scan(reported, "against_plan").collect()
    for name in ("delay_end_s", "recorded_jerk_mps3", "planned_jerk_mps3"):
        assert against[name].is_not_null().all()
    problems = scan(reported, "problems").collect()
    assert set(problems["log"]) == {"cut", "text"}
    assert problems.filter(pl.col("log") == "text")["code"].to_list() == ["failed"]


def test_every_link_of_the_page_leads_to_a_file(reported: Path) -> None:
    text = (reported / "report" / "index.html").read_text(encoding="utf-8")
    links = set(re.findall(r'"(\.\./logs/[^"#]+)', text))
    assert len(links) == 3
    for link in links:
        assert (reported / "report" / unquote(link)).is_file()
    assert "#window-0" in text
    assert "<b>odd" not in text


def test_a_second_report_takes_the_place_of_the_first(reported: Path) -> None:
    first = (reported / "report/index.html").read_bytes()
    assert write_report(reported).read_bytes() == first
    assert not [p.name for p in reported.iterdir() if p.name.startswith(".")]


def test_a_folder_without_a_fleet_has_no_report(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be read"):
        write_report(tmp_path)
    assert list(tmp_path.iterdir()) == []
