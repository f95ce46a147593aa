"""Records of MCAP by hand, a whole log, and changes of its bytes."""

from __future__ import annotations

import io
import struct
import zlib

import lz4.frame
import zstandard
from mcap.writer import CompressionType, Writer

from istc_replay.messages import descriptor_set, message

T0_NS = 1_700_000_000_000_000_000
MAGIC = b"\x89MCAP0\r\n"
MESSAGES, VEHICLES = 2000, 4


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str | bytes) -> bytes:
    raw = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(raw)) + raw


def schema(id_: int, name: str, encoding: str, data: bytes) -> bytes:
    return record(0x03, struct.pack("<H", id_) + text(name) + text(encoding) + text(data))


def channel(id_: int, topic: str | bytes, encoding: str, schema_id: int = 0) -> bytes:
    return record(0x04, struct.pack("<HH", id_, schema_id) + text(topic) + text(encoding) + text(b""))


def sample(channel_id: int, data: bytes, time_ns: int = T0_NS) -> bytes:
    return record(0x05, struct.pack("<HIQQ", channel_id, 0, time_ns, time_ns) + data)


def chunk(content: bytes, size: int | None = None, compression: str = "", crc: int | None = None) -> bytes:
    packed = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}.get(compression, bytes)(content)
    crc = zlib.crc32(content) if crc is None else crc
    head = struct.pack("<QQQI", T0_NS, T0_NS, len(content) if size is None else size, crc)
    return record(0x06, head + text(compression) + struct.pack("<Q", len(packed)) + packed)


def file_of(*parts: bytes) -> bytes:
    tail = record(0x0F, bytes(4)) + record(0x02, bytes(20)) + MAGIC
    return MAGIC + record(0x01, text("") + text("damage")) + b"".join(parts) + tail


def whole(compression: CompressionType = CompressionType.ZSTD, **options: object) -> bytes:
    """A log of four vehicles, 2000 messages, an attachment and a metadata record."""
    stream = io.BytesIO()
    writer = Writer(stream, **{"compression": compression, "chunk_size": 8192, **options})  # type: ignore[arg-type]
    writer.start()
    schema_id = writer.register_schema("istc.v1.VehicleState", "protobuf", descriptor_set())
    channels = [writer.register_channel(f"/car_{v}", "protobuf", schema_id) for v in range(VEHICLES)]
    kind = message("VehicleState")
    for index in range(MESSAGES):
        k, vehicle = divmod(index, VEHICLES)
        time_ns = T0_NS + k * 100_000_000
        state = kind(time_ns=time_ns, vehicle_id=str(vehicle), x_m=0.5 * k, y_m=4.0 * vehicle)
        state.heading_rad, state.speed_mps = 0.0, 5.0
        writer.add_message(channels[vehicle], time_ns, state.SerializeToString(), time_ns, k)
    writer.add_attachment(0, 0, "notes.txt", "text/plain", b"notes" * 100)
    writer.add_metadata("run", {"car": "1"})
    writer.finish()
    return stream.getvalue()


def places(data: bytes, opcode: int) -> list[tuple[int, int]]:
    """Where the records of a kind begin in a whole file, and how long they are."""
    found, position = [], len(MAGIC)
    while position < len(data) - len(MAGIC):
        kind, length = struct.unpack_from("<BQ", data, position)
        if kind == opcode:
            found.append((position, 9 + length))
        position += 9 + length
    return found


def in_chunk(data: bytes, place: int) -> int:
    """Messages of the chunk that begins at a place."""
    size = struct.unpack_from("<Q", data, place + 9 + 16)[0]
    name = struct.unpack_from("<I", data, place + 9 + 28)[0]
    start = place + 9 + 32 + name + 8
    end = place + 9 + struct.unpack_from("<Q", data, place + 1)[0]
    content = zstandard.decompress(data[start:end], max_output_size=size)
    return sum(1 for _ in messages_in(content))


def messages_in(content: bytes) -> list[int]:
    found, position = [], 0
    while position < len(content):
        opcode, length = struct.unpack_from("<BQ", content, position)
        if opcode == 0x05:
            found.append(position)
        position += 9 + length
    return found


def changed(data: bytes, place: int, new: bytes) -> bytes:
    return data[:place] + new + data[place + len(new) :]
