"""A run that is watched: windows come one by one, and the files are the same as without."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from rerun.chunk import RrdReader

from istc_replay.config import Config
from istc_replay.export.rerun import viewer as rerun_viewer
from istc_replay.export.rerun.events import arrivals
from istc_replay.export.rerun.spans import Anchor
from istc_replay.export.sample_log import sample_bytes
from istc_replay.pipeline import live as pipeline_live
from istc_replay.pipeline.live import LiveView
from istc_replay.pipeline.run import run_log
from istc_replay.samples.scenes import SAMPLES

S = 1_000_000_000
CUT = {"window": {"whole_log_s": 4.0, "horizon_s": 4.0, "stride_s": 3.0}, "corridors": {"mode": "fast"}}


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first sample, which the settings `CUT` cut into three windows."""
    path = tmp_path_factory.mktemp("live") / "turn.mcap"
    sample = SAMPLES["intersection_turn_first"]
    path.write_bytes(sample_bytes(sample.record(), sample.format))
    return path


def _rows(path: Path) -> list[tuple[str, int]]:
    return sorted((c.entity_path, c.num_rows) for c in RrdReader(path).stream().to_chunks())


@pytest.mark.slow
def test_a_watched_run_streams_its_windows_and_writes_the_same_files(
    viewer: Any, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = Config.model_validate(CUT)
    seen: list[tuple[int, str | None]] = []
    send = pipeline_live.send_live

    def told(part: Any, view: Any, anchor: Anchor, recording: Any) -> Anchor:
        after = send(part, view, anchor, recording)
        (there,) = (r for r in viewer.get_state().recordings if r.store_id.endswith("-live"))
        seen.append((len(part.summary["windows"]), there.store_id))
        return after

    monkeypatch.setattr(pipeline_live, "send_live", told)
    watched = LiveView(viewer.url)
    done = run_log(log, tmp_path / "watched", config, live=watched)
    assert not watched.lost
    assert len(seen) == len(done.summary["windows"]) > 1
    assert {windows for windows, _ in seen} == {1}
    run_log(log, tmp_path / "alone", config)
    one, other = tmp_path / "watched", tmp_path / "alone"
    assert (one / "result.mcap").read_bytes() == (other / "result.mcap").read_bytes()
    assert _rows(one / "view.rrd") == _rows(other / "view.rrd")
    # The whole result has taken the live recording's place.
    recordings = viewer.get_state().recordings
    assert not [r for r in recordings if r.store_id.endswith("-live")]
    (there,) = (r for r in recordings if r.store_id.endswith(rerun_viewer.recording_id(done.result)))
    assert (there.current_timeline, there.current_time) == ("scenario_time", 0)
    assert not [v for v in viewer.get_state().views if v.reports]


def test_windows_of_a_growing_result_lie_in_one_time_and_place(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What goes to the viewer while a log is solved, taken down in its place."""
    parts: list[tuple[Any, Anchor]] = []

    def take(part: Any, view: Any, anchor: Anchor, _: Any) -> Anchor:
        stage, _ = rerun_viewer.lay_out(part, view, anchor=anchor)
        parts.append((stage, anchor))
        return Anchor(
            origin_ns=anchor.origin_ns,
            origin_m=stage.origin_m,
            until_ns=anchor.until_ns,
            metres_per_second=stage.metres_per_second,
        )

    monkeypatch.setattr(pipeline_live, "send_live", take)
    monkeypatch.setattr(pipeline_live, "connected", lambda *_: object())
    from istc_replay.ingest.log import read_log
    from istc_replay.pipeline.windows import plan_windows

    config = Config.model_validate(CUT)
    read = read_log(log, config)
    watched = LiveView("rerun+http://127.0.0.1:9/proxy")
    monkeypatch.setattr(watched, "_end", lambda: None)
    plan_windows(read, config, seen=lambda outcome: watched.window(read, config, outcome))
    assert not watched.lost
    assert len(parts) == 3
    origins = {(stage.clock.origin_ns, stage.origin_m, stage.metres_per_second) for stage, _ in parts}
    assert len(origins) == 1
    spans = [stage.spans[0] for stage, _ in parts]
    assert np.diff([span.start_ns for span in spans]).tolist() == [3 * S] * 2
    # Each is shown until the next begins.
    assert [span.shown_end_ns for span in spans[:-1]] == [span.start_ns for span in spans[1:]]
    assert [anchor.until_ns is not None for _, anchor in parts] == [True, True, False]
    assert [stage.first_ns for stage, _ in parts] == [span.start_ns for span in spans]
    # How long each vehicle stays is not known yet.
    assert [arrivals(stage) for stage, _ in parts] == [[], [], []]
    # Windows that begin in the middle of the recorded conflict have no plan.
    assert parts[0][0].result.states.filter(pl.col("source") == "planned").height


def test_a_viewer_that_is_not_there_does_not_stop_the_run(log: Path, tmp_path: Path) -> None:
    watched = LiveView("rerun+http://127.0.0.1:9/proxy")
    done = run_log(log, tmp_path / "out", Config.model_validate(CUT), live=watched)
    assert "no viewer answers" in watched.lost
    assert done.summary["totals"]["windows"] == 3
    assert (tmp_path / "out" / "view.rrd").stat().st_size > 10_000
