"""The Rerun view of a result: recorded and planned in one recording, with its layout.

The view is a pure function of the result; the file is a cache that can be made from the result
again, since Rerun promises to read a file only in the version after the one that wrote it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk

from istc_replay.config import ViewConfig
from istc_replay.datatypes import Result
from istc_replay.export.atomic import atomic_file
from istc_replay.export.rerun_blueprint import CLOSE_UP, blueprint
from istc_replay.export.rerun_cast import cast
from istc_replay.export.rerun_chunks import label
from istc_replay.export.rerun_clearance import Clearance, clearances
from istc_replay.export.rerun_events import event_chunks
from istc_replay.export.rerun_eyes import eye_chunks
from istc_replay.export.rerun_findings import finding_chunks
from istc_replay.export.rerun_now import now_chunks
from istc_replay.export.rerun_plots import plot_chunks
from istc_replay.export.rerun_report import report_chunks
from istc_replay.export.rerun_space_time import space_time_chunks
from istc_replay.export.rerun_stage import Anchor, Stage, make_stage
from istc_replay.export.rerun_vehicles import vehicle_chunks

APPLICATION_ID = "istc-replay"


def lay_out(
    result: Result,
    config: ViewConfig,
    focus: Sequence[str] = (),
    anchor: Anchor = Anchor(),  # noqa: B008
) -> tuple[Stage, list[Clearance]]:
    """Lay a result out for the view, and measure its clearances.

    `focus` names whom to show in full; `anchor` is given where the result is a part of a larger one.

    Raises
    ------
    ConfigError
        If the result's configuration cannot be read by this version.
    """
    stage = make_stage(result, config, anchor)
    found = clearances(stage)
    return cast(stage, found, focus), found


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


def view_bytes(result: Result, config: ViewConfig, opening: Opening = Opening()) -> bytes:
    """The view and its layout as the bytes of an .rrd file.

    Raises
    ------
    ConfigError
        If the result's configuration cannot be read by this version.
    """
    recording = new_recording(result)
    # Into memory, not to a file: Rerun's file writer fails without a word when the disk is full.
    memory = recording.memory_recording()
    rr.send_blueprint(opening.blueprint, make_active=True, make_default=True, recording=recording)
    send_result(result, config, opening.focus, recording)
    return bytes(memory.drain_as_bytes())


def new_recording(result: Result, suffix: str = "") -> rr.RecordingStream:
    """A recording of a result, not yet connected to anything."""
    return rr.RecordingStream(
        APPLICATION_ID,
        recording_id=recording_id(result) + suffix,
        make_default=False,
        send_properties=False,
    )


def send_result(
    result: Result, config: ViewConfig, focus: Sequence[str], recording: rr.RecordingStream
) -> None:
    """Send a result's name and its chunks to a recording."""
    rr.send_recording_name(label(PurePath(result.summary["input"]["path"]).name), recording=recording)
    rr.send_chunks(view_chunks(result, config, focus), recording=recording)


def write_view(result: Result, config: ViewConfig, path: Path, opening: Opening = Opening()) -> None:
    """Write the view and its layout as an .rrd file, whole or not at all.

    Raises
    ------
    ConfigError
        If the result's configuration cannot be read by this version.
    ExportError
        If the file cannot be written.
    """
    content = view_bytes(result, config, opening)
    with atomic_file(path) as temporary:
        temporary.write_bytes(content)
