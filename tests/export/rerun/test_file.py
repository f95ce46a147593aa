"""The file of the Rerun view: whole, small, repeatable, and safe against names."""

from __future__ import annotations

import hashlib
import itertools
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from rerun.chunk import RrdReader

from istc_replay.config import ViewConfig
from istc_replay.datatypes import LaneLine, Result, StaticScene, read_only
from istc_replay.errors import ExportError
from istc_replay.export.rerun import view as rerun_view
from istc_replay.export.rerun.chunks import CHUNK_BYTES, CHUNK_ROWS, entity, label
from istc_replay.export.rerun.view import recording_id, view_chunks, write_view
from istc_replay.states import RESULT_STATES_SCHEMA, conform

from ...support.results import renamed

S = 1_000_000_000

Rows = list[dict[str, Any]]
View = Callable[[Result], dict[str, Rows]]
ByEntity = Callable[[Any], dict[str, Rows]]


def holding(rows: Rows, component: str) -> Rows:
    """The rows, in time, that carry a component."""
    return sorted((r for r in rows if r.get(component) is not None), key=lambda r: r.get("time", 0))


# --- the file --------------------------------------------------------------------------------


def test_the_same_result_gives_the_same_rows(synthetic_result: Result, view_of: View) -> None:
    def digest() -> str:
        rows = view_of(synthetic_result)
        for row in itertools.chain.from_iterable(rows.values()):
            del row["rerun.controls.RowId"]
        return hashlib.sha256(repr(rows).encode()).hexdigest()

    assert digest() == digest()


def test_the_recording_is_the_run(synthetic_result: Result, rrd: Path) -> None:
    (recording,) = RrdReader(rrd).recordings()
    assert recording.application_id == "istc-replay"
    assert recording.recording_id == recording_id(synthetic_result)
    other = replace(synthetic_result, config_toml="[window]\nunit_s = 0.5\n")
    assert recording_id(other) != recording_id(synthetic_result)


def test_reruns_own_check_finds_the_file_whole(rrd: Path) -> None:
    subprocess.run([sys.executable, "-m", "rerun_cli", "rrd", "verify", str(rrd)], check=True)


def test_a_file_without_a_footer_is_written_without_a_word(synthetic_bytes: bytes, tmp_path: Path) -> None:
    (tmp_path / "result.mcap").write_bytes(synthetic_bytes)
    code = """if True:
        import sys
        from pathlib import Path
        from istc_replay.export.rerun import view as rerun_view
        from istc_replay.pipeline.view import open_view
        rerun_view._FOOTER_WINDOWS = 0
        open_view(Path(sys.argv[1])).save(Path(sys.argv[1]) / "view.rrd")
    """
    command = [sys.executable, "-c", code, str(tmp_path)]
    clean = {key: value for key, value in os.environ.items() if key != "RUST_LOG"}
    for asked, told in ((None, ""), ("warn", "will not contain a manifest")):
        own = clean if asked is None else clean | {"RUST_LOG": asked}
        done = subprocess.run(command, capture_output=True, text=True, env=own, check=True)
        assert told in done.stderr
        assert bool(told) == bool(done.stderr)


def test_the_layout_asks_for_whole_subtrees_that_exist(
    rrd: Path, synthetic_result: Result, rows_by_entity: ByEntity
) -> None:
    reader = RrdReader(rrd)
    (layout,) = reader.blueprints()
    rows = rows_by_entity(reader.stream(store=layout).to_chunks())
    queries = [q for own in rows.values() for row in own for q in row.get("ViewContents:query") or []]
    assert len(queries) > 20
    states = synthetic_result.states.with_columns(pl.col("acceleration_mps2").fill_null(0.0))
    full = replace(synthetic_result, states=states)
    # Where not everybody is shown in full, the rest is quiet.
    chunks = [c for focus in ((), ("car 1",)) for c in view_chunks(full, ViewConfig(), focus)]
    entities = {chunk.entity_path for chunk in chunks}
    for query in queries:
        assert query.startswith("/")
        assert query.endswith("/**")
        root = query.removesuffix("/**")
        assert "*" not in root
        assert any(path == root or path.startswith(f"{root}/") for path in entities), query


def test_the_layout_knows_no_scenario() -> None:
    source = Path(rerun_view.__file__).with_name("blueprint.py").read_text(encoding="utf-8")
    assert "Result" not in source
    assert "stage" not in source.lower()


def test_chunks_are_small(synthetic_result: Result) -> None:
    long = pl.concat(
        [
            synthetic_result.states.with_columns(pl.col("time_ns") + n * 6 * S, window=pl.lit(n, pl.Int32))
            for n in range(100)
        ]
    )
    first = synthetic_result.summary["windows"][0]
    windows = [
        {
            **first,
            "index": n,
            "start_ns": first["start_ns"] + 6 * n * S,
            "end_ns": first["end_ns"] + 6 * n * S,
        }
        for n in range(100)
    ]
    lane = LaneLine("long", read_only(np.random.default_rng(0).normal(size=(20_000, 2)), 2))
    result = replace(
        synthetic_result,
        states=long,
        summary={**synthetic_result.summary, "windows": windows},
        scene=StaticScene(lane_lines=(lane, lane, lane)),
    )
    chunks = view_chunks(result, ViewConfig())
    assert max(chunk.num_rows for chunk in chunks) <= CHUNK_ROWS
    assert max(chunk.to_record_batch().nbytes for chunk in chunks) <= 1.1 * CHUNK_BYTES


def test_a_result_without_vehicles_is_a_report(
    synthetic_result: Result, tmp_path: Path, rows_by_entity: ByEntity
) -> None:
    empty = replace(
        synthetic_result,
        states=conform(pl.DataFrame(), RESULT_STATES_SCHEMA),
        corridors=synthetic_result.corridors.clear(),
        obstacles=synthetic_result.obstacles.clear(),
        solves=synthetic_result.solves.clear(),
        certificates=synthetic_result.certificates.clear(),
        scene=StaticScene(),
        summary={**synthetic_result.summary, "windows": []},
    )
    write_view(empty, ViewConfig(), tmp_path / "empty.rrd")
    entities = rows_by_entity(RrdReader(tmp_path / "empty.rrd").stream().to_chunks())
    assert "synthetic\\.mcap" in entities["/report"][0]["TextDocument:text"][0]


def test_a_window_without_a_plan_shows_the_recording(synthetic_result: Result, view_of: View) -> None:
    (window,) = synthetic_result.summary["windows"]
    bare = {
        **window,
        "status": "no_corridors",
        "reason": "pair car 1, car 2 too close",
        "vehicles_certified": 0,
    }
    entities = view_of(
        replace(
            synthetic_result,
            states=synthetic_result.states.filter(pl.col("source") == "recorded"),
            corridors=synthetic_result.corridors.clear(),
            certificates=synthetic_result.certificates.clear(),
            summary={**synthetic_result.summary, "windows": [bare]},
        )
    )
    assert entity("now", "recorded", "box", "car 1") in entities
    (event,) = entities["/events/windows"]
    assert event["TextLog:level"] == ["ERROR"]
    assert "no corridors" in event["TextLog:text"][0]
    assert "pair car 1, car 2 too close" in event["TextLog:text"][0]


def test_a_missing_folder_is_told_in_one_line(synthetic_result: Result, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="cannot be written") as caught:
        write_view(synthetic_result, ViewConfig(), tmp_path / "nowhere" / "view.rrd")
    assert "\n" not in str(caught.value)


# --- untrusted names -------------------------------------------------------------------------

NASTY = {
    "car 1": "<script>alert(1)</script>",
    "car 2": "../..//a|b\n# **c** [d](http://e) \x1b[31m\u202e",
    "car 3": "\u8f66\U0001f697" + "x" * 10_000,
}
DRAWN = set(map(chr, range(0x20, 0x7F))) | set("\u2013\u2026\u00b2")


def test_names_from_the_log_stay_text(synthetic_result: Result, view_of: View) -> None:
    entities = view_of(renamed(synthetic_result, NASTY))
    for name in NASTY.values():
        shown = label(name)
        assert len(shown) <= 40
        assert set(shown) <= DRAWN
        (style,) = holding(entities[entity("now", "planned", "box", shown)], "Boxes3D:labels")
        assert style["Boxes3D:labels"] == [shown]
    assert label(NASTY["car 1"]) == NASTY["car 1"]  # it fits, so it is shown as it is
    assert all(len(path) < 300 and path.isprintable() for path in entities)
    (report,) = entities["/report"]
    text = report["TextDocument:text"][0]
    assert "\\<script\\>alert\\(1\\)\\<\\/script\\>" in text
    assert "<script" not in text.replace("\\<", "")
    assert "](" not in text.replace("\\]", "").replace("\\(", "")
    told = [entities[f"/events/{kind}"] for kind in ("windows", "certificates")]
    lines = [row["TextLog:text"][0] for rows in told for row in rows]
    assert set("".join([*text.splitlines(), *lines])) <= DRAWN
    assert len(text) < 10_000


def test_the_file_of_nasty_names_is_whole(synthetic_result: Result, tmp_path: Path) -> None:
    write_view(renamed(synthetic_result, NASTY), ViewConfig(), tmp_path / "nasty.rrd")
    command = [sys.executable, "-m", "rerun_cli", "rrd", "verify", str(tmp_path / "nasty.rrd")]
    subprocess.run(command, check=True)


def test_different_names_stay_different() -> None:
    long = ["x" * 10_000, "x" * 9_999, "a\nb", "a\tb", "", "\n", "a\N{REPLACEMENT CHARACTER}b", "\ud800"]
    assert len({label(name) for name in long}) == len(long)
