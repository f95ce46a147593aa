"""Logs with all that MCAP can hold, and what of them a copy must keep."""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from .logs import T0_NS

DEFINITION = b"string text\n"


@dataclass
class Contents:
    """Everything that a copy must keep, in comparable form."""

    messages: list[tuple[Any, ...]] = field(default_factory=list)
    channels: list[tuple[Any, ...]] = field(default_factory=list)
    attachments: list[tuple[Any, ...]] = field(default_factory=list)
    metadata: list[tuple[Any, ...]] = field(default_factory=list)


def contents(path: Path) -> Contents:
    """All of a file, read by the reference library, checksums validated."""
    found, schemas, channels = Contents(), {}, {}
    with path.open("rb") as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            kind = type(record).__name__
            if kind == "DataEnd":
                break
            if kind == "Schema":
                schemas[record.id] = (record.name, record.encoding, record.data)
            elif kind == "Channel":
                schema = schemas.get(record.schema_id)
                channels[record.id] = (record.topic, record.message_encoding, record.metadata, schema)
            elif kind == "Message":
                channel = channels[record.channel_id]
                times = (record.log_time, record.publish_time, record.sequence)
                found.messages.append((channel, *times, record.data))
            elif kind == "Attachment":
                times = (record.log_time, record.create_time)
                found.attachments.append((record.name, record.media_type, *times, record.data))
            elif kind == "Metadata":
                found.metadata.append((record.name, record.metadata))
    found.channels = list(channels.values())
    return found


def full_log(
    count: int = 60, first_ns: int = T0_NS, topic: str = "/chatter", text: str = "", **options: Any
) -> bytes:
    """A log with two channels on one topic, attachments and metadata."""
    stream = io.BytesIO()
    writer = Writer(stream, **{"compression": CompressionType.NONE, "chunk_size": 400, **options})
    writer.start(profile="ros2")
    schema = writer.register_schema("pkg/msg/Text", "ros2msg", DEFINITION)
    notes = {"offered_qos_profiles": "", "note": "é"}
    channels = [writer.register_channel(topic, "cdr", schema, notes) for _ in range(2)]
    static = writer.register_channel("/tf_static", "cdr", schema)
    plain = writer.register_channel("/plain", "json", 0)
    writer.register_channel("/silent", "json", 0)
    writer.add_message(static, first_ns, b"\0\1\0\0standing", first_ns + 5, 77)
    for k in range(count):
        time_ns = first_ns + k * 100_000_000
        writer.add_message(channels[k % 2], time_ns, f"{text}{k}".encode() * 3, time_ns - 7, 1000 - k)
    writer.add_message(plain, first_ns + 1, b"", 2**64 - 1, 2**32 - 1)
    writer.add_attachment(11, 12, "notes.txt", "text/plain", b"\0\xff" * 300)
    writer.add_attachment(0, 0, "notes.txt", "", b"")
    writer.add_metadata("run", {"driver": "ü", "car": ""})
    writer.add_metadata("run", {})
    writer.finish()
    return stream.getvalue()


def private_log() -> bytes:
    """A log with private records, one of them in a chunk, and a schema that no channel names."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE)
    writer.start(profile="ros2")
    writer.register_schema("pkg/Unused", "ros2msg", DEFINITION)
    channel = writer.register_channel("/plain", "json", 0)
    for k in range(3):
        stream.write(struct.pack("<BQ", 0x80 + k, 4) + b"own%d" % k)
        writer.add_message(channel, T0_NS + k, b"{}", T0_NS)
        writer.add_attachment(0, 0, f"{k}.txt", "text/plain", b"")
    data = struct.pack("<BQ", 0xFF, 5) + b"inner"
    stream.write(struct.pack("<BQQQQIIQ", 0x06, 40 + len(data), 0, 0, len(data), 0, 0, len(data)) + data)
    writer.finish()
    return stream.getvalue()
