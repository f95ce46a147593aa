"""Every kind of damage: the file, its intact messages, and the problems that tell it."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from dataclasses import dataclass, field

from damage_bytes import (
    MAGIC,
    MESSAGES,
    changed,
    channel,
    chunk,
    file_of,
    places,
    record,
    sample,
    schema,
    text,
    whole,
)
from damage_files import (
    BEFORE_MIDDLE,
    FOOTER,
    IN_MIDDLE,
    ITEM,
    MID,
    MIDDLE,
    ONE,
    PLAIN,
    PLAIN_CHUNK,
    PLAIN_FIELDS,
    THIRD,
    WHOLE,
    cdr_dense,
    channels,
    cut_message,
    deep_json,
    flipped,
    json_dense,
    json_of,
    long_message,
    lying_bomb,
    many_bombs,
    many_messages,
    nested,
    osi_dense,
    protobuf_varied,
    same_channel,
    statistics_off,
    summary_start,
    unknown_in_chunk,
    useless,
    zstd_bomb,
)


@dataclass(frozen=True)
class Kind:
    """One kind of damage: the file, its intact messages, and the problems that tell it."""

    name: str
    data: Callable[[], bytes]
    intact: int | None  # None: as many as the file says it has; -1: refused as no log
    codes: set[str] = field(default_factory=set)
    fields: dict[str, str] = field(default_factory=dict)  # what /x is read by


KINDS = (
    Kind("whole", lambda: WHOLE, MESSAGES),
    # Truncation.
    Kind("cut inside a chunk", lambda: WHOLE[: MID + MIDDLE[1] // 2], BEFORE_MIDDLE, {"truncated"}),
    Kind("cut between chunks", lambda: WHOLE[:MID], BEFORE_MIDDLE, {"truncated"}),
    Kind("cut in a record's head", lambda: WHOLE[: MID + 4], BEFORE_MIDDLE, {"truncated"}),
    Kind("cut in the footer", lambda: WHOLE[:-14], MESSAGES, {"truncated"}),
    Kind("cut in the last magic", lambda: WHOLE[:-3], MESSAGES, {"truncated"}),
    Kind("no chunks, cut in a message", lambda: file_of(ONE, sample(1, b"{}") * 9)[:-42], 9, {"truncated"}),
    # Bytes that are not what they were.
    Kind(
        "a flipped byte in a chunk",
        lambda: flipped(MID + MIDDLE[1] - 5),
        MESSAGES - IN_MIDDLE,
        {"statistics"},
    ),
    Kind(
        "a flipped byte in a plain chunk",
        lambda: changed(PLAIN, PLAIN_CHUNK[0] + 500, b"?"),
        None,
        {"chunk_crc"},
    ),
    Kind(
        "a flipped byte in the summary", lambda: flipped(summary_start() + 30), MESSAGES, {"summary_damaged"}
    ),
    Kind(
        "a flipped byte in an attachment",
        lambda: flipped(places(WHOLE, 0x09)[0][0] + 80),
        MESSAGES,
        {"attachment_crc"},
    ),
    Kind("zeros over a kilobyte", lambda: changed(WHOLE, MID + 100, bytes(1024)), None, {"chunk_damaged"}),
    Kind("no magic at the start", lambda: changed(WHOLE, 0, b"\0" * 8), MESSAGES, {"no_magic"}),
    # Checksums.
    Kind("wrong chunk CRC", lambda: file_of(chunk(ONE + sample(1, b"{}"), crc=1)), 0, {"chunk_crc"}),
    Kind(
        "wrong data CRC",
        lambda: file_of(ONE, sample(1, b"{}")).replace(record(0x0F, bytes(4)), record(0x0F, b"\1\2\3\4")),
        1,
        {"data_crc"},
    ),
    Kind(
        "wrong summary CRC", lambda: changed(WHOLE, FOOTER + 25, b"\1\2\3\4"), MESSAGES, {"summary_damaged"}
    ),
    # Lengths and sizes that lie.
    Kind(
        "a record of 2^60 bytes",
        lambda: changed(WHOLE, MID + 1, struct.pack("<Q", 2**60)),
        MESSAGES - IN_MIDDLE,
        {"record_damaged"},
    ),
    Kind(
        "a record that swallows the next",
        lambda: changed(WHOLE, MID + 1, struct.pack("<Q", MIDDLE[1] + 500)),
        MESSAGES,
        {"record_damaged"},
    ),
    Kind(
        "a record that swallows two chunks",
        lambda: changed(WHOLE, MID + 1, struct.pack("<Q", THIRD - MID + 50)),
        MESSAGES - IN_MIDDLE,
        {"record_damaged"},
    ),
    Kind(
        "a chunk that says it is smaller",
        lambda: file_of(chunk(ONE + sample(1, b"{}") * 9, 10, crc=0)),
        0,
        {"chunk_damaged"},
    ),
    Kind(
        "a chunk that says it is larger",
        lambda: file_of(chunk(ONE + sample(1, b"{}") * 9, 10**6, "zstd", 0)),
        0,
        {"chunk_damaged"},
    ),
    Kind("a message past its chunk's end", cut_message, 2, {"chunk_damaged"}),
    Kind("a message of 2^40 bytes", long_message, 1, {"chunk_damaged"}),
    Kind(
        "a text of 4 GiB",
        lambda: file_of(record(0x04, bytes(4) + b"\xff" * 8), ONE, sample(1, b"{}")),
        1,
        {"record_damaged"},
    ),
    # Bombs.
    Kind(
        "zstd bomb of 1 GiB", lambda: file_of(ONE, sample(1, b"{}"), zstd_bomb(2**30)), 1, {"chunk_too_long"}
    ),
    Kind(
        "zstd bomb that says it is small",
        lambda: file_of(lying_bomb("zstd"), ONE, sample(1, b"{}")),
        1,
        {"chunk_damaged"},
    ),
    Kind(
        "lz4 bomb that says it is small",
        lambda: file_of(lying_bomb("lz4"), ONE, sample(1, b"{}")),
        1,
        {"chunk_damaged"},
    ),
    Kind(
        "1000 bombs of 16 MiB", lambda: file_of(ONE, sample(1, b"{}"), many_bombs()), 1, {"inflation_limit"}
    ),
    Kind("chunks within chunks", lambda: file_of(nested(50)), 0, {"unexpected_record"}),
    Kind("OSI: 20 000 empty objects a message", lambda: osi_dense(19_000, 400), 400, {"too_many_states"}),
    Kind("OSI: two million empty objects", lambda: osi_dense(2_000_000, 8), 8, {"payload"}),
    Kind("protobuf: 8000 states, each built otherwise", lambda: protobuf_varied(8000), 8000, {"payload"}),
    Kind("CDR: 9000 items a message, 1000 sizes", lambda: cdr_dense(1000), 1000, {"payload"}, ITEM),
    Kind("JSON: 100 000 brackets deep", deep_json, 1, {"payload"}, PLAIN_FIELDS),
    Kind(
        "JSON: a number of a million digits",
        lambda: json_of(b'{"x": 1' + b"0" * 10**6 + b"}"),
        1,
        {"payload"},
        PLAIN_FIELDS,
    ),
    Kind("JSON: 20 000 items a message", json_dense, 100, {"too_many_states"}, ITEM),
    # What is not known.
    Kind(
        "unknown compression",
        lambda: changed(WHOLE, MID + 9 + 32, b"zzzz"),
        MESSAGES - IN_MIDDLE,
        {"unknown_compression"},
    ),
    Kind("unknown and private opcodes", unknown_in_chunk, 2, {"unexpected_record", "unknown_record"}),
    Kind("opcode 0", lambda: changed(WHOLE, MID, b"\0"), MESSAGES - IN_MIDDLE, {"record_damaged"}),
    Kind(
        "unknown encodings",
        lambda: file_of(schema(1, "x", "capnproto", b""), channel(1, "/x", "cbor", 1), sample(1, b"")),
        1,
        {"nothing_understood"},
    ),
    Kind(
        "a schema that is none",
        lambda: file_of(
            schema(1, "osi3.GroundTruth", "protobuf", b"\xff" * 99),
            channel(1, "/x", "protobuf", 1),
            sample(1, b""),
        ),
        1,
        {"schema"},
    ),
    # Summaries.
    Kind(
        "no summary",
        lambda: whole(
            use_statistics=False, use_summary_offsets=False, repeat_channels=False, repeat_schemas=False
        ),
        MESSAGES,
    ),
    Kind(
        "summary elsewhere",
        lambda: changed(WHOLE, FOOTER + 9, struct.pack("<Q", 20)),
        MESSAGES,
        {"summary_damaged"},
    ),
    Kind(
        "summary outside the file",
        lambda: changed(WHOLE, FOOTER + 9, struct.pack("<Q", 2**50)),
        MESSAGES,
        {"summary_damaged"},
    ),
    Kind("statistics that are off", statistics_off, MESSAGES, {"statistics"}),
    # Ids.
    Kind(
        "a channel declared twice",
        lambda: file_of(ONE, sample(1, b"{}"), channel(1, "/y", "json"), sample(1, b"{}")),
        2,
        {"channel_conflict"},
    ),
    Kind(
        "a schema declared twice",
        lambda: file_of(schema(1, "a", "x", b""), schema(1, "b", "x", b""), ONE, sample(1, b"{}")),
        1,
        {"schema_conflict"},
    ),
    Kind(
        "a message of no channel",
        lambda: file_of(ONE, sample(7, b"{}"), sample(1, b"{}")),
        2,
        {"unknown_channel"},
    ),
    Kind(
        "a channel of no schema",
        lambda: file_of(channel(1, "/x", "json", 9), sample(1, b"{}")),
        1,
        {"missing_schema"},
    ),
    Kind("100 000 channels", lambda: channels(100_000), 1, {"channel_conflict"}),
    Kind("one channel a million times", same_channel, 0, {"chunk_damaged"}),
    Kind("900 000 messages of no channel", many_messages, 900_001, {"unknown_channel"}),
    Kind("3 million records of no use", useless, 1, {"unexpected_record"}),
    Kind(
        "100 000 metadata records",
        lambda: file_of(record(0x0C, text("m") + text(b"")) * 100_000),
        0,
        {"too_many_records"},
    ),
    Kind("times of 2^64 - 1", lambda: file_of(ONE, sample(1, b"{}", 2**64 - 1)), 1),
    # Texts.
    Kind(
        "a topic that is not UTF-8",
        lambda: file_of(channel(1, b"/\xff\xfe", "json"), sample(1, b"{}")),
        1,
        {"not_utf8"},
    ),
    Kind("JSON that is not UTF-8", lambda: json_of(b'{"x_m": "\xff"}'), 1),
    # Around the file.
    Kind("two files joined", lambda: WHOLE + WHOLE, 2 * MESSAGES, {"joined_files"}),
    Kind("trailing bytes", lambda: WHOLE + b"\0" * 100, MESSAGES, {"trailing_bytes"}),
    Kind(
        "a git-lfs pointer", lambda: b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", -1
    ),
    Kind("an empty file", lambda: b"", -1),
    Kind("a ROS 1 bag", lambda: b"#ROSBAG V2.0\n" + bytes(100), -1),
    Kind("an SQLite database", lambda: b"SQLite format 3\0" + bytes(100), -1),
    Kind("a gzip of a log", lambda: gzip.compress(WHOLE), -1),
    Kind("the magic alone", lambda: MAGIC, 0, {"truncated"}),
)
