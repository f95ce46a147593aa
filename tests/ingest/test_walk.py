"""The walk against the format's own suite, against the reference library, and against damage."""

from __future__ import annotations

import io
import json
import os
import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.records import Message as LibraryMessage
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType

from istc_replay.errors import LogError
from istc_replay.ingest.records import MAGIC
from istc_replay.ingest.walk import LogFile, open_log

T0_NS = 1_700_000_000_000_000_000
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

# --- the format's own suite --------------------------------------------------------------------

GROUPS = ["NoData", "OneAttachment", "OneMessage", "OneMetadata", "OneSchemalessMessage", "TenMessages"]


@pytest.mark.parametrize("group", GROUPS)
def test_every_conformance_file_is_read_exactly(shared_logs: Path, group: str) -> None:
    files = sorted((shared_logs / "conformance" / group).glob("*.json"))
    assert files
    for expected_file in files:
        expected: dict[str, list[dict[str, Any]]] = {"Message": [], "Attachment": [], "Metadata": []}
        for entry in json.loads(expected_file.read_text())["records"]:
            if entry["type"] == "DataEnd":
                break
            expected.setdefault(entry["type"], []).append(dict(entry["fields"]))
        log = open_log(expected_file.with_suffix(".mcap"))
        found = [(m.channel.id, m.sequence, m.log_time_ns, m.publish_time_ns, m.data) for m in log.messages()]
        assert found == [
            (
                *(int(m[key]) for key in ("channel_id", "sequence", "log_time", "publish_time")),
                bytes(map(int, m["data"])),
            )
            for m in expected["Message"]
        ], expected_file.name
        assert [(a.name, a.media_type, log.attachment_data(a)) for a in log.attachments] == [
            (a["name"], a["media_type"], bytes(map(int, a["data"]))) for a in expected["Attachment"]
        ]
        assert [(m.name, m.metadata) for m in log.metadata] == [
            (m["name"], m["metadata"]) for m in expected["Metadata"]
        ]
        assert log.complete
        assert log.problems == ()


# --- damage --------------------------------------------------------------------------------------

NOT_MCAP = {"01_zero_bytes.mcap", "03_text.mcap"}
#: What each bad file still holds, and how it is told.
BAD = {
    "00_good.mcap": (400, True, set()),
    "05_trunc_half.mcap": (238, False, {"truncated"}),
    "07_trunc_footer.mcap": (400, False, {"truncated"}),
    "09_unchunked_trunc.mcap": (84, False, {"truncated"}),
    "11_bad_chunk_crc_none.mcap": (373, False, {"chunk_crc", "statistics"}),
    "13_unknown_compression.mcap": (0, False, {"unknown_compression"}),
    "15_unindexed.mcap": (400, True, set()),
    "17_nonmonotonic.mcap": (400, True, set()),
    "19_time_max.mcap": (6, True, set()),
    "21_dup_channel_id.mcap": (9, True, {"channel_conflict"}),
    "23_msg_unknown_channel.mcap": (0, False, {"unknown_channel"}),
    "25_schemaless_json.mcap": (9, True, set()),
    "31_record_len_3GiB.mcap": (0, False, {"truncated"}),
    "33_zstd_bomb_1GiB.mcap": (0, False, {"chunk_too_long"}),
    "35_lz4_bomb_1GiB_lie_small.mcap": (0, False, {"chunk_damaged"}),
    "41_trailing_garbage.mcap": (400, True, {"trailing_bytes"}),
    "43_summary_start_wrong.mcap": (400, True, {"summary_damaged"}),
    "45_zstd_no_content_size.mcap": (9, True, set()),
    "47_dataend_then_nothing.mcap": (9, False, {"truncated"}),
    "49_1e5_channels.mcap": (0, True, set()),
}


def test_every_bad_file_gives_what_is_intact_and_says_what_is_not(shared_logs: Path) -> None:
    for path in sorted((shared_logs / "bad").glob("*.mcap")):
        if path.name in NOT_MCAP:
            with pytest.raises(LogError, match="not an MCAP log"):
                open_log(path)
            continue
        log, messages = walk(path)
        if path.name in BAD:
            assert (len(messages), log.complete, codes(log)) == BAD[path.name], path.name


@pytest.mark.parametrize(
    ("head", "told"),
    [
        (b"version https://git-lfs.github.com/spec/v1", "git lfs pull"),
        (b"#ROSBAG V2.0\n", "mcap convert"),
        (b"SQLite format 3\0", "ros2 bag convert"),
        (b"\x1f\x8b\x08", "gunzip"),
        (b"PAR1", "istc-replay convert"),
        (b"<?xml version", "istc-replay convert"),
        (b"RRF2", "rerun"),
    ],
)
def test_other_formats_are_named_with_what_to_do(head: bytes, told: str) -> None:
    with pytest.raises(LogError, match=told):
        open_log(head + bytes(100))


def test_nothing_to_read_is_told_in_one_line(tmp_path: Path) -> None:
    fifo = tmp_path / "pipe.mcap"
    os.mkfifo(fifo)
    folder = tmp_path / "folder.mcap"
    folder.mkdir()
    for path, reason in [
        (tmp_path / "none.mcap", "no such file"),
        (folder, "not a regular file"),
        (fifo, "not a regular file"),
        (tmp_path / ("n" * 300), "cannot be read"),
    ]:
        with pytest.raises(LogError, match=reason) as error:
            open_log(path)
        assert "\n" not in str(error.value)


LIBRARY = {
    "": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
    "no": CompressionType.NONE,
}


def make(kind: str, write_log: Callable[..., bytes], topic: Any, **options: Any) -> bytes:
    """A log of two topics and 24 messages, in chunks of about four, or without chunks."""
    topics = [
        topic(
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


def library_messages(data: bytes) -> list[tuple[int, bytes]]:
    reader = StreamReader(io.BytesIO(data))
    return [(r.log_time, r.data) for r in reader.records if isinstance(r, LibraryMessage)]


@pytest.mark.parametrize("kind", LIBRARY)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_a_file_cut_anywhere_gives_exactly_the_messages_of_its_whole_records(
    share: float, kind: str, write_log: Callable[..., bytes], topic: Any
) -> None:
    data = make(kind, write_log, topic)
    cut = len(MAGIC) + int(share * (len(data) - len(MAGIC)))
    # What the reference library reads from the whole records alone, closed by a data end.
    end = max(
        [len(MAGIC)] + [end for opcode, end in top_level(data) if opcode not in (0x0F, 0x02) and end <= cut]
    )
    end = min([end] + [end - 13 for opcode, end in top_level(data) if opcode == 0x0F])
    whole = data[:end] + record(0x0F, bytes(4)) + record(0x02, bytes(20)) + MAGIC
    log, messages = walk(data[:cut])
    assert [(time, payload) for _, time, _, _, payload in messages] == library_messages(whole)
    assert not log.complete
    assert "truncated" in codes(log)


@pytest.mark.parametrize("kind", LIBRARY)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 1.0, exclude_max=True), flip=st.integers(1, 255))
def test_a_flipped_byte_never_raises_and_never_changes_the_messages_in_silence(
    share: float, flip: int, kind: str, write_log: Callable[..., bytes], topic: Any
) -> None:
    data = bytearray(make(kind, write_log, topic, enable_data_crcs=kind == "no"))
    original = walk(bytes(data))[1]
    data[int(share * len(data))] ^= flip
    log, messages = walk(bytes(data))
    assert messages == original or not log.complete


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(noise=st.binary(max_size=400))
def test_noise_after_the_magic_never_raises(noise: bytes) -> None:
    log, _ = walk(MAGIC + noise)
    assert not log.complete


def test_a_damaged_chunk_takes_only_its_own_messages_and_the_summary_lends_the_channels(
    write_log: Callable[..., bytes], topic: Any
) -> None:
    data = bytearray(make("", write_log, topic))
    first_chunk_end = next(end for opcode, end in top_level(bytes(data)) if opcode == 0x06)
    data[first_chunk_end - 1] ^= 0xFF
    original = walk(make("", write_log, topic))[1]
    log, messages = walk(bytes(data))
    # The channels were declared in that chunk alone.
    assert messages == original[len(original) - len(messages) :]
    assert 0 < len(messages) < len(original)
    assert {problem.code: problem.offset for problem in log.problems}["chunk_crc"] is not None


def test_a_lying_length_is_left_at_the_next_chunk_that_the_summary_knows(
    write_log: Callable[..., bytes], topic: Any
) -> None:
    data = bytearray(make("zstd", write_log, topic))
    original = walk(bytes(data))[1]
    ends = [end for opcode, end in top_level(bytes(data)) if opcode == 0x07]
    for lie in (2**62, 3000, 5):
        struct.pack_into("<Q", data, ends[0] + 1, lie)  # the record after the first message index
        log, messages = walk(bytes(data))
        assert len(messages) > len(original) / 2
        assert not Counter(messages) - Counter(original)
        assert "record_damaged" in codes(log)


def test_joined_files_are_read_one_after_the_other(write_log: Callable[..., bytes], topic: Any) -> None:
    data = make("lz4", write_log, topic)
    log, messages = walk(data + data)
    assert messages == walk(data)[1] * 2
    assert "joined_files" in codes(log)
    assert "statistics" not in codes(log)


def test_a_repeated_walk_gives_the_same(write_log: Callable[..., bytes], topic: Any) -> None:
    log = open_log(make("zstd", write_log, topic)[:-30])
    first, problems = list(log.messages()), log.problems
    assert [m[1:] for m in log.messages()] == [m[1:] for m in first]
    assert log.problems == problems


def test_only_wanted_channels_are_given_but_all_are_counted(
    write_log: Callable[..., bytes], topic: Any
) -> None:
    log = open_log(make("zstd", write_log, topic))
    given_topics = {m.channel.topic for m in log.messages(lambda channel: channel.topic == "/b")}
    assert given_topics == {"/b"}
    assert {channel.topic: count for channel, count in log.counts.items()} == {"/a": 12, "/b": 12}
    assert (log.message_count, log.start_ns, log.end_ns) == (24, T0_NS, T0_NS + 111)


def test_attachments_and_metadata_are_read_and_checked(write_log: Callable[..., bytes], topic: Any) -> None:
    data = make(
        "", write_log, topic, attachments=[("config.toml", b"unit_s = 1")], metadata=[("who", {"a": "b"})]
    )
    log, _ = walk(data)
    assert [(a.name, log.attachment_data(a)) for a in log.attachments] == [("config.toml", b"unit_s = 1")]
    assert [(m.name, m.metadata) for m in log.metadata] == [("who", {"a": "b"})]
    log, _ = walk(data.replace(b"unit_s = 1", b"unit_s = 9"))
    assert log.attachments == []
    assert "attachment_crc" in codes(log)
    assert not log.complete


# --- lies and oddities ----------------------------------------------------------------------------


def test_records_that_run_past_their_chunk_end_it_after_what_is_whole() -> None:
    content = CHANNEL + MESSAGE + struct.pack("<BQ", 5, 10**6) + b"short"
    log, messages = walk(file_of(chunk(content, len(content), "")))
    assert len(messages) == 1
    assert codes(log) == {"chunk_damaged"}


def test_private_and_unknown_records_are_passed_over() -> None:
    log, messages = walk(file_of(CHANNEL, record(0x90, b"private"), record(0x40, b"of the future"), MESSAGE))
    assert len(messages) == 1
    assert codes(log) == {"unknown_record"}
    assert log.complete


def test_a_channel_declared_twice_holds_from_where_it_stands() -> None:
    other = CHANNEL.replace(b"/x", b"/y")
    log, messages = walk(file_of(CHANNEL, MESSAGE, CHANNEL, MESSAGE, other, MESSAGE))
    assert [message[0] for message in messages] == ["/x", "/x", "/y"]
    assert codes(log) == {"channel_conflict"}
    assert {channel.topic: count for channel, count in log.counts.items()} == {"/x": 2, "/y": 1}


def test_missing_schemas_and_bad_text_are_told() -> None:
    channel = record(0x04, struct.pack("<HHI", 1, 5, 3) + b"/\xff\xff" + text("json") + bytes(4))
    log, messages = walk(file_of(channel, MESSAGE))
    assert messages[0][0] == "/��"
    assert codes(log) == {"missing_schema", "not_utf8"}


def test_one_damaged_magic_does_not_hide_the_log(write_log: Callable[..., bytes], topic: Any) -> None:
    data = make("", write_log, topic)
    expected = walk(data)[1]
    for damaged in (b"?" + data[1:], data[:-1] + b"?"):
        log, messages = walk(damaged)
        assert messages == expected
        assert "no_magic" in codes(log)


def test_statistics_that_state_more_than_is_there_tell_of_a_loss(
    write_log: Callable[..., bytes], topic: Any
) -> None:
    data = bytearray(make("no", write_log, topic))
    records = top_level(bytes(data))
    first = next(index for index, (opcode, _) in enumerate(records) if opcode == 0x05)
    data[records[first - 1][1]] = 0x90  # the first message becomes a private record
    log, messages = walk(bytes(data))
    assert len(messages) == 23
    assert codes(log) == {"statistics"}
    assert not log.complete


def test_a_million_faults_make_a_few_lines() -> None:
    unknown = MESSAGE.replace(struct.pack("<H", 1), struct.pack("<H", 9), 1)
    log, _ = walk(file_of(unknown * 20_000))
    assert len(log.problems) < 10
    assert log.problems[-1].detail.startswith("199")


def many_declarations(count: int, ids: int) -> bytes:
    """A file of one chunk that declares channels, their ids used again and again, before its message."""
    declared = b"".join(
        record(0x04, struct.pack("<HH", 1 + k % ids, 0) + text(f"/{k}") + text("json") + bytes(4))
        for k in range(count)
    )
    content = declared + MESSAGE
    return file_of(chunk(zstandard.compress(content), len(content), "zstd"))


def test_more_declarations_than_a_small_file_may_hold_are_told() -> None:
    log, messages = walk(many_declarations(120_000, 60_000))
    assert codes(log) >= {"too_many_definitions", "channel_conflict"}
    assert len(messages) == 1
    assert not log.complete


def test_messages_of_a_declaration_that_is_not_held_are_not_given_to_the_one_before() -> None:
    log, messages = walk(many_declarations(90_001, 30_000))
    assert codes(log) >= {"too_many_definitions", "unknown_channel"}
    assert messages == []


def test_the_profile_and_the_spans_of_channels_are_told(write_log: Callable[..., bytes], topic: Any) -> None:
    made = [topic("/a", [(T0_NS + 5, b""), (T0_NS, b"")]), topic("/b", [(T0_NS + 9, b"")]), topic("/c", [])]
    log, _ = walk(write_log(*made))
    spans = {channel.topic: span for channel, span in log.spans.items()}
    assert spans == {"/a": (T0_NS, T0_NS + 5), "/b": (T0_NS + 9, T0_NS + 9)}
    assert log.profile == ""
    assert {channel.topic for channel in log.counts} == {"/a", "/b", "/c"}
    assert log.position == log.size - len(MAGIC)
