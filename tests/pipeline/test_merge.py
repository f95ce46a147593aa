"""Merged logs: all that each holds, in the order of time, and what they share is told."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from istc_replay.errors import UsageError
from istc_replay.ingest.walk import open_log
from istc_replay.pipeline.merge import merge_logs

from ..support.copies import contents, full_log, private_log
from ..support.logs import T0_NS


@pytest.fixture
def logs(tmp_path: Path) -> list[Path]:
    """Two logs of the same topics, the second half a second later."""
    paths = [tmp_path / "car_1.mcap", tmp_path / "car_2.mcap"]
    paths[0].write_bytes(full_log(text="a"))
    paths[1].write_bytes(full_log(text="b", first_ns=T0_NS + 500_000_001))
    return paths


def test_merging_keeps_all_and_orders_by_time(logs: list[Path], foreign_reader: Any, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    copied = merge_logs(logs, out)
    parts, merged = [contents(path) for path in logs], contents(out)
    assert Counter(map(str, merged.messages)) == Counter(
        str(message) for part in parts for message in part.messages
    )
    assert merged.attachments == parts[0].attachments + parts[1].attachments
    assert merged.metadata == parts[0].metadata + parts[1].metadata
    # The first message of each log is not the first in time of it; all else is in order.
    times = [message[1] for message in merged.messages if message[0][0] == "/chatter"]
    assert times == sorted(times)
    assert len(foreign_reader(out)) == copied.messages == 124
    with out.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    statistics = summary.statistics
    assert statistics is not None
    assert statistics.message_count == sum(statistics.channel_message_counts.values()) == 124
    assert statistics.message_start_time == T0_NS
    assert statistics.message_end_time == T0_NS + 500_000_001 + 59 * 100_000_000
    assert statistics.chunk_count == open_log_chunks(out)


def open_log_chunks(path: Path) -> int:
    log = open_log(path)
    for _ in log.batches():
        pass
    assert log.problems == ()
    return log.chunk_count


def test_channels_declared_alike_become_one_and_others_stay_apart(logs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    copied = merge_logs(logs, out)
    # Two of /chatter, and one each of /tf_static, /plain and /silent.
    assert copied.channels == 5
    assert any("'/chatter' is in 2 logs: one channel" in note for note in copied.notes)
    other = tmp_path / "other.mcap"
    other.write_bytes(full_log(topic="/plain"))
    copied = merge_logs([logs[0], other], out)
    assert any("'/plain' is in 2 logs, declared differently" in note for note in copied.notes)
    assert copied.channels == 7


def test_logs_of_the_same_topics_can_be_kept_apart(logs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    copied = merge_logs(logs, out, apart=True)
    topics = Counter(message[0][0] for message in contents(out).messages)
    assert topics["/car_1/chatter"] == topics["/car_2/chatter"] == 60
    assert not any("is in 2 logs" in note for note in copied.notes)


def test_doubtful_inputs_are_told(logs: list[Path], tmp_path: Path) -> None:
    far, same, out = tmp_path / "far.mcap", tmp_path / "same.mcap", tmp_path / "out.mcap"
    far.write_bytes(full_log(first_ns=T0_NS * 2))
    same.write_bytes(logs[0].read_bytes())
    notes = merge_logs([logs[0], far], out).notes
    assert any("no time in common" in note for note in notes)
    notes = merge_logs([logs[0], same], out).notes
    assert any("same bytes" in note for note in notes)


def test_a_damaged_input_gives_what_is_intact(logs: list[Path], tmp_path: Path) -> None:
    data, out = logs[1].read_bytes(), tmp_path / "out.mcap"
    logs[1].write_bytes(data[: len(data) // 2])
    copied = merge_logs(logs, out)
    assert not copied.complete
    assert 62 < copied.messages < 124
    assert {name for name, _ in copied.problems} == {str(logs[1])}


def test_inputs_that_cannot_be_meant_are_refused(logs: list[Path]) -> None:
    before = logs[0].read_bytes()
    for sources, out, why in (
        (logs[:1], Path("out.mcap"), "two logs"),
        ([logs[0], logs[0]], Path("out.mcap"), "given twice"),
        (logs, logs[0], "is the input"),
    ):
        with pytest.raises(UsageError, match=why):
            merge_logs(sources, out)
    assert logs[0].read_bytes() == before


def test_private_records_are_left_out_and_told(logs: list[Path], tmp_path: Path) -> None:
    source = tmp_path / "private.mcap"
    source.write_bytes(private_log())
    copied = merge_logs([source, logs[0]], tmp_path / "out.mcap")
    assert (copied.messages, copied.private) == (65, 0)
    assert copied.notes[-1] == "private records (opcodes from 0x80) are not copied: 4"
