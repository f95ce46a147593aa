"""Two results in one Rerun recording, side by side: each under its own root, with one layout."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk

from istc_replay.comparison.difference import Comparison
from istc_replay.comparison.words import sentences
from istc_replay.config import parse_config
from istc_replay.datatypes import Result
from istc_replay.errors import ConfigError
from istc_replay.export.rerun.markdown import escaped
from istc_replay.export.rerun.view import (
    Parts,
    laid_out,
    recorded_file,
    recording_id,
    send,
    stage_chunks,
    unsent,
)

APPLICATION_ID = "istc-replay-compare"
#: Lines of the text beside the views.
_LINES = 400
_SIDES = ("a", "b")


def beside_chunks(
    comparison: Comparison, a: Result, b: Result, parts: tuple[Parts | None, Parts | None] = (None, None)
) -> Iterator[list[Chunk]]:
    """Lay two results out: `/a` and `/b` hold what a view of each holds, `/difference` says it in words.

    Both count `scenario_time` from their own first windows.

    Yields
    ------
    list of Chunk
        The words; then each part of either.
    """
    lines = [escaped(text) for text in sentences(comparison)]
    more = [f"and {len(lines) - _LINES} more lines"] if len(lines) > _LINES else []
    text = "\n".join(f"- {line}" for line in lines[:_LINES] + more)
    document = rr.TextDocument.columns(text=[text], media_type=["text/markdown"])
    yield [Chunk.from_columns("/difference", [], document)]
    for side, result, own in zip(_SIDES, map(_readable, (a, b)), parts, strict=True):
        config = parse_config(result.config_toml).view
        sent: set[bytes] = set()
        for stage, found in laid_out(result, config, (), own and partial(_with, result, own)):
            chunks = unsent(stage_chunks(stage, found), sent)
            yield [chunk.with_entity_path(f"/{side}{chunk.entity_path}") for chunk in chunks]


def _with(result: Result, parts: Parts) -> Iterator[Result]:
    """Parts with the settings of the result."""
    return (replace(part, config_toml=result.config_toml) for part in parts())


def _readable(result: Result) -> Result:
    """The result, with the default settings where those of another version cannot be read."""
    try:
        parse_config(result.config_toml)
    except ConfigError:
        return replace(result, config_toml="")
    return result


def beside_blueprint() -> rrb.Blueprint:
    """A on the left, B on the right: corridors above, the scenes, and speed below; the words between."""
    return rrb.Blueprint(
        rrb.Horizontal(
            _side("a"),
            rrb.TextDocumentView(name="what differs", origin="/difference", contents=["/difference/**"]),
            _side("b"),
            column_shares=[40, 20, 40],
        ),
        rrb.TimePanel(timeline="scenario_time", state="collapsed", play_state="paused", loop_mode="all"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _side(side: str) -> rrb.Vertical:
    root = f"/{side}"
    tracks = [f"{root}/space_time/{part}/**" for part in ("shared", "planned")]
    tracks += [f"{root}/{part}/**" for part in ("now/square", "now/planned/box", "camera")]
    # Without the findings of the recordings: here the plans are compared.
    shown = ("shared/map", "shared/outlines", "shared/obstacles", "camera", "planned")
    above = [f"{root}/now/{part}/**" for part in shown]
    name = side.upper()
    return rrb.Vertical(
        rrb.Spatial3DView(
            name=f"{name}: corridors x-y-t",
            origin=root,
            contents=tracks,
            eye_controls=rrb.EyeControls3D(tracking_entity=f"{root}/camera"),
            line_grid=rrb.LineGrid3D(visible=True, stroke_width=0.5),
        ),
        rrb.Spatial3DView(
            name=f"{name}: top-down",
            origin=f"{root}/now",
            contents=above,
            eye_controls=rrb.EyeControls3D(tracking_entity=f"{root}/now/camera"),
            line_grid=rrb.LineGrid3D(visible=False),
        ),
        rrb.Tabs(*(_plot(root, name, signal, unit) for signal, unit in _PLOTS)),
        row_shares=[42, 33, 25],
    )


_PLOTS = (("speed", "m/s"), ("acceleration", "m/s²"), ("clearance", "m"))


def _plot(root: str, name: str, signal: str, unit: str) -> rrb.TimeSeriesView:
    plots = f"{root}/plots/{signal}"
    return rrb.TimeSeriesView(
        name=f"{name}: {signal} [{unit}]",
        origin=plots,
        contents=[f"{plots}/planned/**", f"{plots}/limit/**"],
        axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightBottom),
    )


def write_beside(
    comparison: Comparison,
    a: Result,
    b: Result,
    path: Path,
    parts: tuple[Parts | None, Parts | None] = (None, None),
) -> None:
    """Write both results and their layout as one .rrd file, whole or not at all.

    Parameters
    ----------
    parts : tuple of callable, optional
        Of either as of `write_view`.

    Raises
    ------
    ExportError
        If the file cannot be written.
    """
    identity = hashlib.sha256(f"{recording_id(a)}\n{recording_id(b)}".encode()).hexdigest()[:32]
    recording = rr.RecordingStream(
        APPLICATION_ID, recording_id=identity, make_default=False, send_properties=False
    )
    windows = sum(len(result.summary["windows"]) for result in (a, b))
    with recorded_file(recording, path, windows):
        rr.send_blueprint(beside_blueprint(), make_active=True, make_default=True, recording=recording)
        rr.send_recording_name("A beside B", recording=recording)
        for chunks in beside_chunks(comparison, a, b, parts):
            send(chunks, recording)
