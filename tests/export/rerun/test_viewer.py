"""The view in Rerun's own viewer, drawn in software without a screen."""

from __future__ import annotations

import io
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import polars as pl
import pytest

from istc_replay.config import ViewConfig
from istc_replay.datatypes import Result
from istc_replay.errors import ExportError
from istc_replay.export.colours import vehicle_colours
from istc_replay.export.rerun import viewer as rerun_viewer
from istc_replay.export.rerun.blueprint import blueprint
from istc_replay.export.rerun.view import Opening, recording_id, write_view
from istc_replay.export.rerun.viewer import send_view

from ...support.processes import listening


def _picture(viewer: Any, seconds: float, view: str | None = None) -> np.ndarray:
    """What the viewer, or one view of it, shows at an instant."""
    viewer.set_time("scenario_time", duration=seconds, play_state="paused")
    picture = np.empty(0)
    for _ in range(12):  # the first frames still load
        time.sleep(0.3)
        before = picture
        picture = matplotlib.image.imread(io.BytesIO(viewer.take_screenshot(view)))[..., :3]
        if before.shape == picture.shape and np.abs(before - picture).mean() < 1e-4:
            break
    return picture


def _complaints(viewer: Any) -> list[str]:
    """What views report, and what the viewer logs, but for the slowness of software drawing."""
    reports = [f"{v.name}: {report}" for v in viewer.get_state().views for report in v.reports]
    entries = [entry for entry in viewer.get_logs() if entry.level in ("WARN", "ERROR")]
    # Asking for a view behind another tab is a complaint too.
    expected = ("asterizer", "not found for screenshot")
    return reports + [e.message for e in entries if not any(word in e.message for word in expected)]


def test_the_viewer_shows_every_view_without_complaint(viewer: Any, rrd: Path) -> None:
    viewer.open(str(rrd))
    early, late = _picture(viewer, 0.5), _picture(viewer, 4.5)
    state = viewer.get_state()
    assert not state.loading
    (recording,) = state.recordings
    assert {timeline.name for timeline in recording.timelines} == {"time", "scenario_time", "time_unit"}
    assert recording.current_timeline == "scenario_time"
    assert len(state.views) > 20
    assert not _complaints(viewer)
    assert early.std() > 0.05  # not blank
    assert np.abs(early - late).mean() > 1e-3  # the replay moves


@pytest.mark.slow
@pytest.mark.parametrize("tab", range(5))
def test_every_tab_has_content(
    viewer: Any,
    synthetic_result: Result,
    tmp_path: Path,
    tab: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A tab that is not in front is not drawn, and could not complain."""
    monkeypatch.setattr(Opening, "blueprint", property(lambda _: blueprint(tab=tab)))
    write_view(synthetic_result, ViewConfig(), tmp_path / "tab.rrd")
    viewer.open(str(tmp_path / "tab.rrd"))
    whole = _picture(viewer, 3.0)
    assert whole.std() > 0.05
    shown = []
    for view in viewer.get_state().views:
        try:
            content = viewer.take_screenshot(view.view_id)
        except ConnectionError as error:  # it is behind another tab
            assert "not found" in str(error)  # noqa: PT017
        else:
            shown.append(view.name)
            assert matplotlib.image.imread(io.BytesIO(content))[..., :3].std() > 0.01, view.name
    assert len(shown) == 8  # two scenes, report, events, four below
    assert not _complaints(viewer)


@pytest.mark.slow
def test_the_vehicles_show_in_their_colours(viewer: Any, rrd: Path) -> None:
    viewer.open(str(rrd))
    picture = _picture(viewer, 3.0)
    for colour in vehicle_colours(("car 1", "car 2", "car 3")).values():
        distance = np.abs(picture - np.array(colour) / 255.0).max(axis=-1)
        assert (distance < 0.08).sum() > 100


@pytest.mark.slow
def test_hostile_names_are_drawn_as_text(viewer: Any, hostile_result: Result, tmp_path: Path) -> None:
    hostile = replace(hostile_result, config_toml="[window]\nunit_s = 1.0\n")
    write_view(hostile, ViewConfig(), tmp_path / "hostile.rrd")
    viewer.open(str(tmp_path / "hostile.rrd"))
    assert _picture(viewer, 3.0).std() > 0.05
    assert not _complaints(viewer)


@pytest.mark.slow
def test_a_view_sent_to_a_viewer_opens_at_its_instant_close_to_its_focus(
    viewer: Any, synthetic_result: Result
) -> None:
    send_view(synthetic_result, ViewConfig(), viewer.url, Opening(("car 2",), close_up=True), 2_500_000_000)
    (recording,) = (
        r for r in viewer.get_state().recordings if r.store_id.endswith(recording_id(synthetic_result))
    )
    assert (recording.current_timeline, recording.current_time) == ("scenario_time", 2_500_000_000)
    assert _picture(viewer, 2.5).std() > 0.05
    assert not _complaints(viewer)


@pytest.mark.slow
def test_fifty_vehicles_are_not_a_clutter(viewer: Any, crowd: Result, tmp_path: Path) -> None:
    """Names and corridors of the leading ones alone: the picture is not covered."""
    write_view(crowd, ViewConfig(), tmp_path / "crowd.rrd")
    viewer.open(str(tmp_path / "crowd.rrd"))
    assert _picture(viewer, 3.0).std() > 0.05
    assert not _complaints(viewer)


@pytest.mark.slow
def test_a_thousand_vehicles_coming_and_going_open(viewer: Any, crowd: Result, tmp_path: Path) -> None:
    """With entities of their own Rerun would refuse them: a hundred columns each are too many."""
    second, names = 1_000_000_000, ("states", "corridors")
    (window,) = crowd.summary["windows"]
    tables: dict[str, list[pl.DataFrame]] = {name: [] for name in names}
    windows = []
    for k in range(24):
        new = pl.lit(k, pl.Int32).alias("window")
        for name in names:
            own = pl.col("vehicle_id") + f".{k}"
            times = [c for c in getattr(crowd, name).columns if c.endswith("_ns")]
            moved = getattr(crowd, name).with_columns(pl.col(times) + 6 * k * second, new, own)
            tables[name].append(moved)
        vehicles = [row | {"id": f"{row['id']}.{k}"} for row in window["vehicles"]]
        span = {key: window[key] + 6 * k * second for key in ("start_ns", "end_ns")}
        windows.append(window | span | {"index": k, "vehicles": vehicles})
    joined = {name: pl.concat(tables[name]) for name in names}
    summary = crowd.summary | {"windows": windows}
    write_view(replace(crowd, **joined, summary=summary), ViewConfig(), tmp_path / "many.rrd")
    viewer.open(str(tmp_path / "many.rrd"))
    assert _picture(viewer, 100.0).std() > 0.05
    (recording,) = viewer.get_state().recordings
    assert {timeline.name for timeline in recording.timelines} == {"time", "scenario_time", "time_unit"}
    assert not _complaints(viewer)


def test_the_viewer_listens_on_this_machine_alone(viewer_process: Any) -> None:
    assert listening(viewer_process.pid) == {"127.0.0.1"}


def test_a_viewer_that_does_not_start_is_told_by_its_last_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    dying = [sys.executable, "-c", "print('one\\ntwo: no GPU'); raise SystemExit(1)"]
    monkeypatch.setattr(rerun_viewer, "rerun_command", lambda *_: dying)
    with pytest.raises(ExportError, match="does not start: two: no GPU; use --save or --web"):
        rerun_viewer.start_viewer()
    monkeypatch.setattr(rerun_viewer, "rerun_command", lambda *_: ["/nowhere/rerun"])
    with pytest.raises(ExportError, match=r"does not start: .*nowhere"):
        rerun_viewer.start_viewer()


def test_without_a_screen_no_viewer_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(ExportError, match=r"no screen .* --bundle FOLDER .* --web"):
        rerun_viewer.start_viewer()


def test_where_no_viewer_answers_it_is_told_at_once(synthetic_result: Result) -> None:
    url = f"rerun+http://127.0.0.1:{rerun_viewer.free_port()}/proxy"
    with pytest.raises(ExportError, match=r"no viewer answers.*is one running there"):
        send_view(synthetic_result, ViewConfig(), url, Opening(), None)
