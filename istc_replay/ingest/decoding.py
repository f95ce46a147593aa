"""Decoding the messages of a log, many at a time, into blocks of states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from istc_replay.config import Config
from istc_replay.ingest.batches import Batch, Bytes, Ints
from istc_replay.ingest.channels import Format, recognise
from istc_replay.ingest.columns import Block, Gatherer, Payloads
from istc_replay.ingest.istc import SceneReader
from istc_replay.ingest.meaning import Names, texts_for_numbers
from istc_replay.ingest.payload import PAYLOAD_LIMIT, Budget, PayloadError, TooManyItemsError
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.readers import Reader, Readers
from istc_replay.ingest.records import Channel
from istc_replay.ingest.scene import SceneParts
from istc_replay.ingest.walk import LogFile

#: Bytes of messages that are decoded at once: enough that no step is dear, few enough for the caches.
_BYTES = 2 * 2**20
#: More states than this, plus one for every two bytes of the file, are a trap and not a log.
_STATES_FLOOR = 200_000
#: Schemas that are built for one log.
_SCHEMAS_LIMIT = 256
#: How well formats tell of vehicles, best first; what is told worse is used where nothing else is.
_RANKS = {"scene_update": 1, "tf": 2}
#: The rank of what the configuration chooses.
CHOSEN = -1
_POSES = "foxglove.PosesInFrame"


@dataclass(slots=True)
class _Group:
    """Channels of one schema that are read by one reader; None where it could not be made."""

    format: Format
    rank: int
    reader: Reader | None = None
    scene: SceneReader | None = None
    refused: str = ""
    own: dict[int, int] = field(default_factory=dict)  # topic -> configured vehicle, as codes


class Decoding:
    """Decodes one log.

    Attributes
    ----------
    names : Names
        The texts of all codes.
    parts : SceneParts
        What the log tells of the static scene.
    formats : dict[Channel, Format | None]
        What each channel is read as.
    refused : dict[Channel, str]
        Why channels whose format is known cannot be read.
    """

    def __init__(self, file_size: int, config: Config, problems: Problems) -> None:
        self.names = Names()
        self.parts = SceneParts()
        self.formats: dict[Channel, Format | None] = {}
        self.refused: dict[Channel, str] = {}
        self._config = config
        self._problems = problems
        self._readers = Readers(problems, self.names, self.parts, Budget(file_size))
        limit = _STATES_FLOOR + file_size // 2
        self._gatherer = Gatherer(config.ingest.time_source, limit, problems, self.names)
        self._groups: list[_Group] = []
        self._group_of: dict[Channel, int] = {}
        self._by_schema: dict[tuple[object, ...], int] = {}
        self._channels: dict[Channel, int] = {}
        self._topic_of: list[int] = []
        self._group_codes: list[int] = []
        self._next_index: dict[int, int] = {}
        self._ordinal = 0

    def blocks(self, file: LogFile, progress: Callable[[int, int], None] | None) -> list[Block]:
        """Walk the file and decode what is understood; progress is told bytes read and in all."""
        blocks: list[Block] = []
        held: list[Batch] = []
        size = 0
        for batch in file.batches(self._wanted):
            held.append(batch)
            size += int(batch.ends[-1] - batch.starts[0])
            if size >= _BYTES:
                blocks += self._decode(held)
                held, size = [], 0
                if progress is not None:
                    progress(file.position, file.size)
        if held:
            blocks += self._decode(held)
        if progress is not None:
            progress(file.position, file.size)
        return blocks

    def _wanted(self, channel: Channel) -> bool:
        self.formats[channel] = recognise(channel, self._config.ingest)
        return self.formats[channel] is not None

    # --- groups ----------------------------------------------------------------------------------

    def _code(self, channel: Channel) -> int:
        """Return the code of a channel, with its group made where it is new."""
        if channel in self._channels:
            return self._channels[channel]
        format_ = self.formats[channel]
        if format_ is None:
            raise PayloadError("its channel is not understood", "schema")
        own = self._config.ingest.topics.get(channel.topic)
        chosen = bool(own and (own.format or own.fields))
        key = (
            format_.name,
            format_.family,
            format_.mapping.items,
            str(format_.mapping.fields),
            channel.schema,
            chosen,
        )
        if key not in self._by_schema:
            self._by_schema[key] = len(self._groups)
            self._groups.append(self._group(format_, channel, chosen))
        group = self._groups[self._by_schema[key]]
        topic = self.names.code(channel.topic)
        if own and own.vehicle_id:
            group.own[topic] = self.names.code(own.vehicle_id)
        if group.refused:
            self.refused[channel] = group.refused
        self._channels[channel] = len(self._channels)
        self._topic_of.append(topic)
        self._group_codes.append(self._by_schema[key])
        return self._channels[channel]

    def _group(self, format_: Format, channel: Channel, chosen: bool) -> _Group:
        rank = 2 if format_.name == _POSES else _RANKS.get(format_.family, 0)
        group = _Group(format_, CHOSEN if chosen else rank)
        try:
            if len(self._groups) >= _SCHEMAS_LIMIT:
                raise PayloadError(f"the log has more than {_SCHEMAS_LIMIT} schemas", "schema")
            if format_.name == "istc.v1.Scene":
                group.scene = SceneReader(self.parts, self._config.vehicles, self._problems)
            else:
                group.reader = self._readers.make(format_, channel.schema)
        except PayloadError as error:
            group.refused = str(error)
        return group

    # --- batches ---------------------------------------------------------------------------------

    def _decode(self, batches: list[Batch]) -> list[Block]:
        data, starts, ends = _joined(batches)
        payloads, groups = self._payloads(batches)
        blocks = []
        too_long = ends - starts > PAYLOAD_LIMIT
        for code in np.unique(groups).tolist():
            rows = np.flatnonzero(groups == code)
            group = self._groups[code]
            for row in rows[too_long[rows]].tolist():
                detail = f"a payload of {ends[row] - starts[row]} bytes is above the limit of {PAYLOAD_LIMIT}"
                self._tell(PayloadError(detail), payloads, row)
            rows = rows[~too_long[rows]]
            if group.refused:
                self._tell_refused(group, payloads, rows)
            elif group.scene is not None:
                self._read_scenes(group.scene, data, starts, ends, rows, payloads)
            elif group.reader is not None and not self._gatherer.full:
                blocks += self._blocks(group, group.reader, data, starts[rows], ends[rows], payloads, rows)
        return [block for block in blocks if len(block.whole["ordinal"])]

    def _blocks(
        self,
        group: _Group,
        reader: Reader,
        data: Bytes,
        starts: Ints,
        ends: Ints,
        payloads: Payloads,
        rows: Ints,
    ) -> list[Block]:
        """Decode payloads, in parts where they hold too many items for once."""
        if self._gatherer.full:
            return []
        try:
            return [self._block(group, reader, data, starts, ends, payloads, rows)]
        except TooManyItemsError as error:
            if len(rows) == 1:
                self._tell(PayloadError("it has too many items"), payloads, int(rows[0]))
                return []
            few = min(error.rows, len(rows) - 1)
            parts = [slice(first, first + few) for first in range(0, len(rows), few)]
            return [
                block
                for part in parts
                for block in self._blocks(group, reader, data, starts[part], ends[part], payloads, rows[part])
            ]

    def _block(
        self,
        group: _Group,
        reader: Reader,
        data: Bytes,
        starts: Ints,
        ends: Ints,
        payloads: Payloads,
        rows: Ints,
    ) -> Block:
        decoded = reader.decode(data, starts, ends)
        for row, error in decoded.bad:
            self._tell(error, payloads, int(rows[row]))
        for name, own in texts_for_numbers(decoded):
            self._tell_texts(name, payloads, rows[own])
        texts, topics = self.names.texts, payloads.topics
        states = reader.meaning.states(decoded, lambda own: texts[topics[rows[own[0]]]])
        states.rows = rows[states.rows]
        return self._gatherer.block(states, payloads, group.own, group.format, group.rank)

    def _payloads(self, batches: list[Batch]) -> tuple[Payloads, Ints]:
        """Join what the batches carry beside the payloads; returns the groups as well."""
        parts = []
        for batch in batches:
            table = np.zeros(max(batch.channels) + 1, np.int64)
            for channel_id, channel in batch.channels.items():
                table[channel_id] = self._code(channel)
            parts.append(table[batch.channel_ids])
        channels = np.concatenate(parts)
        topics = np.array(self._topic_of, np.int64)[channels]
        count = len(channels)
        payloads = Payloads(
            np.arange(self._ordinal, self._ordinal + count),
            np.concatenate([batch.log_times_ns for batch in batches]),
            np.concatenate([batch.publish_times_ns for batch in batches]),
            topics,
            self._indexes(topics),
            np.concatenate([batch.offsets for batch in batches]),
        )
        self._ordinal += count
        return payloads, np.array(self._group_codes, np.int64)[channels]

    def _indexes(self, topics: Ints) -> Ints:
        """Number the messages within their topics."""
        order = np.argsort(topics, kind="stable")
        found, first, counts = np.unique(topics[order], return_index=True, return_counts=True)
        base = np.array([self._next_index.get(topic, 0) for topic in found.tolist()], np.int64)
        self._next_index |= dict(zip(found.tolist(), (base + counts).tolist(), strict=True))
        indexes = np.empty(len(topics), np.int64)
        indexes[order] = np.arange(len(topics)) + np.repeat(base - first, counts)
        return indexes

    def _read_scenes(
        self, scene: SceneReader, data: Bytes, starts: Ints, ends: Ints, rows: Ints, payloads: Payloads
    ) -> None:
        for row in rows.tolist():
            try:
                scene.read(data[starts[row] : ends[row]].tobytes())
            except PayloadError as error:
                self._tell(error, payloads, row)

    def _tell(self, error: PayloadError, payloads: Payloads, row: int) -> None:
        topic, index = self.names.texts[payloads.topics[row]], int(payloads.indexes[row])
        detail = f"message {index} on {quoted(topic)} is left out: {error}"
        self._problems.add(error.code, detail, int(payloads.offsets[row]), topic)

    def _tell_texts(self, leaf: str, payloads: Payloads, rows: Ints) -> None:
        for topic in np.unique(payloads.topics[rows]).tolist():
            hit = rows[payloads.topics[rows] == topic]
            name = self.names.texts[topic]
            detail = f"{leaf} on {quoted(name)} is a text where a number is wanted; taken as unknown"
            offset = int(payloads.offsets[hit[0]])
            self._problems.add("not_a_number", detail, offset, f"{name}, {leaf}", len(hit))

    def _tell_refused(self, group: _Group, payloads: Payloads, rows: Ints) -> None:
        for topic in np.unique(payloads.topics[rows]).tolist():
            hit = rows[payloads.topics[rows] == topic]
            name = self.names.texts[topic]
            detail = f"the messages on {quoted(name)} are left out: {group.refused}"
            self._problems.add("schema", detail, int(payloads.offsets[hit[0]]), name, len(hit))


#: Between the bytes of two batches, and after the last.
_APART = bytes(32)


def _joined(batches: list[Batch]) -> tuple[Bytes, Ints, Ints]:
    """Join the bytes that hold the batches' payloads, 32 zeros after each; returns their spans."""
    parts: list[bytes] = []
    starts, ends = [], []
    length = 0
    for batch in batches:
        first, last = int(batch.starts[0]), int(batch.ends[-1])
        parts.append(batch.buffer[first:last])
        starts.append(batch.starts + (length - first))
        ends.append(batch.ends + (length - first))
        length += last - first + len(_APART)
    data = np.frombuffer(_APART.join([*parts, b""]), np.uint8)
    return data, np.concatenate(starts), np.concatenate(ends)
