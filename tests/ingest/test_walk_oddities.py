"""The walk over records that lie, repeat or do not belong."""

from __future__ import annotations

import struct

import pytest
import zstandard

from ..support.mcap_bytes import (
    CHANNEL,
    MESSAGE,
    T0_NS,
    chunk,
    codes,
    file_of,
    make,
    record,
    text,
    top_level,
    walk,
)


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


def test_in_a_chunk_too_a_channel_holds_for_the_messages_behind_it() -> None:
    content = CHANNEL + MESSAGE + MESSAGE + CHANNEL.replace(b"/x", b"/y") + MESSAGE
    log, messages = walk(file_of(chunk(content, len(content), "")))
    assert [message[0] for message in messages] == ["/x", "/x", "/y"]
    assert codes(log) == {"channel_conflict"}


@pytest.mark.parametrize("head", [b"\0" + bytes(8), b"\0" + struct.pack("<Q", 3) + b"abc"])
def test_a_record_of_no_kind_ends_its_chunk_after_what_is_whole(head: bytes) -> None:
    content = CHANNEL + MESSAGE + head + MESSAGE
    log, messages = walk(file_of(chunk(content, len(content), "")))
    assert len(messages) == 1
    assert codes(log) == {"chunk_damaged"}
    assert not log.complete


@pytest.mark.parametrize("within_chunk", [False, True])
def test_a_message_too_short_for_its_head_is_left_out_and_the_others_are_given(within_chunk: bool) -> None:
    content = CHANNEL + MESSAGE + record(0x05, bytes(21)) + MESSAGE + record(0x05, b"") + MESSAGE
    log, messages = walk(file_of(chunk(content, len(content), "") if within_chunk else content))
    assert len(messages) == log.message_count == 3
    assert codes(log) == {"record_damaged"}
    assert not log.complete


def test_a_time_that_fits_no_clock_is_given_and_does_not_stretch_the_log() -> None:
    far = record(0x05, struct.pack("<HIQQ", 1, 8, 2**64 - 1, 2**64 - 1) + b"{}")
    log, messages = walk(file_of(CHANNEL, MESSAGE, far))
    assert [message[1] for message in messages] == [T0_NS, 2**64 - 1]
    assert (log.start_ns, log.end_ns) == (T0_NS, T0_NS)
    alone, _ = walk(file_of(CHANNEL, far))
    assert (alone.start_ns, alone.end_ns, alone.message_count) == (None, None, 1)


def test_missing_schemas_and_bad_text_are_told() -> None:
    channel = record(0x04, struct.pack("<HHI", 1, 5, 3) + b"/\xff\xff" + text("json") + bytes(4))
    log, messages = walk(file_of(channel, MESSAGE))
    assert messages[0][0] == "/��"
    assert codes(log) == {"missing_schema", "not_utf8"}


def test_one_damaged_magic_does_not_hide_the_log() -> None:
    data = make("")
    expected = walk(data)[1]
    for damaged in (b"?" + data[1:], data[:-1] + b"?"):
        log, messages = walk(damaged)
        assert messages == expected
        assert "no_magic" in codes(log)


def test_statistics_that_state_more_than_is_there_tell_of_a_loss() -> None:
    data = bytearray(make("no"))
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
