"""The walk against the format's own suite: every message, attachment and channel, wanted or not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from istc_replay.ingest.records import MAGIC
from istc_replay.ingest.walk import open_log

from ..support.logs import Topic, write_log
from ..support.mcap_bytes import T0_NS, codes, make, walk

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


def test_joined_files_are_read_one_after_the_other() -> None:
    data = make("lz4")
    log, messages = walk(data + data)
    assert messages == walk(data)[1] * 2
    assert "joined_files" in codes(log)
    assert "statistics" not in codes(log)


def test_a_repeated_walk_gives_the_same() -> None:
    log = open_log(make("zstd")[:-30])
    first, problems = list(log.messages()), log.problems
    assert [m[1:] for m in log.messages()] == [m[1:] for m in first]
    assert log.problems == problems


def test_only_wanted_channels_are_given_but_all_are_counted() -> None:
    log = open_log(make("zstd"))
    given_topics = {m.channel.topic for m in log.messages(lambda channel: channel.topic == "/b")}
    assert given_topics == {"/b"}
    assert {channel.topic: count for channel, count in log.counts.items()} == {"/a": 12, "/b": 12}
    assert (log.message_count, log.start_ns, log.end_ns) == (24, T0_NS, T0_NS + 111)


def test_attachments_and_metadata_are_read_and_checked() -> None:
    data = make("", attachments=[("config.toml", b"unit_s = 1")], metadata=[("who", {"a": "b"})])
    log, _ = walk(data)
    assert [(a.name, log.attachment_data(a)) for a in log.attachments] == [("config.toml", b"unit_s = 1")]
    assert [(m.name, m.metadata) for m in log.metadata] == [("who", {"a": "b"})]
    log, _ = walk(data.replace(b"unit_s = 1", b"unit_s = 9"))
    assert log.attachments == []
    assert "attachment_crc" in codes(log)
    assert not log.complete


def test_the_profile_and_the_spans_of_channels_are_told() -> None:
    made = [Topic("/a", [(T0_NS + 5, b""), (T0_NS, b"")]), Topic("/b", [(T0_NS + 9, b"")]), Topic("/c", [])]
    log, _ = walk(write_log(*made))
    spans = {channel.topic: span for channel, span in log.spans.items()}
    assert spans == {"/a": (T0_NS, T0_NS + 5), "/b": (T0_NS + 9, T0_NS + 9)}
    assert log.profile == ""
    assert {channel.topic for channel in log.counts} == {"/a", "/b", "/c"}
    assert log.position == log.size - len(MAGIC)
