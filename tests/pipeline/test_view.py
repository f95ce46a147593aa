"""Looking at a result: where it opens, whom it shows, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from rerun.chunk import RrdReader

from istc_replay.config import ViewConfig
from istc_replay.datatypes import Result
from istc_replay.errors import ExportError, LogError, UsageError
from istc_replay.export.rerun.view import view_chunks
from istc_replay.pipeline import view as pipeline_view
from istc_replay.pipeline.reading import Reading
from istc_replay.pipeline.view import open_view
from istc_replay.states import FINDINGS_SCHEMA, conform

S = 1_000_000_000


@pytest.fixture
def folder(synthetic_bytes: bytes, tmp_path: Path) -> Path:
    """A result's folder with nothing in it but result.mcap."""
    (tmp_path / "result.mcap").write_bytes(synthetic_bytes)
    return tmp_path


def test_a_saved_view_holds_what_the_result_does(
    folder: Path, synthetic_result: Result, tmp_path: Path
) -> None:
    open_view(folder).save(tmp_path / "saved.rrd")
    saved = RrdReader(tmp_path / "saved.rrd").stream().to_chunks()
    expected = view_chunks(synthetic_result, ViewConfig())
    assert sum(chunk.num_rows for chunk in saved) == sum(chunk.num_rows for chunk in expected) + 1  # the name


@pytest.mark.parametrize(("at", "instant_ns"), [("0", 0), ("4.25", 4_250_000_000), ("6", 6 * S)])
def test_a_view_opens_at_seconds_from_the_first_window(folder: Path, at: str, instant_ns: int) -> None:
    assert open_view(folder, at=at).instant_ns == instant_ns


def test_a_view_opens_at_a_date_and_time(folder: Path, synthetic_result: Result) -> None:
    assert synthetic_result.summary["windows"][0]["start_ns"] == 1_700_000_000 * S
    assert open_view(folder, at="2023-11-14T22:13:22.5Z").instant_ns == 2_500_000_000
    assert open_view(folder, at="2023-11-14T23:13:22.5+01:00").instant_ns == 2_500_000_000
    assert open_view(folder, at="2023-11-14T22:13:22.5").instant_ns == 2_500_000_000


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"at": "61"}, "it holds 0 to 6 s"),
        ({"at": "-0.5"}, "it holds 0 to 6 s"),
        ({"at": "1e30"}, "it holds"),
        ({"at": "inf"}, "neither seconds"),
        ({"at": "noon"}, "neither seconds"),
        ({"focus": ["car 9"]}, "there are car 1, car 2, car 3"),
        ({"finding": "0"}, "the result has none"),
    ],
)
def test_what_is_not_in_the_result_is_told_in_one_line(
    folder: Path, options: dict[str, object], words: str
) -> None:
    with pytest.raises(UsageError) as caught:
        open_view(folder, **options)  # type: ignore[arg-type]
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_focus_opens_when_its_last_vehicle_comes_unless_told_otherwise(folder: Path) -> None:
    assert open_view(folder, focus=["car 1"]).instant_ns == 0
    assert open_view(folder, focus=["car 1", "car 3"]).instant_ns == S
    assert open_view(folder, focus=["car 3"], at="4").instant_ns == 4 * S
    assert open_view(folder).instant_ns is None


def test_what_is_no_result_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError):
        open_view(tmp_path)


def test_a_finding_opens_where_it_is_worst_and_shows_its_vehicles(
    folder: Path, synthetic_result: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = synthetic_result.summary["windows"][0]["start_ns"]
    rows = [
        {"finding_id": f"{name}0", "vehicles": ["car 2", "car 3"], "worst_ns": start + n * S}
        for n, name in enumerate(("ab", "ac"), start=1)
    ]
    findings = conform(pl.DataFrame(rows), FINDINGS_SCHEMA)
    found = replace(synthetic_result, findings=findings)
    monkeypatch.setattr(pipeline_view, "read_in_parts", lambda path: Reading(path, found))
    opened = open_view(folder, finding="ac")
    assert opened.instant_ns == 2 * S
    assert opened.opening.focus == ("car 2", "car 3")
    assert opened.opening.close_up
    with pytest.raises(UsageError, match="more than one"):
        open_view(folder, finding="a")
    assert open_view(folder, finding="ab", at="0.5", focus=["car 1"]).instant_ns == 500_000_000


def test_focus_shows_one_vehicle_in_full_and_the_others_quietly(synthetic_result: Result) -> None:
    entities = {chunk.entity_path for chunk in view_chunks(synthetic_result, ViewConfig(), ["car 2"])}
    assert "/space_time/planned/corridors/car\\ 2" in entities
    assert "/plots/speed/planned/car\\ 2" in entities
    for other in ("car\\ 1", "car\\ 3"):
        assert f"/space_time/planned/corridors/{other}" not in entities
        assert f"/space_time/quiet/planned/corridors/{other}" in entities
        assert f"/plots/speed/quiet/planned/{other}" in entities
        assert f"/now/planned/box/{other}" in entities


def test_without_a_screen_the_way_out_is_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ExportError, match=r"--save.*--bundle.*--web"):
        open_view(folder).show()


def test_nobody_listening_is_told(folder: Path) -> None:
    with pytest.raises(ExportError, match="no viewer answers"):
        open_view(folder).show("rerun+http://127.0.0.1:9/proxy")


def test_a_result_of_an_older_version_is_shown(folder: Path, synthetic_result: Result) -> None:
    """Fields that came later are missing from the summary, and the configuration has fewer keys."""
    summary = {**synthetic_result.summary}
    (window,) = summary["windows"]
    known = {"index", "start_ns", "end_ns", "units", "frame", "status", "reason", "vehicles", "exclusions"}
    known |= {"vehicles_present", "vehicles_plannable", "vehicles_certified", "undrivable"}
    summary["windows"] = [{key: value for key, value in window.items() if key in known}]
    summary["windows"][0]["vehicles"] = [{"id": vehicle["id"]} for vehicle in window["vehicles"]]
    old = replace(synthetic_result, summary=summary, config_toml="")
    assert len(view_chunks(old, ViewConfig())) > 50
