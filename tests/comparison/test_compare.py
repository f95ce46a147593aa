"""What a comparison tells of two results: all that differs, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import polars as pl
import pytest
from shapely import Polygon

from istc_replay.comparison.compare import compare_results
from istc_replay.comparison.difference import Change
from istc_replay.comparison.motion import crossings, window_motions
from istc_replay.comparison.words import sentences, values, verdict
from istc_replay.datatypes import Result
from istc_replay.geometry import box_corners

PLANNED = pl.col("source") == "planned"


def changed(result: Result, who: Any = True, **columns: pl.Expr) -> Result:
    """The same result with other values in its planned states."""
    rows = PLANNED & who
    return replace(
        result,
        states=result.states.with_columns(
            pl.when(rows).then(value).otherwise(pl.col(name)).alias(name) for name, value in columns.items()
        ),
    )


def with_first_window(result: Result, **changes: Any) -> Result:
    """The same result with another first window in its summary."""
    first, *others = result.summary["windows"]
    return replace(result, summary=result.summary | {"windows": [first | changes, *others]})


def test_a_result_and_itself_differ_in_nothing(synthetic_result: Result) -> None:
    comparison = compare_results(synthetic_result, synthetic_result)
    assert comparison.same
    assert comparison.same_outcome
    assert list(sentences(comparison)) == ["Nothing differs: the two results are the same."]


def test_a_plan_that_moved_is_told_with_its_distance_and_instant(synthetic_result: Result) -> None:
    later = pl.col("time_ns") - pl.col("time_ns").min()
    other = changed(
        synthetic_result, pl.col("vehicle_id") == "car 1", y_m=pl.col("y_m") + later.cast(pl.Float64) / 1e9
    )
    (window,) = compare_results(synthetic_result, other).windows
    (vehicle,) = window.vehicles
    last = synthetic_result.states.filter(PLANNED, pl.col("vehicle_id") == "car 1")["time_ns"].max()
    seconds = (last - synthetic_result.states["time_ns"].min()) / 1e9  # type: ignore[operator]
    assert vehicle.vehicle_id == "car 1"
    assert vehicle.moved_m == pytest.approx(seconds)
    assert vehicle.moved_at_s == pytest.approx(seconds, abs=0.1)
    assert vehicle.recorded_moved_m is None
    assert not vehicle.cubes
    assert vehicle.figures == ()
    assert "1 plan moved" in verdict(compare_results(synthetic_result, other))


def test_a_plan_that_comes_later_is_told_with_its_delay(synthetic_result: Result) -> None:
    start = pl.col("time_ns").min().over("vehicle_id", "source")
    # The same way in half as much more time.
    slower = start + ((pl.col("time_ns") - start) * 3) // 2
    other = changed(synthetic_result, pl.col("vehicle_id") == "car 2", time_ns=slower)
    (window,) = compare_results(synthetic_result, other).windows
    (vehicle,) = window.vehicles
    motions = window_motions(synthetic_result, synthetic_result.summary["windows"][0])
    track = motions.planned["car 2"]
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track.states[:, :2], axis=0).T))])
    when_s = np.interp(0.95 * way[-1], way, (track.times_ns - track.times_ns[0]) / 1e9)
    assert vehicle.delay_s == pytest.approx(0.5 * when_s, abs=0.02)


def test_a_corridor_that_moved_is_told_by_cube_and_wall(synthetic_result: Result) -> None:
    shifted = pl.when((pl.col("vehicle_id") == "car 3") & (pl.col("k") == 1)).then(0.25).otherwise(0.0)
    other = replace(
        synthetic_result,
        corridors=synthetic_result.corridors.with_columns(x_max_m=pl.col("x_max_m") + shifted),
    )
    (window,) = compare_results(synthetic_result, other).windows
    (vehicle,) = window.vehicles
    assert (vehicle.vehicle_id, vehicle.cubes, vehicle.walls_m) == ("car 3", 1, pytest.approx(0.25))
    assert vehicle.moved_m is None


def test_vehicles_and_windows_of_one_result_alone_are_named(synthetic_result: Result) -> None:
    fewer = replace(synthetic_result, states=synthetic_result.states.filter(pl.col("vehicle_id") != "car 2"))
    first = synthetic_result.summary["windows"][0]
    more = replace(fewer, summary=fewer.summary | {"windows": [first, first | {"index": 7}]})
    comparison = compare_results(synthetic_result, more)
    assert comparison.vehicles_only_a == ("car 2",)
    assert comparison.vehicles_only_b == ()
    assert comparison.windows_only_b == (7,)
    text = "\n".join(sentences(comparison))
    assert "only in A: vehicle car 2" in text
    assert "only in B: window 7" in text


def test_settings_and_versions_are_compared_by_key_and_do_not_make_an_outcome(
    synthetic_result: Result,
) -> None:
    summary = synthetic_result.summary | {"versions": synthetic_result.summary["versions"] | {"casadi": "9"}}
    other = replace(synthetic_result, summary=summary, config_toml="[window]\nunit_s = 2.0\n")
    comparison = compare_results(synthetic_result, other)
    assert [(change.key, change.a, change.b) for change in comparison.settings] == [
        ("window.unit_s", 1.0, 2.0)
    ]
    assert [change.key for change in comparison.versions] == ["casadi"]
    assert comparison.same_outcome
    assert not comparison.same
    assert verdict(comparison).startswith("The outcome is the same")


def test_a_status_and_a_check_that_differ_are_told(synthetic_result: Result) -> None:
    other = with_first_window(synthetic_result, status="partial")
    other = replace(other, certificates=other.certificates.with_columns(verdict=pl.lit("fail")))
    (window,) = compare_results(synthetic_result, other).windows
    assert ("status", "partial") in [(change.key, change.b) for change in window.figures]
    assert {change.b for change in window.checks} == {"fail"}


def test_a_vehicle_that_is_left_out_in_one_is_told_with_the_reason(synthetic_result: Result) -> None:
    first = synthetic_result.summary["windows"][0]
    kept = [vehicle for vehicle in first["vehicles"] if vehicle["id"] != "car 1"]
    left = [{"vehicle_id": "car 1", "reason": "no_heading", "detail": ""}]
    other = with_first_window(synthetic_result, vehicles=kept, exclusions=left)
    (window,) = compare_results(synthetic_result, other).windows
    told = {change.key: (change.a, change.b) for change in window.vehicles[0].figures}
    assert told["plan"] == ("planned", "no_heading")


def test_numbers_equal_to_rounding_are_the_same(synthetic_result: Result) -> None:
    other = changed(synthetic_result, y_m=pl.col("y_m") + 1e-10)
    assert compare_results(synthetic_result, other).same


def test_figures_are_told_with_as_many_digits_as_tell_them_apart() -> None:
    assert values(Change("length_m", 0.28206212, 0.28206241)) == ("0.28206212", "0.28206241")
    assert values(Change("length_m", 12.5, 12.75)) == ("12.5", "12.75")
    assert values(Change("arrived", True, None)) == ("yes", "none")
    assert values(Change("sha256", "ab" * 32, "cd" * 32)) == ("ab" * 8, "cd" * 8)


# --- who goes first --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def crossing(synthetic_result: Result) -> Result:
    """Plans in which car 1 drives east and car 2 north through one place, car 2 two seconds later."""
    seconds = (pl.col("time_ns") - synthetic_result.states["time_ns"].min()) / 1e9
    ways = {
        "car 1": (5.0 * (seconds - 2.0), pl.lit(0.0), pl.lit(0.0)),
        "car 2": (pl.lit(0.0), 5.0 * (seconds - 4.0), pl.lit(np.pi / 2.0)),
    }
    result = synthetic_result
    for vehicle, (x, y, heading) in ways.items():
        result = changed(result, pl.col("vehicle_id") == vehicle, x_m=x, y_m=y, heading_rad=heading)
    return result


def test_leads_are_the_least_times_between_overlapping_footprints(crossing: Result) -> None:
    motions = window_motions(crossing, crossing.summary["windows"][0])
    found = crossings(motions, motions.planned)
    outlines = {}
    for name, track in motions.planned.items():
        poses = motions.poses(motions.planned, name, motions.times_s)
        corners = box_corners(*poses.T, track.length_m, track.width_m)
        outlines[name] = [Polygon(box) if np.isfinite(box).all() else None for box in corners]
    assert ("car 1", "car 2") in found
    for one, two in combinations(sorted(outlines), 2):
        leads = [
            (abs(j - i), one if i <= j else two)
            for i, a in enumerate(outlines[one])
            for j, b in enumerate(outlines[two])
            if a is not None and b is not None and a.intersects(b)
        ]
        assert ((one, two) in found) == bool(leads)
        if leads:
            step_s = motions.times_s[1]
            assert found[one, two].lead_s == pytest.approx(min(leads)[0] * step_s, abs=1e-9)
            assert found[one, two].first in {name for lead, name in leads if lead == min(leads)[0]}


def test_a_pair_that_changes_its_order_is_told(crossing: Result) -> None:
    motions = window_motions(crossing, crossing.summary["windows"][0])
    found = crossings(motions, motions.planned)
    pair = ("car 1", "car 2")
    first = found[pair]
    assert (first.first, first.second) == pair
    assert 0.0 < first.lead_s < 1.0
    # Each drives the other's way: who was first is second.
    swapped = crossing.states.with_columns(
        vehicle_id=pl.when(PLANNED)
        .then(pl.col("vehicle_id").replace({pair[0]: pair[1], pair[1]: pair[0]}))
        .otherwise(pl.col("vehicle_id"))
    )
    comparison = compare_results(crossing, replace(crossing, states=swapped))
    told = next(change for change in comparison.windows[0].pairs if change.pair == pair)
    assert told.reversed
    assert told.a == first
    assert told.b is not None
    assert (told.b.first, told.b.second) == (first.second, first.first)
    text = "\n".join(sentences(comparison))
    assert "in A car 2 waits for car 1" in text
    assert "the other one goes first" in text
