"""The walk through damage: what is intact is given, and what is not is told."""

from __future__ import annotations

import io
import os
import struct
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.records import Message as LibraryMessage
from mcap.stream_reader import StreamReader

from istc_replay.errors import LogError
from istc_replay.ingest.records import MAGIC
from istc_replay.ingest.walk import open_log

from ..support.mcap_bytes import LIBRARY, codes, make, record, top_level, walk

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
    paths = sorted((shared_logs / "bad").glob("*.mcap"))
    assert {path.name for path in paths} >= NOT_MCAP | BAD.keys()
    for path in paths:
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


def library_messages(data: bytes) -> list[tuple[int, bytes]]:
    reader = StreamReader(io.BytesIO(data))
    return [(r.log_time, r.data) for r in reader.records if isinstance(r, LibraryMessage)]


@pytest.mark.parametrize("kind", LIBRARY)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_a_file_cut_anywhere_gives_exactly_the_messages_of_its_whole_records(share: float, kind: str) -> None:
    data = make(kind)
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
    share: float, flip: int, kind: str
) -> None:
    data = bytearray(make(kind, enable_data_crcs=kind == "no"))
    original = walk(bytes(data))[1]
    data[int(share * len(data))] ^= flip
    log, messages = walk(bytes(data))
    assert messages == original or not log.complete


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(noise=st.binary(max_size=400))
def test_noise_after_the_magic_never_raises(noise: bytes) -> None:
    log, _ = walk(MAGIC + noise)
    assert not log.complete


def test_a_damaged_chunk_takes_only_its_own_messages_and_the_summary_lends_the_channels() -> None:
    data = bytearray(make(""))
    first_chunk_end = next(end for opcode, end in top_level(bytes(data)) if opcode == 0x06)
    data[first_chunk_end - 1] ^= 0xFF
    original = walk(make(""))[1]
    log, messages = walk(bytes(data))
    # The channels were declared in that chunk alone.
    assert messages == original[len(original) - len(messages) :]
    assert 0 < len(messages) < len(original)
    assert {problem.code: problem.offset for problem in log.problems}["chunk_crc"] is not None


def test_a_lying_length_is_left_at_the_next_chunk_that_the_summary_knows() -> None:
    data = bytearray(make("zstd"))
    original = walk(bytes(data))[1]
    ends = [end for opcode, end in top_level(bytes(data)) if opcode == 0x07]
    for lie in (2**62, 3000, 5):
        struct.pack_into("<Q", data, ends[0] + 1, lie)  # the record after the first message index
        log, messages = walk(bytes(data))
        assert len(messages) > len(original) / 2
        assert not Counter(messages) - Counter(original)
        assert "record_damaged" in codes(log)
