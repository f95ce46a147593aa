"""Events of the view: what happened, at its instant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import polars as pl

from istc_replay.datatypes import Result
from istc_replay.export.rerun.markdown import ROWS

from ...support.results import with_window

Rows = list[dict[str, Any]]
View = Callable[[Result], dict[str, Rows]]


def test_events_tell_the_window_and_the_failed_check(entities: dict[str, Rows]) -> None:
    (window,) = entities["/events/windows"]
    assert window["TextLog:level"] == ["INFO"]
    assert "3 of 3 plannable vehicles certified" in window["TextLog:text"][0]
    (failed,) = entities["/events/certificates"]
    assert failed["TextLog:level"] == ["ERROR"]
    assert failed["scenario_time"] == 5_400_000_000
    assert "dynamics fail" in failed["TextLog:text"][0]


def test_recorded_overlaps_are_events(synthetic_result: Result, view_of: View) -> None:
    closer = pl.when((pl.col("vehicle_id") == "car 2") & (pl.col("source") == "recorded"))
    of_other = (pl.col("source") == "recorded") & (pl.col("vehicle_id") == "car 1")
    place = synthetic_result.states.filter(of_other).sort("time_ns").row(30, named=True)
    states = synthetic_result.states.with_columns(
        closer.then(place["x_m"]).otherwise(pl.col("x_m")).alias("x_m"),
        closer.then(place["y_m"]).otherwise(pl.col("y_m")).alias("y_m"),
    )
    rows = view_of(replace(synthetic_result, states=states))["/events/overlaps"]
    (row,) = (row for row in rows if "recorded: vehicles car 1 and car 2 overlap" in row["TextLog:text"][0])
    assert row["TextLog:level"] == ["ERROR"]
    assert 0 < row["scenario_time"] < 3_000_000_000


def test_who_is_left_out_frozen_or_not_drivable_is_told_at_its_instant(
    synthetic_result: Result, view_of: View
) -> None:
    left = {"vehicle_id": "car 2", "reason": "reversing", "detail": "drives at -3.00 m/s"}
    frozen = {"vehicle_id": "car 1", "reason": "no_relation", "detail": "bumper to bumper"}
    undrivable = {"vehicle_id": "car 3", "unit": 3, "detail": "leaves its cube by 0.4 m"}
    changed = with_window(
        synthetic_result,
        status="not_drivable",
        vehicles_certified=0,
        reason="car 3 cannot be driven",
        exclusions=[left],
        frozen=[frozen],
        undrivable=[undrivable],
    )
    rows = view_of(changed)
    told = {
        kind: (row["scenario_time"], row["TextLog:level"][0], row["TextLog:text"][0])
        for kind in ("windows", "excluded", "frozen", "undrivable")
        for row in rows[f"/events/{kind}"]
    }
    end = "0 of 3 plannable vehicles certified: car 3 cannot be driven"
    assert told == {
        "windows": (0, "ERROR", f"window 0: not drivable, {end}"),
        "excluded": (0, "WARN", "vehicle car 2 is not planned: reversing: drives at -3.00 m/s"),
        "frozen": (0, "WARN", "vehicle car 1 stays as recorded: no_relation: bumper to bumper"),
        "undrivable": (
            3_000_000_000,
            "ERROR",
            "vehicle car 3 cannot be driven in unit 3: leaves its cube by 0.4 m",
        ),
    }


def test_problems_of_the_log_are_told_at_its_start_the_first_of_many(
    synthetic_result: Result, view_of: View
) -> None:
    problems = [{"code": "chunk_crc", "detail": f"chunk {k}", "offset": k} for k in range(ROWS + 7)]
    source = synthetic_result.summary["input"] | {"problems": problems}
    rows = view_of(replace(synthetic_result, summary=synthetic_result.summary | {"input": source}))
    texts = [row["TextLog:text"][0] for row in rows["/events/log"]]
    assert len(texts) == ROWS + 1
    assert "log: chunk_crc: chunk 0" in texts
    assert "log: 7 more problems" in texts
    assert {row["TextLog:level"][0] for row in rows["/events/log"]} == {"WARN"}
