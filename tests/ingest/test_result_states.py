"""A long result is read a part after the other, and the parts tell what the whole tells."""

from __future__ import annotations

from dataclasses import replace

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from istc_replay.datatypes import Result
from istc_replay.errors import LogError
from istc_replay.ingest.result import read_result
from istc_replay.ingest.result_states import plan_parts, recorded_states, result_parts, window_states

S = 1_000_000_000


@pytest.fixture(scope="module")
def whole(long_bytes: bytes) -> Result:
    return read_result(long_bytes)


@pytest.fixture(scope="module")
def head(long_bytes: bytes) -> Result:
    return read_result(long_bytes, states=False)


def test_without_its_states_a_result_is_the_same(whole: Result, head: Result) -> None:
    assert whole.states.height
    assert head.states.is_empty()
    assert head.states.schema == whole.states.schema
    assert head.summary == whole.summary
    for name in ("corridors", "obstacles", "solves", "certificates", "findings"):
        assert_frame_equal(getattr(head, name), getattr(whole, name))


@pytest.mark.parametrize("windows", [1, 2, 5, 9])
def test_parts_hold_the_states_about_their_windows(
    long_bytes: bytes, head: Result, whole: Result, windows: int
) -> None:
    parts = list(result_parts(long_bytes, head, windows))
    assert [w["index"] for part in parts for w in part.summary["windows"]] == [0, 1, 2, 3, 4]
    for number, part in enumerate(parts):
        own = [w["index"] for w in part.summary["windows"]]
        first = -(2**62) if number == 0 else part.summary["windows"][0]["start_ns"] - 4 * S
        last = 2**62 if number == len(parts) - 1 else part.summary["windows"][-1]["end_ns"] + 4 * S
        within = (pl.col("time_ns") >= first) & (pl.col("time_ns") < last)
        assert_frame_equal(part.states, whole.states.filter(within | pl.col("window").is_in(own)))
        assert part.corridors["window"].unique().to_list() == own
        assert part.certificates.height == 3 * len(own)


def test_the_states_of_some_windows_are_those_within_them(
    long_bytes: bytes, head: Result, whole: Result
) -> None:
    states = window_states(long_bytes, head, [3, 1])
    spans = {w["index"]: (w["start_ns"], w["end_ns"]) for w in head.summary["windows"]}
    within = pl.any_horizontal(pl.col("time_ns").is_between(*spans[index]) for index in (1, 3))
    states = states.filter((pl.col("source") == "recorded") | pl.col("window").is_in([1, 3]))
    within &= (pl.col("source") == "recorded") | pl.col("window").is_in([1, 3])
    assert_frame_equal(
        states.sort("source", "window", "vehicle_id", "time_ns"),
        whole.states.filter(within).sort("source", "window", "vehicle_id", "time_ns"),
    )


def test_a_result_without_windows_is_one_part(synthetic_plan: tuple) -> None:  # type: ignore[type-arg]
    from istc_replay.export.result_mcap import Contents, result_bytes

    data = result_bytes(Contents(synthetic_plan[0], [], [], {"windows": []}, "", {}))
    (part,) = result_parts(data, read_result(data, states=False), 16)
    assert_frame_equal(part.states, read_result(data).states)


@pytest.mark.parametrize("windows", [1, 2, 5, 9])
def test_plans_in_parts_and_what_was_recorded_are_the_whole_each_state_once(
    long_bytes: bytes, head: Result, whole: Result, windows: int
) -> None:
    recorded = pl.col("source") == "recorded"
    assert_frame_equal(recorded_states(long_bytes, head), whole.states.filter(recorded))
    parts = list(plan_parts(long_bytes, head, windows))
    order = ("source", "window", "vehicle_id", "time_ns")
    assert_frame_equal(
        pl.concat([part.states for part in parts]).sort(order), whole.states.filter(~recorded).sort(order)
    )
    for name in ("corridors", "obstacles", "certificates"):
        assert_frame_equal(pl.concat([getattr(part, name) for part in parts]), getattr(whole, name))


def test_plans_of_windows_that_the_summary_does_not_list_come_last(long_bytes: bytes, head: Result) -> None:
    windows = [window for window in head.summary["windows"] if window["index"] != 2]
    told = replace(head, summary=head.summary | {"windows": windows})
    *others, last = plan_parts(long_bytes, told, 2)
    assert {index for part in others for index in part.states["window"]} == {0, 1}
    assert set(last.states["window"]) == set(last.corridors["window"]) == {2, 3, 4}


def test_states_far_from_their_window_are_not_left_out_without_a_word(
    long_bytes: bytes, head: Result
) -> None:
    windows = [dict(window) for window in head.summary["windows"]]
    for window in windows:
        window["start_ns"] -= 60 * S * (window["index"] == 4)
        window["end_ns"] -= 60 * S * (window["index"] == 4)
    with pytest.raises(LogError, match="far from their windows; make it again"):
        list(plan_parts(long_bytes, replace(head, summary=head.summary | {"windows": windows}), 1))
