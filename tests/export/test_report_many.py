"""Reports of many windows, many solves, many changes, and of none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import polars as pl
import pytest

from istc_replay.datatypes import Result
from istc_replay.export import report
from istc_replay.export.report import report_html
from istc_replay.export.report.markup import Html
from istc_replay.states import SOLVES_SCHEMA, conform

from ..support.pages import Page
from ..support.results import proven, with_window


def test_pictures_are_drawn_of_twelve_windows_at_most(
    synthetic_result: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []

    def stub(scene: Any) -> Html:
        drawn.append(scene.window["index"])
        return Html("")

    monkeypatch.setattr(report, "window_pictures", stub)
    first = synthetic_result.summary["windows"][0]
    windows = [first | {"index": n, "status": "no_corridors" if n > 250 else "certified"} for n in range(300)]
    checks = proven(synthetic_result).certificates
    every = pl.concat([checks.with_columns(pl.lit(n, pl.Int32).alias("window")) for n in range(251)])
    many = replace(
        synthetic_result, summary=synthetic_result.summary | {"windows": windows}, certificates=every
    )
    text = report_html(many, "x")
    words = Page(text).words
    assert drawn == [0, 1, 2, 3, 4, 5, 251, 252, 253, 254, 255, 256]
    assert "Pictures are drawn of 12 windows" in words
    assert "288 more have none here" in words
    assert len(text) < 3_000_000
    for index in range(300):
        assert f'href="#window-{index}"' in text
        assert f'id="window-{index}"' in text


def test_many_solves_are_summed_up(synthetic_result: Result, unpictured: None) -> None:
    solve = {"window": 0, "layer": "trajectory", "stage": "nlp", "solver": "ipopt", "status": "optimal"}
    rows = [solve | {"vehicle_id": f"v{n}", "iterations": 7, "wall_s": 0.5} for n in range(40)]
    table = conform(pl.DataFrame(rows), SOLVES_SCHEMA)
    words = Page(report_html(replace(synthetic_result, solves=table), "x")).words
    assert "40 solves, summed up" in words
    assert "trajectory nlp ipopt optimal 40 280" in words
    assert "20.000" in words


def test_what_coordination_changed_is_told_of_those_that_it_changed(
    synthetic_result: Result, unpictured: None
) -> None:
    same = {
        "changed": False,
        "delay_s": 0.0,
        "deviation_m": 0.0,
        "clearance_m": 3.0,
        "clearance_gained_m": 0.0,
    }
    moved = {
        "changed": True,
        "delay_s": -0.0004,
        "deviation_m": 1.234,
        "lateral_m": 0.5,
        "acceleration_rms_mps2": -0.11,
        "braking_mps2": 0.25,
        "clearance_m": 0.75,
        "clearance_gained_m": 0.314,
    }
    bound = {"bound": "road", "margin_m": 0.17, "excursion_m": 0.5, "recorded_off_road_m": 0.21}
    vehicles = synthetic_result.summary["windows"][0]["vehicles"]
    told = [v | {"coordination": moved if v["id"] == "car 2" else same, "lateral": None} for v in vehicles]

    def words(rows: list[dict[str, Any]]) -> str:
        return Page(report_html(with_window(synthetic_result, vehicles=rows), "x")).words

    scene = words(told)
    assert "2 of 3 plans are the guidance: vehicles car 1 and car 3." in scene
    assert "car 2 0.00 1.23 0.50 −0.11 0.25 0.75 0.31 Vehicles" in scene
    traffic = words([v | {"lateral": bound} if v["id"] == "car 2" else v for v in told])
    assert "are the recording, made drivable" in traffic
    assert "car 2 0.00 1.23 0.50 −0.11 0.25 0.75 0.31 0.17 the road's edge" in traffic
    assert "Recorded beyond the road's edge: car 2 by 0.21 m." in traffic
    assert "Nothing: 3 of 3 plans are the guidance." in words([v | {"coordination": same} for v in vehicles])
    assert "What coordination changed" not in words(vehicles)


def test_a_result_without_windows_is_still_a_report(synthetic_result: Result) -> None:
    bare = {"windows": [], "input": None, "totals": None, "versions": None}
    empty = replace(
        synthetic_result,
        summary=bare,
        states=synthetic_result.states.clear(),
        certificates=synthetic_result.certificates.clear(),
    )
    assert "The log has no window to plan." in Page(report_html(empty, "x")).words
