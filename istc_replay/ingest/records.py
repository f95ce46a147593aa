"""The records of an MCAP file, parsed field by field from any buffer."""

from __future__ import annotations

import mmap
import struct
import zlib
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

MAGIC = b"\x89MCAP0\r\n"
#: A record's opcode and the length of its content.
RECORD = struct.Struct("<BQ")
#: Channel id, sequence, log time and publish time of a message, before its data.
MESSAGE = struct.Struct("<HIQQ")
#: A footer as written: its record head, summary start, summary offset start, summary CRC.
FOOTER = struct.Struct("<BQQQI")
#: A channel's ids and the length of its topic, and any length.
_CHANNEL, _LENGTH = struct.Struct("<HHI"), struct.Struct("<I")
#: Opcodes from here on are free for private use.
PRIVATE = 0x80

_CRC_PIECE = 2**20


class Opcode(IntEnum):
    """The kinds of record."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


class MalformedRecordError(ValueError):
    """A record's fields run past its end."""


#: What records are read from.
Buffer = bytes | mmap.mmap


@dataclass(frozen=True, slots=True)
class Schema:
    """A schema: its text or descriptor, and the encoding it is written in."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """A channel; compared by identity, since one id can be declared twice.

    `schema` is None for schemaless channels and where the schema is missing.
    """

    id: int
    topic: str
    message_encoding: str
    metadata: dict[str, str]
    schema: Schema | None

    def same_as(self, other: Channel) -> bool:
        """Tell whether the other declares the same."""
        return (self.id, self.topic, self.message_encoding, self.metadata, self.schema) == (
            other.id,
            other.topic,
            other.message_encoding,
            other.metadata,
            other.schema,
        )


class Message(NamedTuple):
    """A message as recorded. The times are unsigned 64-bit integers [ns], so may pass int64."""

    channel: Channel
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    data: bytes
    offset: int  # byte of its record, or of its chunk's


@dataclass(frozen=True, slots=True)
class Attachment:
    """An attachment; `start` and `size` say where its data are in the file."""

    name: str
    media_type: str
    log_time_ns: int
    create_time_ns: int
    start: int
    size: int


@dataclass(frozen=True, slots=True)
class Metadata:
    """A metadata record."""

    name: str
    metadata: dict[str, str]


@dataclass(frozen=True, slots=True)
class Statistics:
    """The counts that the writer noted in the summary."""

    messages: int
    attachments: int
    metadata: int
    chunks: int


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """A chunk without its records, which stand at start .. start + size in the buffer."""

    uncompressed_size: int
    crc: int
    compression: str
    start: int
    size: int


@dataclass(slots=True)
class Fields:
    """Reads the fields of one record in order, never past its end.

    Raises
    ------
    MalformedRecordError
        From every method, if a field runs past `end`.
    """

    buffer: Buffer
    position: int
    end: int
    replaced: bool = field(default=False)  # some string was not UTF-8

    def uint(self, size: int) -> int:
        """Read an unsigned little-endian integer of size bytes."""
        return int.from_bytes(self.take(size), "little")

    def take(self, size: int) -> bytes:
        """Read size bytes."""
        start = self.skip(size)
        return self.buffer[start : start + size]

    def skip(self, size: int) -> int:
        """Pass over size bytes; returns where they start."""
        start = self.position
        if size > self.end - start:
            raise MalformedRecordError(f"a field of {size} bytes where {self.end - start} are left")
        self.position = start + size
        return start

    def string(self) -> str:
        """Read a string; bytes that are not UTF-8 become replacement characters."""
        raw = self.take(self.uint(4))
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError:
            self.replaced = True
            return raw.decode("utf-8", "replace")

    def string_map(self) -> dict[str, str]:
        """Read a map of strings."""
        size = self.uint(4)
        end = self.position + size
        if end > self.end:
            raise MalformedRecordError(f"a map of {size} bytes where {self.end - self.position} are left")
        values: dict[str, str] = {}
        while self.position < end:
            key = self.string()
            values[key] = self.string()
        return values


def crc_of(buffer: Buffer, start: int, end: int) -> int:
    """CRC-32 of a span, computed without copying it whole."""
    crc = 0
    for piece in range(start, end, _CRC_PIECE):
        crc = zlib.crc32(buffer[piece : min(piece + _CRC_PIECE, end)], crc)
    return crc


def parse_schema(fields: Fields) -> tuple[int, Schema]:
    """Parse a schema; returns its id with it."""
    schema_id = fields.uint(2)
    name, encoding = fields.string(), fields.string()
    return schema_id, Schema(name, encoding, fields.take(fields.uint(4)))


def parse_channel(fields: Fields, schemas: dict[int, Schema]) -> tuple[int, Channel]:
    """Parse a channel; returns its schema id (0: schemaless) with it."""
    quick = _plain_channel(fields.buffer[fields.position : fields.end])
    if quick is not None:
        channel_id, schema_id, topic, encoding = quick
        return schema_id, Channel(channel_id, topic, encoding, {}, schemas.get(schema_id))
    channel_id, schema_id = fields.uint(2), fields.uint(2)
    topic, encoding = fields.string(), fields.string()
    metadata = fields.string_map()
    return schema_id, Channel(channel_id, topic, encoding, metadata, schemas.get(schema_id))


def _plain_channel(raw: bytes) -> tuple[int, int, str, str] | None:
    """Parse a whole channel record without metadata, five times as fast; None where it is not that."""
    try:
        channel_id, schema_id, size = _CHANNEL.unpack_from(raw)
        place = _CHANNEL.size + size
        (more,) = _LENGTH.unpack_from(raw, place)
        if raw[place + 4 + more :] != b"\0\0\0\0":
            return None
        topic = raw[_CHANNEL.size : place].decode("utf-8")
        return channel_id, schema_id, topic, raw[place + 4 : place + 4 + more].decode("utf-8")
    except (struct.error, UnicodeDecodeError):
        return None


def parse_chunk(fields: Fields) -> ChunkHead:
    """Parse a chunk's head."""
    fields.skip(16)  # the span of its messages' times
    uncompressed_size, crc = fields.uint(8), fields.uint(4)
    compression = fields.string()
    size = fields.uint(8)
    return ChunkHead(uncompressed_size, crc, compression, fields.skip(size), size)


def parse_attachment(fields: Fields) -> tuple[Attachment, int]:
    """Parse an attachment; returns its CRC with it."""
    log_time_ns, create_time_ns = fields.uint(8), fields.uint(8)
    name, media_type = fields.string(), fields.string()
    size = fields.uint(8)
    start = fields.skip(size)
    return Attachment(name, media_type, log_time_ns, create_time_ns, start, size), fields.uint(4)


def parse_metadata(fields: Fields) -> Metadata:
    """Parse a metadata record."""
    return Metadata(fields.string(), fields.string_map())


def parse_statistics(fields: Fields) -> Statistics:
    """Parse the statistics."""
    messages = fields.uint(8)
    fields.skip(6)  # counts of schemas and channels: declared again, they say nothing of losses
    return Statistics(messages, fields.uint(4), fields.uint(4), fields.uint(4))


def profile_of(buffer: Buffer) -> str:
    """Return the profile that a file's header states; empty where it states none or is damaged."""
    start = len(MAGIC) + RECORD.size
    if len(buffer) < start:
        return ""
    opcode, length = RECORD.unpack(buffer[len(MAGIC) : start])
    try:
        fields = Fields(buffer, start, min(start + length, len(buffer)))
        return fields.string() if opcode == Opcode.HEADER else ""
    except MalformedRecordError:
        return ""


def parse_place(fields: Fields, skip: int) -> tuple[int, int]:
    """Parse where an indexed record starts and how long it is, head included; skip bytes before."""
    fields.skip(skip)
    return fields.uint(8), fields.uint(8)
