"""Writing one whole MCAP file from the records of others, byte for byte what they hold."""

from __future__ import annotations

import struct
from typing import IO, TYPE_CHECKING

from mcap.writer import Writer

from istc_replay.errors import ExportError

if TYPE_CHECKING:
    from istc_replay.ingest.records import Attachment, Channel, Message, Metadata, Schema

LIBRARY = "istc-replay"
#: Ids are numbers of 16 bits, and 0 is none.
_MOST_IDS = 2**16 - 1

#: Opcode and length of a record.
_HEAD = struct.Struct("<BQ")
_Content = tuple[str, str, "Schema | None", tuple[tuple[str, str], ...]]


class LogCopy:
    """Copies records into a file: payloads, times, sequence numbers and texts as they are.

    Schemas and channels are numbered anew. Channels of one source stay apart; those of several
    sources that are declared alike become one.

    Parameters
    ----------
    stream : binary file
        Written to; not closed.
    profile : str
        What the header states.
    """

    def __init__(self, stream: IO[bytes], profile: str) -> None:
        self._stream = stream
        self._writer = Writer(stream)
        self._writer.start(profile=profile, library=LIBRARY)
        self._schemas: dict[Schema, int] = {}
        self._channels: dict[tuple[int, Channel], int] = {}
        #: By content, the ids given to it; by source and content, the ids it has there.
        self._given: dict[_Content, list[int]] = {}
        self._own: dict[tuple[int, _Content], list[int]] = {}
        self.messages = self.attachments = self.metadata = self.private = 0

    @property
    def channels(self) -> int:
        """Channels written so far."""
        return sum(map(len, self._given.values()))

    def declare(self, source: int, channel: Channel, prefix: str = "") -> int:
        """Declare a channel of a source, its topic below prefix; returns its id.

        Raises
        ------
        ExportError
            If there are more channels or schemas than one file can hold.
        """
        known = self._channels.get((source, channel))
        if known is not None:
            return known
        topic = f"{prefix}/{channel.topic.removeprefix('/')}" if prefix else channel.topic
        content = (topic, channel.message_encoding, channel.schema, tuple(channel.metadata.items()))
        own = self._own.setdefault((source, content), [])
        if channel.id not in own:
            own.append(channel.id)
        place = own.index(channel.id)
        given = self._given.setdefault(content, [])
        if place == len(given):
            if self.channels >= _MOST_IDS:
                raise ExportError(f"more than {_MOST_IDS} channels: one MCAP file cannot hold them")
            schema_id = 0 if channel.schema is None else self.schema(channel.schema)
            given.append(
                self._writer.register_channel(topic, channel.message_encoding, schema_id, channel.metadata)
            )
        self._channels[(source, channel)] = given[place]
        return given[place]

    def schema(self, schema: Schema) -> int:
        """Declare a schema, which a channel may name; returns its id.

        Raises
        ------
        ExportError
            If there are more schemas than one file can hold.
        """
        if schema not in self._schemas:
            if len(self._schemas) >= _MOST_IDS:
                raise ExportError(f"more than {_MOST_IDS} schemas: one MCAP file cannot hold them")
            self._schemas[schema] = self._writer.register_schema(schema.name, schema.encoding, schema.data)
        return self._schemas[schema]

    def message(self, source: int, message: Message, prefix: str = "") -> None:
        """Copy a message of a source."""
        self._writer.add_message(
            self.declare(source, message.channel, prefix),
            message.log_time_ns,
            message.data,
            message.publish_time_ns,
            message.sequence,
        )
        self.messages += 1

    def attachment(self, attachment: Attachment, data: bytes) -> None:
        """Copy an attachment."""
        self._writer.add_attachment(
            attachment.create_time_ns, attachment.log_time_ns, attachment.name, attachment.media_type, data
        )
        self.attachments += 1

    def metadata_record(self, record: Metadata) -> None:
        """Copy a metadata record."""
        self._writer.add_metadata(record.name, record.metadata)
        self.metadata += 1

    def private_record(self, opcode: int, data: bytes) -> None:
        """Copy a private record, which stands outside of chunks."""
        # The writer holds back a chunk in progress, and asks the stream where it is.
        self._stream.write(_HEAD.pack(opcode, len(data)) + data)
        self.private += 1

    def finish(self) -> None:
        """Write the indexes, the statistics and the end."""
        self._writer.finish()
