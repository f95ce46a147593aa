"""Reading a log: from any MCAP file to its states, its static scene and its problems."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import polars as pl

from istc_replay.config import Config
from istc_replay.datatypes import ChannelInfo, Log
from istc_replay.ingest.channels import FORMATS, Format, base_link_to_centre_m, recognise, reference_point
from istc_replay.ingest.columns import PAYLOAD_LIMIT, PayloadError, Reader, State, StateColumns
from istc_replay.ingest.istc import SceneReader, VehicleStateReader
from istc_replay.ingest.odometry import OdometryReader
from istc_replay.ingest.osi import OsiReader
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.records import Channel, Message, Schema
from istc_replay.ingest.scene import SceneParts
from istc_replay.ingest.table import check_times, fill_speeds, sort_states, to_centres, wrap_headings
from istc_replay.ingest.walk import LogFile, open_log

#: More states than this, plus one for every four bytes of the file, are a trap and not a log.
_STATES_FLOOR = 1_000_000
#: OSI descriptors that are built for one log.
_SCHEMAS_LIMIT = 16
_UNUSABLE = "its schema cannot be used"


def read_log(path: Path, config: Config | None = None) -> Log:
    """Read a log.

    Parameters
    ----------
    path : Path
        Any MCAP file.
    config : Config, optional
        The sections `ingest` and `vehicles` say how to read it.

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
    return _Reading(file, config or Config()).log(str(path))


class _Reading:
    """One reading of one log."""

    def __init__(self, file: LogFile, config: Config) -> None:
        self._file = file
        self._config = config
        self._problems = Problems()
        self._parts = SceneParts()
        self._formats: dict[Channel, Format | None] = {}
        self._readers: dict[Channel, Reader | None] = {}
        self._osi: dict[int, OsiReader | None] = {}

    def log(self, path: str) -> Log:
        file = self._file
        sha256 = file.sha256()
        states = self._table(self._columns(file))
        self._tell_of_channels()
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
            scene=self._parts.scene(),
            problems=found,
            time_source=self._config.ingest.time_source,
        )

    def _columns(self, file: LogFile) -> StateColumns:
        limit = _STATES_FLOOR + file.size // 4
        columns = StateColumns(self._config.ingest.time_source, limit, self._problems)
        indexes: Counter[str] = Counter()
        for message in file.messages(lambda channel: self._format(channel) is not None):
            topic = message.channel.topic
            index = indexes[topic]
            indexes[topic] += 1
            try:
                for state in self._states(message):
                    columns.add(state, message, index)
            except PayloadError as error:
                detail = f"message {index} on {quoted(topic)} is left out: {error}"
                self._problems.add(error.code, detail, message.offset, topic)
        return columns

    def _states(self, message: Message) -> list[State]:
        channel = message.channel
        if channel not in self._readers:
            self._readers[channel] = None
            self._readers[channel] = self._reader(channel)
        reader = self._readers[channel]
        if reader is None:
            raise PayloadError(_UNUSABLE, "schema")
        if len(message.data) > PAYLOAD_LIMIT:
            raise PayloadError(
                f"a payload of {len(message.data)} bytes is above the limit of {PAYLOAD_LIMIT}"
            )
        return reader.states(message.data)

    def _reader(self, channel: Channel) -> Reader:
        format_ = self._format(channel)
        topic = self._config.ingest.topics.get(channel.topic)
        vehicle_id = topic.vehicle_id if topic else None
        if format_ is None or channel.schema is None:
            raise PayloadError("its channel is not understood", "schema")
        if format_.name == "istc.v1.Scene":
            return SceneReader(self._parts, self._config.vehicles, self._problems)
        if format_.family == "istc":
            return VehicleStateReader(vehicle_id, self._problems)
        if format_.family == "odometry":
            return OdometryReader(channel.topic, channel.schema, vehicle_id, self._problems)
        return self._osi_reader(channel.schema)

    def _osi_reader(self, schema: Schema) -> OsiReader:
        # Many channels can share a schema: it is built once, or fails once.
        key = id(schema)
        if key not in self._osi:
            if len(self._osi) >= _SCHEMAS_LIMIT:
                raise PayloadError(f"the log has more than {_SCHEMAS_LIMIT} OSI schemas", "schema")
            self._osi[key] = None
            self._osi[key] = OsiReader(schema, self._parts, self._problems)
        reader = self._osi[key]
        if reader is None:
            raise PayloadError(_UNUSABLE, "schema")
        return reader

    def _table(self, columns: StateColumns) -> pl.DataFrame:
        states = columns.table()
        check_times(states, self._problems)
        ingest = self._config.ingest
        references: dict[str, float | None] = {}
        for channel, format_ in self._formats.items():
            if format_ is None:
                continue
            point = reference_point(channel.topic, format_, ingest)
            if point != "box_centre":
                fixed = base_link_to_centre_m(channel.topic, ingest) if point == "base_link" else None
                references[channel.topic] = fixed
        centred = to_centres(states, references, self._config.vehicles, self._problems)
        return fill_speeds(sort_states(wrap_headings(centred)))

    def _format(self, channel: Channel) -> Format | None:
        if channel not in self._formats:
            self._formats[channel] = recognise(channel, self._config.ingest)
        return self._formats[channel]

    def _info(self, channel: Channel) -> ChannelInfo:
        format_ = self._format(channel)
        unreadable = channel in self._readers and self._readers[channel] is None
        return ChannelInfo(
            topic=channel.topic,
            schema=channel.schema.name if channel.schema else "",
            schema_encoding=channel.schema.encoding if channel.schema else "",
            message_encoding=channel.message_encoding,
            messages=self._file.counts[channel],
            understood_as=None if format_ is None or unreadable else format_.name,
        )

    def _tell_of_channels(self) -> None:
        """Tell what of the channels and the configuration leaves the reading empty or doubtful."""
        counts = self._file.counts
        topics = {channel.topic for channel in counts}
        for topic in self._config.ingest.topics:
            if topic not in topics:
                self._problems.add(
                    "unknown_topic", f"ingest.topics names {quoted(topic)}, not a topic of this log"
                )
        for channel in counts:
            own = self._config.ingest.topics.get(channel.topic)
            if own and own.format not in (None, "ignore") and self._format(channel) is None:
                detail = f"{quoted(channel.topic)} is not encoded as {own.format}; its encoding is "
                self._problems.add("not_as_configured", detail + quoted(channel.message_encoding))
        if not counts:
            self._problems.add("no_channels", "no channel of this log could be found: it holds no states")
        elif not any(self._format(channel) for channel in counts):
            known = ", ".join(format_.name for format_ in FORMATS)
            self._problems.add("nothing_understood", f"no channel holds a format that is read: {known}")
        odometries = (reader for reader in self._readers.values() if isinstance(reader, OdometryReader))
        frames = sorted({frame for reader in odometries for frame in reader.frames})
        if len(frames) > 1:
            names = ", ".join(quoted(frame) for frame in frames[:5])
            detail = f"odometry is told in {len(frames)} frames, taken for one: {names}"
            self._problems.add("frames_differ", detail)
