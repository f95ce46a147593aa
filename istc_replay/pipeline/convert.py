"""Recordings of other formats as logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from istc_replay.config import Config
from istc_replay.datatypes import Problem
from istc_replay.errors import LogError, UsageError
from istc_replay.export.atomic import atomic_file
from istc_replay.export.states_log import write_states
from istc_replay.ingest import commonroad, sumo
from istc_replay.ingest.foreign import ForeignRecording
from istc_replay.ingest.problems import quoted
from istc_replay.ingest.tables import SUFFIXES, read_table
from istc_replay.ingest.xml_stream import head_of
from istc_replay.pipeline.copying import Progress, refuse_inputs, silent
from istc_replay.units import NS_PER_S


@dataclass(frozen=True, slots=True)
class Converted:
    """What a conversion has read and written."""

    path: Path
    kind: str
    states: int
    vehicles: int
    obstacles: int
    lanes: int
    span_s: float
    complete: bool
    problems: tuple[Problem, ...]
    notes: tuple[str, ...]


def convert_recording(
    source: Path,
    out: Path,
    config: Config,
    types: Sequence[Path] = (),
    progress: Progress = silent,
    net: Path | None = None,
) -> Converted:
    """Write a CommonRoad scenario, SUMO's FCD, or a table of states as an MCAP log.

    Parameters
    ----------
    source : Path
        XML (also gzip), CSV or Parquet; what it is shows in its content and name.
    out : Path
        The log.
    config : Config
        `ingest.columns` names a table's columns.
    types : sequence of Path
        SUMO files that declare the vTypes.
    progress : callable, optional
        Told bytes or rows read, and those in all.
    net : Path, optional
        SUMO's network, whose lanes go into the log.

    Raises
    ------
    LogError
        If the source cannot be read or holds no state.
    UsageError
        If the output is the source, or types or a network are given for what is not SUMO's.
    """
    refuse_inputs(out, [source, *types, *([] if net is None else [net])])
    found = _read(source, config, list(types), progress, net)
    with atomic_file(out) as temporary, temporary.open("wb") as stream:
        write_states(found.states, found.scene, stream)
    times = found.states["time_ns"]
    return Converted(
        out,
        found.kind,
        found.states.height,
        found.states["vehicle_id"].n_unique(),
        len(found.scene.obstacles),
        len(found.scene.lane_lines),
        (times[-1] - times[0]) / NS_PER_S,
        found.complete,
        found.problems,
        found.notes,
    )


def _read(
    source: Path, config: Config, types: list[Path], progress: Progress, net: Path | None
) -> ForeignRecording:
    if not source.is_file():
        raise LogError(f"{source}: no such file; give a CommonRoad or SUMO XML, a CSV or a Parquet file")
    root = "" if source.suffix in SUFFIXES else head_of(source)[0]
    if types and root != sumo.ROOT:
        raise UsageError(f"--types goes with SUMO's FCD; {source} is none")
    if net is not None and root != sumo.ROOT:
        raise UsageError(f"--net goes with SUMO's FCD; {source} is none")
    if source.suffix in SUFFIXES:
        return read_table(source, {str(k): v for k, v in config.ingest.columns.items()}, progress)
    if root == sumo.ROOT:
        return sumo.read_fcd(source, types, progress, net)
    if root == commonroad.ROOT:
        return commonroad.read_commonroad(source, progress)
    what = f"its outermost element is {quoted(root, 40)}" if root else "it is no XML"
    raise LogError(
        f"{source}: {what}; give a CommonRoad scenario (commonRoad), SUMO's FCD (fcd-export), "
        f"or a table named {', '.join(SUFFIXES)}"
    )
