"""Clips: the span asked for, byte for byte, with what holds for the whole log."""

from __future__ import annotations

import json
from pathlib import Path

import polars as pl
import pytest

from istc_replay.config import Config
from istc_replay.errors import LogError, UsageError
from istc_replay.ingest.log import read_log
from istc_replay.ingest.records import Channel, Schema
from istc_replay.pipeline.audit import audit_read
from istc_replay.pipeline.clip import Around, Between, clip_log, is_standing, moment_ns

from ..support.copies import contents, full_log, private_log
from ..support.logs import T0_NS

SAMPLE = Path(__file__).resolve().parents[2] / "sample_logs/intersection_turn_first.mcap"


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Sixty messages, 0.1 s apart."""
    path = tmp_path / "in.mcap"
    path.write_bytes(full_log())
    return path


@pytest.mark.parametrize(
    ("start", "end", "count"),
    [("1", "2", 10), ("1.05", None, 49), (None, "0.5", 5), (f"{T0_NS + 10**9}ns", "1.05", 1)],
)
def test_a_clip_is_the_span_byte_for_byte(
    start: str | None, end: str | None, count: int, source: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.mcap"
    clip_log(source, out, Between(start, end), Config())
    before, after = contents(source), contents(out)
    low = T0_NS if start is None else moment_ns(start, T0_NS)
    high = 2**63 if end is None else moment_ns(end, T0_NS)
    inside = [m for m in before.messages if low <= m[1] < high or m[0][0] == "/tf_static"]
    assert after.messages == inside
    assert sum(m[0][0] == "/chatter" for m in after.messages) == count
    assert (after.attachments, after.metadata) == (before.attachments, before.metadata)
    assert sorted(map(str, after.channels)) == sorted(map(str, before.channels))


@pytest.mark.parametrize(
    ("span", "walks"),
    [
        (Between("1", "2"), 2),
        (Around(0.5, moment="3"), 2),
        (Between(f"{T0_NS + 10**9}ns", None), 1),
        (Around(0.5, moment="2023-11-14T22:13:22Z"), 1),
        (Between(None, None), 1),
    ],
)
def test_a_log_is_walked_twice_only_where_moments_count_from_its_start(
    span: Around | Between, walks: int, source: Path, tmp_path: Path
) -> None:
    told: list[tuple[int, int]] = []
    done = clip_log(source, tmp_path / "out.mcap", span, Config(), lambda *part: told.append(part))
    size = source.stat().st_size
    assert {total for _, total in told} == {walks * size}
    assert all(position <= total for position, total in told)
    assert done.messages > 0


def test_a_clip_around_a_moment_has_its_margin_on_both_sides(source: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    clip_log(source, out, Around(0.25, moment="3"), Config())
    times = [m[1] - T0_NS for m in contents(out).messages if m[0][0] == "/chatter"]
    assert times == [k * 100_000_000 for k in (28, 29, 30, 31, 32)]


@pytest.mark.parametrize("where", ["folder", "json", "parquet", "anew"])
def test_a_clip_around_a_finding_holds_it_and_can_be_read_as_the_log(where: str, tmp_path: Path) -> None:
    config, out, folder = Config(), tmp_path / "out.mcap", tmp_path / "audit"
    audit_read(SAMPLE, config, folder, ["json", "parquet"], "serious")
    finding = json.loads((folder / "audit.json").read_text())["findings"][0]
    audits = {"json": folder / "audit.json", "parquet": folder / "findings.parquet", "folder": folder}
    span = Around(0.5, finding_id=finding["finding_id"], audit=audits.get(where))
    clip_log(SAMPLE, out, span, config)
    whole, clip = read_log(SAMPLE), read_log(out)
    times = pl.col("time_ns").is_between(finding["start_ns"] - 500_000_000, finding["end_ns"] + 500_000_000)
    same = ("vehicle_id", "time_ns", "x_m", "y_m", "heading_rad", "speed_mps", "topic")
    assert clip.states.select(same).equals(whole.states.filter(times).select(same))
    assert 0 < clip.states.height < whole.states.height
    assert len(clip.scene.lane_lines) == len(whole.scene.lane_lines) > 0


def test_an_audit_of_another_log_or_an_unknown_finding_is_refused(source: Path, tmp_path: Path) -> None:
    config, out, folder = Config(), tmp_path / "out.mcap", tmp_path / "audit"
    audit_read(SAMPLE, config, folder, ["json"], "serious")
    known = json.loads((folder / "audit.json").read_text())["findings"][0]["finding_id"]
    with pytest.raises(UsageError, match="no finding 'nobody'"):
        clip_log(SAMPLE, out, Around(1.0, finding_id="nobody", audit=folder), config)
    with pytest.raises(UsageError, match="another log"):
        clip_log(source, out, Around(1.0, finding_id=known, audit=folder), config)
    for text in ("", "[]", '{"findings": 3}', "[" * 100_000):
        (folder / "audit.json").write_text(text)
        with pytest.raises(LogError, match="no audit"):
            clip_log(SAMPLE, out, Around(1.0, finding_id=known, audit=folder), config)
    assert not out.exists()


def test_an_empty_span_writes_nothing_and_names_the_logs_own(source: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    with pytest.raises(UsageError, match=r"the log lasts 5.900 s"):
        clip_log(source, out, Between("100", "200"), Config())
    with pytest.raises(UsageError, match="must be after"):
        clip_log(source, out, Between("3", "3"), Config())
    assert not out.exists()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("12.5", T0_NS + 12_500_000_000),
        ("-1", T0_NS - 10**9),
        ("17ns", 17),
        ("2023-11-14T22:13:21Z", T0_NS + 10**9),
        ("2023-11-14T23:13:20.5+01:00", T0_NS + 500_000_000),
    ],
)
def test_moments_are_told_in_three_ways(text: str, expected: int) -> None:
    assert moment_ns(text, T0_NS) == expected


@pytest.mark.parametrize("text", ["", "soon", "1e400", "nan", "inf", "5 s", "xns"])
def test_what_is_no_moment_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="no moment"):
        moment_ns(text, T0_NS)


@pytest.mark.parametrize(
    ("topic", "metadata", "schema", "standing"),
    [
        ("/tf_static", {}, "", True),
        ("/robot/tf_static", {}, "", True),
        ("/map", {"offered_qos_profiles": "- history: 1\n  durability: 1\n"}, "", True),
        ("/map", {"offered_qos_profiles": "- durability: transient_local"}, "", True),
        ("/map", {"offered_qos_profiles": "- durability: 2"}, "", False),
        ("/scene", {}, "istc.v1.Scene", True),
        ("/tf", {}, "tf2_msgs/msg/TFMessage", False),
    ],
)
def test_what_stands_is_known_by_its_topic_publisher_or_schema(
    topic: str, metadata: dict[str, str], schema: str, standing: bool
) -> None:
    channel = Channel(1, topic, "cdr", metadata, Schema(schema, "", b"") if schema else None)
    assert is_standing(channel) is standing


def test_private_records_are_left_out_and_told(tmp_path: Path) -> None:
    source = tmp_path / "private.mcap"
    source.write_bytes(private_log())
    copied = clip_log(source, tmp_path / "out.mcap", Between(f"{T0_NS + 1}ns", None), Config())
    assert (copied.messages, copied.attachments, copied.private) == (2, 3, 0)
    assert copied.notes[-1] == "private records (opcodes from 0x80) are not copied: 4"
