"""Recovered logs: everything intact, byte for byte, and whole for readers that are not ours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType

from istc_replay.errors import LogError, UsageError
from istc_replay.ingest.walk import open_log
from istc_replay.pipeline.recover import recover_log

from ..support.copies import contents, full_log, private_log


@pytest.mark.parametrize("options", [{}, {"compression": CompressionType.ZSTD}, {"use_chunking": False}])
def test_a_whole_log_is_copied_without_losing_a_byte(options: dict[str, Any], tmp_path: Path) -> None:
    source, out = tmp_path / "in.mcap", tmp_path / "out.mcap"
    source.write_bytes(full_log(**options))
    copied = recover_log(source, out)
    before, after = contents(source), contents(out)
    assert after.messages == before.messages
    assert sorted(map(str, after.channels)) == sorted(map(str, before.channels))
    assert after.attachments == before.attachments
    assert after.metadata == before.metadata
    assert copied.complete
    assert open_log(out).profile == "ros2"


def test_the_statistics_and_indexes_say_what_is_there(tmp_path: Path) -> None:
    source, out = tmp_path / "in.mcap", tmp_path / "out.mcap"
    source.write_bytes(full_log(use_statistics=False, repeat_channels=False))
    recover_log(source, out)
    with out.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 62
        assert sorted(summary.statistics.channel_message_counts.values()) == [1, 1, 30, 30]
        assert (summary.statistics.attachment_count, summary.statistics.metadata_count) == (2, 2)
        assert len(list(reader.iter_attachments())) == 2
        assert len(list(reader.iter_metadata())) == 2


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_a_cut_log_becomes_whole_for_every_reader(
    share: float, foreign_reader: Callable[[Path], list[Any]], tmp_path: Path
) -> None:
    data = full_log(compression=CompressionType.ZSTD, chunk_size=300)
    source, out = tmp_path / "in.mcap", tmp_path / "out.mcap"
    source.write_bytes(data[: int(share * len(data))])
    copied = recover_log(source, out)
    log = open_log(source)
    intact = [(m.channel.topic, m.log_time_ns, m.data) for m in log.messages()]
    assert len(intact) == copied.messages > 10
    assert sorted(foreign_reader(out)) == sorted(intact)
    assert [problem.code for _, problem in copied.problems] == ["truncated"]
    assert not copied.complete


def test_a_damaged_chunk_is_left_out_and_told(foreign_reader: Any, tmp_path: Path) -> None:
    data = bytearray(full_log())
    data[len(data) // 4] ^= 0x40
    source, out = tmp_path / "in.mcap", tmp_path / "out.mcap"
    source.write_bytes(data)
    copied = recover_log(source, out)
    assert 40 < copied.messages < 62
    assert copied.problems
    assert len(foreign_reader(out)) == copied.messages
    assert open_log(out).complete


def test_every_conformance_file_is_copied_whole(shared_logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    files = sorted((shared_logs / "conformance").rglob("*.mcap"))
    assert len(files) == 416
    for path in files:
        recover_log(path, out)
        before, after = contents(path), contents(out)
        assert after.messages == before.messages, path.name
        assert (after.attachments, after.metadata) == (before.attachments, before.metadata), path.name


def test_nothing_is_written_where_nothing_is_intact(tmp_path: Path) -> None:
    source, out = tmp_path / "in.mcap", tmp_path / "out.mcap"
    source.write_bytes(full_log()[:60])
    with pytest.raises(LogError, match="nothing in it is intact"):
        recover_log(source, out)
    source.write_bytes(b"no log")
    with pytest.raises(LogError, match="not an MCAP log"):
        recover_log(source, out)
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]


def test_the_input_is_never_the_output(tmp_path: Path) -> None:
    source, link = tmp_path / "in.mcap", tmp_path / "link.mcap"
    source.write_bytes(full_log())
    link.symlink_to(source)
    before = source.read_bytes()
    with pytest.raises(UsageError, match="is the input"):
        recover_log(source, link)
    assert source.read_bytes() == before


def test_the_same_log_gives_the_same_bytes(tmp_path: Path) -> None:
    source = tmp_path / "in.mcap"
    source.write_bytes(full_log())
    first, second = tmp_path / "a.mcap", tmp_path / "b.mcap"
    recover_log(source, first)
    recover_log(source, second)
    assert first.read_bytes() == second.read_bytes()


def private_records(path: Path) -> list[tuple[int, bytes]]:
    found: list[tuple[int, bytes]] = []
    for _ in open_log(path).messages(private=lambda opcode, data: found.append((opcode, data))):
        pass
    return found


def test_private_records_and_schemas_of_no_channel_are_kept(foreign_reader: Any, tmp_path: Path) -> None:
    source, out, again = tmp_path / "in.mcap", tmp_path / "out.mcap", tmp_path / "again.mcap"
    source.write_bytes(private_log())
    copied = recover_log(source, out)
    records = [(0x80, b"own0"), (0x81, b"own1"), (0x82, b"own2"), (0xFF, b"inner")]
    assert private_records(out) == private_records(source) == records
    assert (copied.private, copied.notes) == (4, ())
    assert len(foreign_reader(out)) == 3
    with out.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        assert [schema.name for schema in summary.schemas.values()] == ["pkg/Unused"]
    assert (recover_log(out, again).problems, recover_log(out, again).complete) == ((), True)
    assert private_records(again) == records
