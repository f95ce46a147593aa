"""MCAP files written byte by byte, and what a walk finds in them."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType

from istc_replay.ingest.records import MAGIC
from istc_replay.ingest.walk import LogFile, open_log

from .logs import T0_NS, Topic, write_log

Payload = tuple[str, int, int, int, bytes]


def walk(source: bytes | Path) -> tuple[LogFile, list[Payload]]:
    log = open_log(source)
    return log, [
        (m.channel.topic, m.log_time_ns, m.publish_time_ns, m.sequence, m.data) for m in log.messages()
    ]


def codes(log: LogFile) -> set[str]:
    return {problem.code for problem in log.problems}


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def chunk(content: bytes, size: int, compression: str, crc: int = 0) -> bytes:
    head = struct.pack("<QQQI", 0, 0, size, crc) + text(compression) + struct.pack("<Q", len(content))
    return record(0x06, head + content)


def file_of(*parts: bytes) -> bytes:
    footer = record(0x02, struct.pack("<QQI", 0, 0, 0))
    return (
        MAGIC + record(0x01, text("") + text("")) + b"".join(parts) + record(0x0F, bytes(4)) + footer + MAGIC
    )


CHANNEL = record(0x04, struct.pack("<HH", 1, 0) + text("/x") + text("json") + struct.pack("<I", 0))
MESSAGE = record(0x05, struct.pack("<HIQQ", 1, 7, T0_NS, T0_NS) + b"{}")


LIBRARY = {
    "": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
    "no": CompressionType.NONE,
}


def make(kind: str, **options: Any) -> bytes:
    """A log of two topics and 24 messages, in chunks of about four, or without chunks."""
    topics = [
        Topic(
            name,
            [(T0_NS + 10 * k + offset, bytes([k]) * 20) for k in range(12)],
            "s",
            "none",
            b"schema",
            "bytes",
        )
        for offset, name in enumerate(("/a", "/b"))
    ]
    return write_log(*topics, compression=LIBRARY[kind], chunk_size=200, use_chunking=kind != "no", **options)


def top_level(data: bytes) -> list[tuple[int, int]]:
    """Opcode and end of every record of a sound file."""
    records, position = [], len(MAGIC)
    while position < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, position)
        position += 9 + length
        records.append((opcode, position))
    return records
