"""Files of one kind of damage each, made from the whole log or of records by hand."""

from __future__ import annotations

import struct

import zstandard
from damage_bytes import (
    MAGIC,
    MESSAGES,
    changed,
    channel,
    chunk,
    file_of,
    in_chunk,
    places,
    record,
    sample,
    schema,
    text,
    whole,
)
from mcap.writer import CompressionType

from istc_replay.messages import descriptor_set

WHOLE = whole()
CHUNKS = places(WHOLE, 0x06)
MIDDLE = CHUNKS[len(CHUNKS) // 2]
IN_MIDDLE = in_chunk(WHOLE, MIDDLE[0])
#: Where the chunk after the next one begins.
THIRD = CHUNKS[len(CHUNKS) // 2 + 2][0]
BEFORE_MIDDLE = sum(in_chunk(WHOLE, place) for place, _ in CHUNKS if place < MIDDLE[0])
FOOTER = len(WHOLE) - len(MAGIC) - 29
PLAIN = whole(CompressionType.NONE)
ONE = channel(1, "/x", "json")


def summary_start() -> int:
    return int(struct.unpack_from("<Q", WHOLE, FOOTER + 9)[0])


def statistics_off() -> bytes:
    """A summary that states one message more, and no checksum that would tell."""
    place = places(WHOLE, 0x0B)[0][0]
    data = changed(WHOLE, place + 9, struct.pack("<Q", MESSAGES + 1))
    return changed(data, FOOTER + 25, bytes(4))


def zstd_bomb(size: int) -> bytes:
    packer = zstandard.ZstdCompressor(level=3).compressobj(size=size)
    piece = bytes(2**24)
    packed = b"".join(packer.compress(piece) for _ in range(size // len(piece))) + packer.flush()
    head = struct.pack("<QQQI", 0, 0, size, 0) + text("zstd") + struct.pack("<Q", len(packed))
    return record(0x06, head + packed)


def lying_bomb(compression: str) -> bytes:
    """A chunk that says that it is small and inflates to 64 MiB."""
    return chunk(bytes(2**26), 1000, compression, 0)


def many_bombs() -> bytes:
    """A thousand chunks of 16 MiB each, all within the limit of one."""
    return chunk(bytes(2**24), compression="zstd") * 1000


def nested(levels: int) -> bytes:
    inner = sample(1, b"{}")
    for _ in range(levels):
        inner = chunk(inner, compression="zstd")
    return inner


def osi_dense(items: int, messages: int) -> bytes:
    """OSI messages of many empty objects: two bytes of the file are a state."""
    from google.protobuf import descriptor_pb2

    from istc_replay.export import sample_osi

    files = descriptor_pb2.FileDescriptorSet(file=[sample_osi._file()]).SerializeToString()
    kind = sample_osi._ground_truth_class()
    truth = kind()
    truth.moving_object.add().id.value = 1
    whole_ = truth.SerializeToString()
    tag = whole_[:1]
    payload = tag + struct.pack("B", len(whole_) - 2) + whole_[2:]
    data = payload + (tag + b"\0") * items
    head = schema(1, "osi3.GroundTruth", "protobuf", files) + channel(1, "/osi", "protobuf", 1)
    return file_of(chunk(head + sample(1, data) * messages, compression="zstd"))


def cdr_dense(messages: int) -> bytes:
    """ROS messages of different sizes, each of many tiny items: a layout each."""
    definition = b"Item[] items\n" + b"=" * 80 + b"\nMSG: pkg/Item\nuint8 id\n"
    head = schema(1, "pkg/msg/Items", "ros2msg", definition) + channel(1, "/x", "cdr", 1)
    body = b"".join(
        sample(1, b"\0\1\0\0" + struct.pack("<I", 9_000 + k) + bytes(9_000 + k)) for k in range(messages)
    )
    return file_of(chunk(head + body, compression="zstd"))


def protobuf_varied(messages: int) -> bytes:
    """States that are each built otherwise: no layout fits a second one."""
    head = schema(1, "istc.v1.VehicleState", "protobuf", descriptor_set()) + channel(1, "/x", "protobuf", 1)
    pieces = []
    for k in range(messages):
        unknown = b"".join(struct.pack("<BBBB", 0xF8, 0x01 + (k >> n & 1), 0x01, k & 1) for n in range(16))
        pieces.append(sample(1, b"\x12\x01a" + unknown * 20))
    return file_of(chunk(head + b"".join(pieces), compression="zstd"))


def json_of(payload: bytes, count: int = 1) -> bytes:
    return file_of(chunk(ONE + sample(1, payload) * count, compression="zstd"))


def channels(count: int) -> bytes:
    """So many channels, of 60 000 ids: ids have 16 bits."""
    body = b"".join(channel(1 + k % 60_000, f"/topic_{k}", "json") for k in range(count))
    return file_of(chunk(body + sample(1, b"{}"), compression="zstd"))


def many_messages() -> bytes:
    """As many messages as a chunk may hold, of a channel that nobody declares."""
    return file_of(chunk(sample(7, b"") * 900_000 + ONE + sample(1, b"{}"), compression="zstd"))


def flipped(place: int) -> bytes:
    return changed(WHOLE, place, bytes([WHOLE[place] ^ 0x40]))


def unknown_in_chunk() -> bytes:
    content = ONE + sample(1, b"{}") + record(0x7F, b"?") + sample(1, b"{}")
    return file_of(chunk(content), record(0x70, b"?"), record(0x81, b"private"))


def cut_message() -> bytes:
    content = ONE + sample(1, b"{}") * 3
    return file_of(chunk(content[:-4]))


def long_message() -> bytes:
    content = ONE + sample(1, b"{}") + changed(sample(1, b"{}"), 1, struct.pack("<Q", 2**40))
    return file_of(chunk(content))


MID = MIDDLE[0]
PLAIN_CHUNK = places(PLAIN, 0x06)[3]
ITEM = {"items": "items", "vehicle_id": "id"}
PLAIN_FIELDS = {"x_m": "x"}


def deep_json() -> bytes:
    return json_of(b'{"x":' * 100_000 + b"1" + b"}" * 100_000)


def same_channel() -> bytes:
    return file_of(chunk(ONE * 1_000_000 + sample(1, b"{}"), compression="zstd"))


def useless() -> bytes:
    return file_of(ONE, sample(1, b"{}"), chunk(record(0x7F, b"") * 3_000_000, compression="zstd"))


def json_dense() -> bytes:
    return json_of(b'{"items":[' + b'{"id":1},' * 19_999 + b"{}]}", 100)
