"""The Rerun view of a result: recorded and planned in one recording, with its layout.

The view is a pure function of the result; the file is a cache that can be made from the result
again, since Rerun promises to read a file only in the version after the one that wrote it.
"""

from __future__ import annotations

import hashlib
import os
import threading
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import BinaryIO

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk

from istc_replay.config import ViewConfig
from istc_replay.datatypes import Result
from istc_replay.errors import ExportError
from istc_replay.export.atomic import atomic_file
from istc_replay.export.rerun.blueprint import CLOSE_UP, blueprint
from istc_replay.export.rerun.cast import Survey, cast
from istc_replay.export.rerun.chunks import label
from istc_replay.export.rerun.clearance import Clearance, clearances
from istc_replay.export.rerun.events import event_chunks
from istc_replay.export.rerun.eyes import eye_chunks
from istc_replay.export.rerun.findings import finding_chunks
from istc_replay.export.rerun.now import now_chunks
from istc_replay.export.rerun.plots import plot_chunks
from istc_replay.export.rerun.report import report_chunks
from istc_replay.export.rerun.space_time import space_time_chunks
from istc_replay.export.rerun.spans import WHOLE, Anchor
from istc_replay.export.rerun.stage import Stage, make_stage
from istc_replay.export.rerun.vehicles import vehicle_chunks

APPLICATION_ID = "istc-replay"

#: The longest that a part of a view may take to be written [s].
_FLUSH_S = 300.0
_PIECE_BYTES = 2**20
#: The file of a result with more windows has no footer.
_FOOTER_WINDOWS = 128
#: Gives the parts of a result in order of time, each time that it is called.
Parts = Callable[[], Iterator[Result]]


def lay_out(
    result: Result,
    config: ViewConfig,
    focus: Sequence[str] = (),
    anchor: Anchor = WHOLE,
) -> tuple[Stage, list[Clearance]]:
    """Lay a result out for the view, and measure its clearances.

    `focus` names whom to show in full; `anchor` is given where the result is a part of a larger one.

    Raises
    ------
    ConfigError
        If the result's configuration cannot be read by this version.
    """
    stage, whole = make_stage(result, config, anchor), Survey()
    found = clearances(stage)
    whole.add(stage, found)
    stage = cast(stage, found, focus, whole)
    # Who comes when, and into which slot, is not known of what is still being made.
    return stage if anchor == Anchor() else replace(stage, presence={}, slots={}), found


def laid_out(
    result: Result, config: ViewConfig, focus: Sequence[str], parts: Parts | None
) -> Iterator[tuple[Stage, list[Clearance]]]:
    """Lay a result out part by part, as the whole would be; goes through the parts twice."""
    if parts is None:
        yield lay_out(result, config, focus)
        return
    whole = Survey()
    for stage in _stages(result, config, parts):
        whole.add(stage, clearances(stage))
    scaled = config.model_copy(update={"metres_per_second": config.metres_per_second or whole.height_m})
    for stage in _stages(result, scaled, parts):
        found = clearances(stage)
        yield cast(stage, found, focus, whole), found


def _stages(result: Result, config: ViewConfig, parts: Parts) -> Iterator[Stage]:
    starts = sorted(window["start_ns"] for window in result.summary["windows"])
    anchor = WHOLE
    for number, part in enumerate(parts()):
        own = [window["start_ns"] for window in part.summary["windows"]]
        following = bisect_right(starts, max(own, default=0))
        stage = make_stage(
            part,
            config,
            replace(
                anchor,
                from_ns=min(own) if number else None,
                until_ns=starts[following] if following < len(starts) else None,
            ),
        )
        units = len(stage.clock.unit_starts_ns) - 1
        anchor = replace(
            anchor,
            origin_ns=stage.clock.origin_ns,
            origin_m=stage.origin_m,
            first_unit=anchor.first_unit + units,
        )
        yield stage


def view_chunks(result: Result, config: ViewConfig, focus: Sequence[str] = ()) -> list[Chunk]:
    """The chunks of a Rerun recording of a result.

    Entities: `/space_time` corridors and trajectories in (x, y, t), `/now` the replay on the
    present plane, `/plots/<signal>/<source>/<vehicle>`, `/states`, `/precedence`, `/events`,
    `/report`, and the eyes `/camera` and `/now/camera`. Positions are relative to the first
    window's frame origin, so that single precision holds them. Timelines: `time`,
    `scenario_time` (from the first window's start) and `time_unit`.

    Raises
    ------
    ConfigError
        If the result's configuration cannot be read by this version.
    """
    return stage_chunks(*lay_out(result, config, focus))


def stage_chunks(stage: Stage, found: list[Clearance]) -> list[Chunk]:
    """The chunks of a result that is laid out."""
    return [
        *eye_chunks(stage),
        *space_time_chunks(stage),
        *now_chunks(stage),
        *vehicle_chunks(stage),
        *finding_chunks(stage),
        *plot_chunks(stage, found),
        *event_chunks(stage, found),
        *report_chunks(stage, found),
    ]


def recording_id(result: Result) -> str:
    """A run's identity: the same log planned with the same configuration has the same."""
    identity = f"{result.summary['input']['sha256']}\n{result.config_toml}"
    return hashlib.sha256(identity.encode()).hexdigest()[:32]


@dataclass(frozen=True, slots=True)
class Opening:
    """How a view opens: whom it shows in full, and on which tab of the view from above."""

    focus: tuple[str, ...] = ()
    close_up: bool = False

    @property
    def blueprint(self) -> rrb.Blueprint:
        """The layout that opens so."""
        return blueprint(above=CLOSE_UP if self.close_up else None)


def new_recording(result: Result, suffix: str = "") -> rr.RecordingStream:
    """A recording of a result, not yet connected to anything."""
    return rr.RecordingStream(
        APPLICATION_ID,
        recording_id=recording_id(result) + suffix,
        make_default=False,
        send_properties=False,
    )


def send_result(
    result: Result,
    config: ViewConfig,
    focus: Sequence[str],
    recording: rr.RecordingStream,
    parts: Parts | None = None,
) -> Iterator[None]:
    """Send a result's name and its chunks to a recording, part by part; arguments as of `write_view`.

    Yields
    ------
    None
        After each part, to take what is sent.
    """
    rr.send_recording_name(label(PurePath(result.summary["input"]["path"]).name), recording=recording)
    sent: set[bytes] = set()
    for stage, found in laid_out(result, config, focus, parts):
        rr.send_chunks(unsent(stage_chunks(stage, found), sent), recording=recording)
        yield


def unsent(chunks: list[Chunk], sent: set[bytes]) -> list[Chunk]:
    """The chunks without those that hold at all times and were sent with an earlier part."""
    kept = []
    for chunk in chunks:
        if chunk.is_static:
            batch = chunk.to_record_batch()
            told = [batch.column(name).to_pylist() for name in batch.schema.names if "RowId" not in name]
            digest = hashlib.sha256(f"{chunk.entity_path}\n{batch.schema.names}\n{told}".encode()).digest()
            if digest in sent:
                continue
            sent.add(digest)
        kept.append(chunk)
    return kept


def write_view(
    result: Result,
    config: ViewConfig,
    path: Path,
    opening: Opening = Opening(),
    parts: Parts | None = None,
) -> None:
    """Write the view and its layout as an .rrd file, whole or not at all.

    Parameters
    ----------
    result : Result
        The result; without its states where there are `parts`.
    config : ViewConfig
        How it is shown.
    path : Path
        The file.
    opening : Opening
        How it opens.
    parts : callable, optional
        Gives the result's parts in order of time, each time that it is called.

    Raises
    ------
    ConfigError
        If the result's configuration cannot be read by this version.
    ExportError
        If the file cannot be written.
    """
    recording = new_recording(result)
    with recorded_file(recording, path, len(result.summary["windows"])):
        rr.send_blueprint(opening.blueprint, make_active=True, make_default=True, recording=recording)
        for _ in send_result(result, config, opening.focus, recording, parts):
            recording.flush(timeout_sec=_FLUSH_S)


def send(chunks: list[Chunk], recording: rr.RecordingStream) -> None:
    """Send chunks to a recording, and wait until they are written."""
    rr.send_chunks(chunks, recording=recording)
    recording.flush(timeout_sec=_FLUSH_S)


@contextmanager
def recorded_file(recording: rr.RecordingStream, path: Path, windows: int) -> Iterator[None]:
    """Let a recording of so many windows go to a file, that is there whole after the block or not at all."""
    with (
        atomic_file(path) as temporary,
        temporary.open("wb") as file,
        _piped(recording, file, footer=windows <= _FOOTER_WINDOWS),
    ):
        yield


@contextmanager
def _piped(recording: rr.RecordingStream, file: BinaryIO, *, footer: bool) -> Iterator[None]:
    """Let a recording's bytes go to a file, in which all of them are after the block.

    Rerun's own file writer fails without a word when the disk is full, so that it writes to a pipe.
    For the footer, a list of all chunks, it would keep some kilobytes a chunk in memory.
    """
    reading, writing = os.pipe()
    refused: list[OSError] = []

    def pump() -> None:
        with os.fdopen(reading, "rb", buffering=0) as pipe:
            while data := pipe.read(_PIECE_BYTES):
                try:
                    if not refused:
                        file.write(data)
                except OSError as error:
                    refused.append(error)

    thread = threading.Thread(target=pump, daemon=True)
    thread.start()
    try:
        recording.save(f"/dev/fd/{writing}", write_footer=footer)
    finally:
        os.close(writing)
    try:
        yield
    finally:
        recording.disconnect()
        thread.join(_FLUSH_S)
    if refused:
        raise refused[0]
    if thread.is_alive():
        raise ExportError("the view cannot be written: Rerun does not end its stream; run again")
