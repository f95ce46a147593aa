"""A result is read whole or not at all, and what is not one is told."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer
from polars.testing import assert_frame_equal

from istc_replay import messages
from istc_replay.datatypes import (
    Result,
)
from istc_replay.errors import LogError
from istc_replay.ingest.result import load_result_folder, read_result

from ..support.results import one_message


def test_a_recorded_log_is_not_a_result() -> None:
    path = Path(__file__).resolve().parents[2] / "sample_logs" / "intersection_turn_first.mcap"
    if not path.exists():
        pytest.skip("sample_logs/intersection_turn_first.mcap is not there")
    with pytest.raises(
        LogError, match=r"turn_first\.mcap: not a result: it lacks the metadata istc\.provenance"
    ):
        read_result(path)


def test_what_a_result_lacks_is_named(synthetic_bytes: bytes) -> None:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    writer.add_metadata("istc.provenance", {})
    writer.add_attachment(0, 0, "config.toml", "application/toml", b"")
    writer.finish()
    lacks = "lacks the attachment summary.json, the topic /istc/static of istc.v1.Scene; make it again"
    with pytest.raises(LogError, match=lacks):
        read_result(stream.getvalue())


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such file"):
        read_result(tmp_path / "result.mcap")
    with pytest.raises(LogError, match="no such file"):
        load_result_folder(tmp_path)


def test_a_topic_of_another_schema_is_damage_not_silence() -> None:
    with pytest.raises(
        LogError, match=r"'/istc/corridors'.*'istc\.v1\.Scene', not protobuf of istc\.v1\.Corridors"
    ):
        read_result(one_message("/istc/corridors", "Scene", b""))


@pytest.mark.parametrize(
    ("topic", "kind", "data", "told"),
    [
        ("/istc/static", "Scene", b"\xff\xff", "not a message of istc.v1.Scene"),
        ("/istc/planned/a", "VehicleState", b"", "a planned state without its window"),
        (
            "/istc/guidance/a",
            "Guidance",
            messages.message("Guidance")(x_m=[1.0]).SerializeToString(),
            "a guidance of 0 times whose places differ",
        ),
        (
            "/istc/corridors",
            "Corridors",
            messages.message("Corridors")(corridors=[{"cubes": [{}], "pivots": [{}]}]).SerializeToString(),
            "a corridor of 1 cubes, 1 pivotal and 0 reference points",
        ),
    ],
)
def test_a_message_that_breaks_its_rules_is_damage(topic: str, kind: str, data: bytes, told: str) -> None:
    with pytest.raises(LogError, match=f"damaged result: .*{told}") as caught:
        read_result(one_message(topic, kind, data))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "data", "told"),
    [
        ("summary.json", b"[1]", "not a JSON object"),
        ("summary.json", b"[" * 100_000, "not a JSON object"),
        (
            "summary.json",
            b'{"schema": "istc-replay.summary.v2"}',
            "this version reads istc-replay.summary.v1",
        ),
        ("config.toml", b"\xff", "config.toml is not UTF-8"),
    ],
)
def test_attachments_that_cannot_be_used_are_told(name: str, data: bytes, told: str) -> None:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    writer.add_metadata("istc.provenance", {})
    schema = writer.register_schema("istc.v1.Scene", "protobuf", b"")
    writer.add_message(writer.register_channel("/istc/static", "protobuf", schema), 0, b"", 0)
    for attached, usual in (("config.toml", b""), ("summary.json", b"{}")):
        writer.add_attachment(0, 0, attached, "text/plain", data if attached == name else usual)
    writer.finish()
    with pytest.raises(LogError, match=told):
        read_result(stream.getvalue())


def tables(result: Result) -> list[Any]:
    return [result.states, result.corridors, result.obstacles, result.solves, result.certificates]


def test_no_truncated_result_is_read(synthetic_bytes: bytes) -> None:
    for size in range(0, len(synthetic_bytes), 997):
        with pytest.raises(LogError):
            read_result(synthetic_bytes[:size])


def test_the_damage_is_named(synthetic_bytes: bytes) -> None:
    with pytest.raises(LogError, match="damaged result: truncated at byte"):
        read_result(synthetic_bytes[:-20])


def test_a_changed_byte_is_told_or_changes_nothing(synthetic_bytes: bytes, synthetic_result: Result) -> None:
    for position in range(0, len(synthetic_bytes), 509):
        changed = bytearray(synthetic_bytes)
        changed[position] ^= 0x5A
        try:
            result = read_result(bytes(changed))
        except LogError as error:
            assert "\n" not in str(error)  # noqa: PT017
            continue
        for one, two in zip(tables(result), tables(synthetic_result), strict=True):
            assert_frame_equal(one, two)
        assert (result.summary, result.config_toml) == (
            synthetic_result.summary,
            synthetic_result.config_toml,
        )


def test_two_results_in_one_file_are_refused(synthetic_bytes: bytes) -> None:
    with pytest.raises(LogError, match="more than one result in one file"):
        read_result(synthetic_bytes + synthetic_bytes)
