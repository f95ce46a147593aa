"""Where many vehicles come and go they share entities: each is shown as itself, none after its end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rerun.chunk import RrdReader

from istc_replay.config import ViewConfig
from istc_replay.datatypes import Result
from istc_replay.export.colours import vehicle_colours
from istc_replay.export.rerun import slots as rerun_slots
from istc_replay.export.rerun.slots import slots
from istc_replay.export.rerun.view import view_chunks, write_view
from istc_replay.ingest.result import read_result
from istc_replay.ingest.result_states import result_parts

Rows = dict[str, list[dict[str, Any]]]
S = 1_000_000_000


# --- who has which slot -----------------------------------------------------------------------


def test_few_vehicles_have_entities_of_their_own() -> None:
    assert slots({str(n): (n, n + 10) for n in range(rerun_slots.OWN_ENTITIES)}) == {}


spans = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 20)), min_size=1, max_size=40)


@settings(deadline=None)
@given(spans)
def test_nobody_shares_a_slot_with_somebody_who_is_there(lengths: list[tuple[int, int]]) -> None:
    presence = {str(n): (first, first + length) for n, (first, length) in enumerate(lengths)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rerun_slots, "OWN_ENTITIES", 0)
        found = slots(presence)
    assert set(found) == set(presence)
    for one, (first, last) in presence.items():
        for other, (start, end) in presence.items():
            # The end of one and the start of another at one instant is too near: the clear would strike.
            assert one == other or found[one] != found[other] or last < start or end < first
    most = max(sum(a <= t <= b for a, b in presence.values()) for t in range(81))
    assert len(set(found.values())) == most


# --- what a view shows ------------------------------------------------------------------------


def coming(result: Result) -> Result:
    """A result of windows with other vehicles in each."""
    new = {"vehicle_id": pl.col("vehicle_id") + "." + pl.col("window").cast(pl.String)}
    windows = [
        window | {"vehicles": [row | {"id": f"{row['id']}.{window['index']}"} for row in window["vehicles"]]}
        for window in result.summary["windows"]
    ]
    return replace(
        result,
        states=result.states.with_columns(**new),
        corridors=result.corridors.with_columns(**new),
        summary=result.summary | {"windows": windows},
    )


@pytest.fixture(scope="module", autouse=True)
def shared() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rerun_slots, "OWN_ENTITIES", 3)
        yield


@pytest.fixture(scope="module")
def changing(long_bytes: bytes) -> Result:
    return coming(read_result(long_bytes))


@pytest.fixture(scope="module")
def rows(changing: Result, rows_by_entity: Callable[[Any], Rows]) -> Rows:
    return rows_by_entity(view_chunks(changing, ViewConfig()))


def latest(rows: list[dict[str, Any]], component: str, time_ns: int, timeline: str = "time") -> Any:
    """What an entity shows of a component at an instant, as Rerun's viewer finds it."""

    def order(row: dict[str, Any]) -> tuple[int, bytes]:
        return row[timeline], row["rerun.controls.RowId"]

    past = [row for row in rows if row.get(timeline) is not None and row[timeline] <= time_ns]
    told = max((row for row in past if row.get(component) is not None), key=order, default=None)
    cleared = max((row for row in past if row.get("Clear:is_recursive") is not None), key=order, default=None)
    if told is None or (cleared is not None and order(cleared) > order(told)):
        return None
    return told[component]


def test_fifteen_vehicles_three_at_a_time_take_six_slots(rows: Rows) -> None:
    # Those of a window are cleared when the next begins, which therefore has others.
    for tree in ("/now/planned/box", "/now/recorded/box", "/space_time/planned/trajectory"):
        names = {path.rsplit("/", 1)[1] for path in rows if path.startswith(tree + "/")}
        assert names == {f"slot\\ {n}" for n in range(6)}


@pytest.mark.parametrize("source", ["planned", "recorded"])
def test_each_is_shown_with_its_own_name_and_colour_and_nobody_after_the_end(
    rows: Rows, changing: Result, source: str
) -> None:
    boxes = [own for path, own in rows.items() if path.startswith(f"/now/{source}/box/")]
    states = changing.states.filter(pl.col("source") == source)
    start = changing.summary["windows"][0]["start_ns"]
    spans = states.group_by("vehicle_id").agg(first=pl.col("time_ns").min(), last=pl.col("time_ns").max())
    for time_ns in (start + window * 6 * S + k * S // 2 + 1 for window in range(5) for k in range(1, 12)):
        there = spans.filter(pl.col("first") <= time_ns, pl.col("last") >= time_ns)["vehicle_id"]
        labels = [label for own in boxes if (label := latest(own, "Boxes3D:labels", time_ns)) is not None]
        assert sorted(label for (label,) in labels) == sorted(there)
    colours = vehicle_colours(changing.states["vehicle_id"].unique())
    for own in boxes:
        for row in own:
            if source == "planned" and row.get("Boxes3D:labels") is not None:
                red, green, blue = colours[row["Boxes3D:labels"][0]]
                assert row["Boxes3D:colors"][0] >> 8 == red << 16 | green << 8 | blue


def test_corridors_of_a_window_end_with_it(rows: Rows, changing: Result) -> None:
    start = changing.summary["windows"][0]["start_ns"]
    trees = [own for path, own in rows.items() if path.startswith("/space_time/planned/corridors/")]
    for window in range(5):
        middle = start + window * 6 * S + 3 * S
        assert sum(latest(own, "Boxes3D:centers", middle) is not None for own in trees) == 3


def test_on_the_timeline_of_units_nobody_is_shown_in_place_of_another(rows: Rows, changing: Result) -> None:
    boxes = [own for path, own in rows.items() if path.startswith("/now/planned/box/")]
    for unit in range(30):
        shown = {label for own in boxes for label in latest(own, "Boxes3D:labels", unit, "time_unit") or ()}
        # Those of the window before may stay for the first unit, as they do with entities of their own.
        own = {f"car {n}.{unit // 6}" for n in (1, 2, 3)}
        assert own - {f"car 3.{unit // 6}"} <= shown
        assert shown - own <= ({f"car {n}.{unit // 6 - 1}" for n in (1, 2, 3)} if unit % 6 == 0 else set())


def test_everybody_has_a_line_that_tells_when_and_where(rows: Rows) -> None:
    lines = [row["TextLog:text"][0] for row in rows["/vehicles"]]
    assert len(lines) == 15
    assert sum("slot 0" in line for line in lines) == 3
    assert any(line.startswith("vehicle car 2.3 is shown for ") for line in lines)


def test_those_who_are_plotted_keep_their_names(rows: Rows) -> None:
    plots = {path.rsplit("/", 1)[1] for path in rows if path.startswith("/plots/speed/planned/")}
    assert len(plots) == 12
    assert not any("slot" in name for name in plots)


def test_the_report_tells_the_slots(rows: Rows) -> None:
    text = rows["/report"][0]["TextDocument:text"][0]
    assert "| vehicle | slot | priority |" in text
    assert "slot 0" in text


def test_in_parts_the_same_is_shown(
    long_bytes: bytes, tmp_path: Any, rows_by_entity: Callable[[Any], Rows], rows: Rows
) -> None:
    head = coming(read_result(long_bytes, states=False))

    def parts() -> Iterator[Result]:
        return map(coming, result_parts(long_bytes, read_result(long_bytes, states=False), 2))

    write_view(head, ViewConfig(), tmp_path / "parts.rrd", parts=parts)
    found = rows_by_entity(RrdReader(tmp_path / "parts.rrd").stream().to_chunks())
    assert {path for path in found if path.startswith("/now/")} == {p for p in rows if p.startswith("/now/")}
    for path in (path for path in rows if "/box/" in path):
        whole, part = (
            {(row["time"], str(row.get("Boxes3D:centers")), str(row["Boxes3D:labels"])) for row in own}
            for own in (
                [row for row in table[path] if row.get("Boxes3D:labels") is not None]
                for table in (rows, found)
            )
        )
        assert whole == part, path
