"""Logs with all that MCAP can hold, readers of MCAP that are not ours, and conversions read back."""

from __future__ import annotations

import io
import json
import os
import shutil
import struct
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2.storage_mcap import McapReader as RosbagsReader

from istc_replay.config import parse_config
from istc_replay.ingest.log import read_log
from istc_replay.pipeline.convert import Converted, convert_recording

from ..support.logs import T0_NS

DEFINITION = b"string text\n"
#: Topic, log time, payload.
Row = tuple[str, int, bytes]

_NODE_SCRIPT = """
const { McapStreamReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");
(async () => {
  const decompressHandlers = await loadDecompressHandlers();
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  reader.append(require("fs").readFileSync(process.argv[2]));
  const topics = new Map(), rows = [];
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Channel") topics.set(record.id, record.topic);
    if (record.type !== "Message") continue;
    const data = Buffer.from(record.data).toString("hex");
    rows.push([topics.get(record.channelId), String(record.logTime), data]);
  }
  if (!reader.done()) throw new Error("the file does not end");
  process.stdout.write(JSON.stringify(rows));
})();
"""


@dataclass
class Contents:
    """Everything that a copy must keep, in comparable form."""

    messages: list[tuple[Any, ...]] = field(default_factory=list)
    channels: list[tuple[Any, ...]] = field(default_factory=list)
    attachments: list[tuple[Any, ...]] = field(default_factory=list)
    metadata: list[tuple[Any, ...]] = field(default_factory=list)


@pytest.fixture(scope="session")
def contents() -> Callable[[Path], Contents]:
    """A function that reads all of a file by the reference library, checksums validated."""

    def read(path: Path) -> Contents:
        found, schemas, channels = Contents(), {}, {}
        with path.open("rb") as stream:
            for record in StreamReader(stream, validate_crcs=True).records:
                kind = type(record).__name__
                if kind == "DataEnd":
                    break
                if kind == "Schema":
                    schemas[record.id] = (record.name, record.encoding, record.data)
                elif kind == "Channel":
                    schema = schemas.get(record.schema_id)
                    channels[record.id] = (record.topic, record.message_encoding, record.metadata, schema)
                elif kind == "Message":
                    channel = channels[record.channel_id]
                    times = (record.log_time, record.publish_time, record.sequence)
                    found.messages.append((channel, *times, record.data))
                elif kind == "Attachment":
                    times = (record.log_time, record.create_time)
                    found.attachments.append((record.name, record.media_type, *times, record.data))
                elif kind == "Metadata":
                    found.metadata.append((record.name, record.metadata))
        found.channels = list(channels.values())
        return found

    return read


@pytest.fixture(scope="session")
def full_log() -> Callable[..., bytes]:
    """A function that makes a log with two channels on one topic, attachments and metadata."""

    def make(
        count: int = 60, first_ns: int = T0_NS, topic: str = "/chatter", text: str = "", **options: Any
    ) -> bytes:
        stream = io.BytesIO()
        writer = Writer(stream, **{"compression": CompressionType.NONE, "chunk_size": 400, **options})
        writer.start(profile="ros2")
        schema = writer.register_schema("pkg/msg/Text", "ros2msg", DEFINITION)
        notes = {"offered_qos_profiles": "", "note": "é"}
        channels = [writer.register_channel(topic, "cdr", schema, notes) for _ in range(2)]
        static = writer.register_channel("/tf_static", "cdr", schema)
        plain = writer.register_channel("/plain", "json", 0)
        writer.register_channel("/silent", "json", 0)
        writer.add_message(static, first_ns, b"\0\1\0\0standing", first_ns + 5, 77)
        for k in range(count):
            time_ns = first_ns + k * 100_000_000
            writer.add_message(channels[k % 2], time_ns, f"{text}{k}".encode() * 3, time_ns - 7, 1000 - k)
        writer.add_message(plain, first_ns + 1, b"", 2**64 - 1, 2**32 - 1)
        writer.add_attachment(11, 12, "notes.txt", "text/plain", b"\0\xff" * 300)
        writer.add_attachment(0, 0, "notes.txt", "", b"")
        writer.add_metadata("run", {"driver": "ü", "car": ""})
        writer.add_metadata("run", {})
        writer.finish()
        return stream.getvalue()

    return make


@pytest.fixture(scope="session")
def private_log() -> bytes:
    """A log with private records, one of them in a chunk, and a schema that no channel names."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE)
    writer.start(profile="ros2")
    writer.register_schema("pkg/Unused", "ros2msg", DEFINITION)
    channel = writer.register_channel("/plain", "json", 0)
    for k in range(3):
        stream.write(struct.pack("<BQ", 0x80 + k, 4) + b"own%d" % k)
        writer.add_message(channel, T0_NS + k, b"{}", T0_NS)
        writer.add_attachment(0, 0, f"{k}.txt", "text/plain", b"")
    data = struct.pack("<BQ", 0xFF, 5) + b"inner"
    stream.write(struct.pack("<BQQQQIIQ", 0x06, 40 + len(data), 0, 0, len(data), 0, 0, len(data)) + data)
    writer.finish()
    return stream.getvalue()


def _by_mcap(path: Path) -> list[Row]:
    with path.open("rb") as stream:
        return [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages()
        ]


def _by_rerun(path: Path) -> list[Row]:
    from rerun.chunk import McapReader

    rows = []
    for chunk in McapReader(path, decoders=["raw"]).stream():
        batch = chunk.to_record_batch()
        name = next((name for name in batch.schema.names if name.endswith("McapMessage:data")), None)
        if name is not None:
            # Rerun escapes what is no part of its names.
            topic = str(chunk.entity_path).replace("\\", "")
            times = batch.column("message_log_time").cast("int64").to_pylist()
            blobs = batch.column(name).to_pylist()
            rows += [(topic, time, bytes(blob[0])) for time, blob in zip(times, blobs, strict=True)]
    return rows


def _by_rosbags(path: Path) -> list[Row]:
    reader = RosbagsReader(path)
    reader.open()
    try:
        return [
            (connection.topic, time, bytes(data))
            for connection, time, data in reader.messages(reader.connections, None, None)
        ]
    finally:
        reader.close()


def _by_node(path: Path) -> list[Row]:
    done = subprocess.run(
        ["node", "-e", _NODE_SCRIPT, "reader", path], capture_output=True, text=True, check=True
    )
    return [(topic, int(time), bytes.fromhex(data)) for topic, time, data in json.loads(done.stdout)]


def _node_has_mcap() -> bool:
    command = ["node", "-e", 'require("@mcap/core"); require("@mcap/support")']
    return (
        shutil.which("node") is not None
        and not subprocess.run(command, capture_output=True, check=False, env=os.environ).returncode
    )


@pytest.fixture(params=["mcap", "rerun", "rosbags", "node"])
def foreign_reader(request: pytest.FixtureRequest) -> Callable[[Path], list[Row]]:
    """Readers that are none of ours: three in Python and Rust, and the TypeScript one where it is there.

    For the last, set NODE_PATH to a folder of node modules with @mcap/core and @mcap/support.
    """
    if request.param == "node" and not _node_has_mcap():
        pytest.skip("node does not find @mcap/core and @mcap/support; NODE_PATH can name their folder")
    readers = {"mcap": _by_mcap, "rerun": _by_rerun, "rosbags": _by_rosbags, "node": _by_node}
    return readers[request.param]


@pytest.fixture
def convert(tmp_path: Path) -> Callable[..., tuple[Converted, pl.DataFrame]]:
    """Convert a file, or a text under this name, and read the log."""

    def run(
        source: Path | str, text: str | bytes = "", config: str = "", types: tuple[Path, ...] = ()
    ) -> tuple[Converted, pl.DataFrame]:
        path = source if isinstance(source, Path) else tmp_path / source
        if not isinstance(source, Path):
            path.write_bytes(text.encode() if isinstance(text, str) else text)
        out = tmp_path / "out.mcap"
        done = convert_recording(path, out, parse_config(config), types)
        return done, read_log(out).states

    return run
