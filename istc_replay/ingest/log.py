"""Reading a log: from any MCAP file to its states, its static scene and its problems."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl

from istc_replay.config import Config
from istc_replay.datatypes import ChannelInfo, Log, StaticScene
from istc_replay.ingest.channels import FORMATS, base_link_to_centre_m, reference_point, why_not
from istc_replay.ingest.columns import Block
from istc_replay.ingest.decoding import CHOSEN, Decoding
from istc_replay.ingest.frames import TransformTree, check_frames, to_root
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.records import Channel
from istc_replay.ingest.road_file import read_road
from istc_replay.ingest.states_table import (
    Columns,
    check_times,
    derive_headings,
    derive_motion,
    sort_states,
    to_centres,
    to_table,
)
from istc_replay.ingest.walk import LogFile, open_log

_BETTER_TOLD = "its vehicles are told better by other topics; ingest.topics can choose it"


def read_log(
    path: Path, config: Config | None = None, progress: Callable[[int, int], None] | None = None
) -> Log:
    """Read a log.

    Parameters
    ----------
    path : Path
        Any MCAP file.
    config : Config, optional
        The sections `ingest` and `vehicles` say how to read it.
    progress : callable, optional
        Told the bytes that are read and those that there are.

    Returns
    -------
    Log
        Everything intact in the file: the states (box centres, map frame) sorted by vehicle and
        time, the scene, the channels, and as problems what is damaged or was left out. `complete`
        is False where a part of the file is missing or damaged. `start_ns` and `end_ns` span the
        log times of all messages.

    Raises
    ------
    LogError
        If nothing can be had: no such file, a directory, unreadable, or not MCAP.
    """
    file = open_log(path)
    # What comes out not finite is taken as unknown, so it needs no warning on the way.
    with np.errstate(all="ignore"):
        return _Reading(file, config or Config()).log(str(path), progress)


class _Reading:
    """One reading of one log."""

    def __init__(self, file: LogFile, config: Config) -> None:
        self._file = file
        self._config = config
        self._problems = Problems()
        self._decoding = Decoding(file.size, config, self._problems)
        self._unused: set[str] = set()
        self._road_sha256 = ""

    def log(self, path: str, progress: Callable[[int, int], None] | None) -> Log:
        file = self._file
        sha256 = file.sha256()
        states = self._table(self._decoding.blocks(file, progress))
        self._tell_of_channels()
        scene = self._scene()
        found = file.problems + self._problems.found()
        return Log(
            path=path,
            sha256=sha256,
            complete=file.complete and not self._problems.lost,
            messages=file.message_count,
            attachments=file.attachment_count,
            metadata=file.metadata_count,
            chunks=file.chunk_count,
            start_ns=file.start_ns,
            end_ns=file.end_ns,
            channels=tuple(sorted(map(self._info, file.counts), key=lambda info: info.topic)),
            states=states,
            scene=scene,
            problems=found,
            time_source=self._config.ingest.time_source,
            road_sha256=self._road_sha256,
        )

    def _scene(self) -> StaticScene:
        """What the log tells of the scene, and the road of a file beside it."""
        parts, road = self._decoding.parts, self._config.ingest.road_file
        if road is not None:
            self._road_sha256 = read_road(Path(road), parts)
        return parts.scene()

    def _table(self, blocks: list[Block]) -> pl.DataFrame:
        names, problems = self._decoding.names, self._problems
        tree = TransformTree([block for block in blocks if block.family == "tf"], names)
        blocks = self._best(blocks, tree)
        for block in blocks:
            to_root(block, tree)
        check_frames(blocks, names, problems)
        states = Columns.of(blocks)
        check_times(states, names, problems)
        sort_states(states, names, problems)
        marks = derive_headings(states)
        to_centres(states, self._references(), self._config.vehicles, names, problems)
        marks |= derive_motion(states)
        return to_table(states, marks, names)

    def _best(self, blocks: list[Block], tree: TransformTree) -> list[Block]:
        """Keep the states of the formats that tell vehicles best, and those that were chosen."""
        best = min((block.rank for block in blocks if block.rank != CHOSEN), default=0)
        kept = []
        vehicles = list(tree.vehicles())
        for block in blocks:
            if block.rank > best:
                self._unused.add(block.format)
                continue
            if block.family == "tf":
                told = block.whole["child"]
                keep = (told[:, None] == vehicles).any(axis=1) if vehicles else told < 0
                kept.append(block.only(keep))
            else:
                kept.append(block)
        return kept

    def _references(self) -> dict[int, float | None]:
        """For topics whose positions are no box centres, the distance to these (None: from the rear axle)."""
        ingest = self._config.ingest
        references: dict[int, float | None] = {}
        for channel, format_ in self._decoding.formats.items():
            if format_ is None:
                continue
            point = reference_point(channel.topic, format_, ingest)
            if point != "box_centre":
                fixed = base_link_to_centre_m(channel.topic, ingest) if point == "base_link" else None
                references[self._decoding.names.code(channel.topic)] = fixed
        return references

    def _info(self, channel: Channel) -> ChannelInfo:
        format_ = self._decoding.formats.get(channel)
        refused = self._decoding.refused.get(channel, "")
        understood = None if format_ is None or refused else format_.name
        reason = refused or ("" if format_ else why_not(channel, self._config.ingest))
        if format_ is not None and understood and format_.name in self._unused:
            reason = _BETTER_TOLD
        first_ns, last_ns = self._file.spans.get(channel, (None, None))
        return ChannelInfo(
            topic=channel.topic,
            schema=channel.schema.name if channel.schema else "",
            schema_encoding=channel.schema.encoding if channel.schema else "",
            message_encoding=channel.message_encoding,
            messages=self._file.counts[channel],
            understood_as=understood,
            reason=reason,
            first_ns=first_ns,
            last_ns=last_ns,
        )

    def _tell_of_channels(self) -> None:
        """Tell what of the channels and the configuration leaves the reading empty or doubtful."""
        counts, formats = self._file.counts, self._decoding.formats
        topics = {channel.topic for channel in counts}
        for topic in self._config.ingest.topics:
            if topic not in topics:
                detail = f"ingest.topics names {quoted(topic)}, not a topic of this log"
                self._problems.add("unknown_topic", detail)
        for channel in counts:
            own = self._config.ingest.topics.get(channel.topic)
            named = own and (own.format not in (None, "ignore") or own.fields)
            if own and named and formats.get(channel) is None and channel in formats:
                detail = (
                    f"{quoted(channel.topic)} is not encoded as {own.format or 'fields'}; its encoding is "
                )
                self._problems.add("not_as_configured", detail + quoted(channel.message_encoding))
        if not counts:
            self._problems.add("no_channels", "no channel of this log could be found: it holds no states")
        elif not any(formats.get(channel) for channel in counts):
            known = ", ".join(format_.name for format_ in FORMATS)
            self._problems.add("nothing_understood", f"no channel holds a format that is read: {known}")
