"""Readers of MCAP that are not ours, and conversions read back."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import polars as pl
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2.storage_mcap import McapReader as RosbagsReader

from istc_replay.config import parse_config
from istc_replay.ingest.log import read_log
from istc_replay.pipeline.convert import Converted, convert_recording

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
