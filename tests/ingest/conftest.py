"""Fixtures for reading logs: the shared reference files, and small logs made on the spot."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import CompressionType, Writer

from istc_replay.ingest.layout import Decoded
from istc_replay.ingest.walk import open_log
from istc_replay.messages import descriptor_set, message

T0_NS = 1_700_000_000_000_000_000


@dataclass
class Topic:
    """A channel to write, and its messages as (log time, payload)."""

    name: str
    messages: list[tuple[int, bytes]]
    schema: str = "istc.v1.VehicleState"
    schema_encoding: str = "protobuf"
    schema_data: bytes = field(default_factory=descriptor_set)
    encoding: str = "protobuf"


@pytest.fixture(scope="session")
def topic() -> type[Topic]:
    """The class of the topics that `write_log` takes."""
    return Topic


@pytest.fixture(scope="session")
def write_log() -> Callable[..., bytes]:
    """A function that writes topics to an MCAP file by the reference library, in order of log time."""

    def write(
        *topics: Topic,
        compression: CompressionType = CompressionType.NONE,
        attachments: Iterable[tuple[str, bytes]] = (),
        metadata: Iterable[tuple[str, dict[str, str]]] = (),
        **options: Any,
    ) -> bytes:
        stream = io.BytesIO()
        writer = Writer(stream, compression=compression, **options)
        writer.start()
        queue: list[tuple[int, int, int, bytes]] = []
        for topic in topics:
            schema_id = writer.register_schema(topic.schema, topic.schema_encoding, topic.schema_data)
            channel = writer.register_channel(topic.name, topic.encoding, schema_id if topic.schema else 0)
            queue += [(time, channel, index, data) for index, (time, data) in enumerate(topic.messages)]
        for time, channel, index, data in sorted(queue, key=lambda entry: entry[:3]):
            writer.add_message(channel, time, data, publish_time=time + 1, sequence=index)
        for name, data in attachments:
            writer.add_attachment(1, 2, name, "text/plain", data)
        for name, values in metadata:
            writer.add_metadata(name, values)
        writer.finish()
        return stream.getvalue()

    return write


@pytest.fixture(scope="session")
def vehicle_state() -> Callable[..., bytes]:
    """A function that makes the payload of an `istc.v1.VehicleState`."""

    def make(time_ns: int = T0_NS, vehicle_id: str = "1", **values: Any) -> bytes:
        state = message("VehicleState")(time_ns=time_ns, vehicle_id=vehicle_id)
        for name, value in values.items():
            if name in ("length_m", "width_m", "wheelbase_m", "rear_axle_to_centre_m"):
                setattr(state.dimensions, name, value)
            else:
                setattr(state, name, value)
        payload: bytes = state.SerializeToString()
        return payload

    return make


@pytest.fixture
def save(tmp_path: Path) -> Callable[[bytes], Path]:
    """A function that saves bytes as a log and returns its path."""

    def to_file(data: bytes) -> Path:
        path = tmp_path / "log.mcap"
        path.write_bytes(data)
        return path

    return to_file


@pytest.fixture
def one_vehicle(topic: type[Topic], vehicle_state: Callable[..., bytes]) -> Topic:
    """Ten states of one vehicle, 0.1 s apart, driving along +x at 5 m/s."""
    times = [T0_NS + k * 100_000_000 for k in range(10)]
    return topic(
        "/vehicles/1",
        [
            (
                time,
                vehicle_state(
                    time, x_m=0.5 * k, y_m=2.0, heading_rad=0.0, speed_mps=5.0, length_m=4.0, width_m=2.0
                ),
            )
            for k, time in enumerate(times)
        ],
    )


@pytest.fixture(scope="session")
def osi_descriptor(shared_logs: Path) -> bytes:
    """OSI's FileDescriptorSet, as a third-party log embeds it, SensorView included."""
    found = next(open_log(shared_logs / "third_party/pedestrian.mcap").messages())
    assert found.channel.schema is not None
    return found.channel.schema.data


@pytest.fixture(scope="session")
def osi(osi_descriptor: bytes) -> Callable[[str], Any]:
    """A function that gives OSI's message classes, built here and not by the code under test."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(osi_descriptor).file:
        pool.Add(file)
    return lambda name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"osi3.{name}"))


@pytest.fixture(scope="session")
def json_truth(shared_logs: Path) -> pl.DataFrame:
    """The states of `json_state.mcap`, parsed here; its positions are rear axles."""
    rows = [json.loads(m.data) for m in open_log(shared_logs / "formats/json_state.mcap").messages()]
    stamps = [row["timestamp"]["sec"] * 10**9 + row["timestamp"]["nsec"] for row in rows]
    table = pl.DataFrame(rows).with_columns(time_ns=pl.Series(stamps, dtype=pl.Int64))
    return table.sort("id", "time_ns")


def decode(decoder: Any, payloads: list[bytes]) -> Decoded:
    """Decode payloads that stand one behind the other."""
    data = np.frombuffer(b"".join(payloads) + bytes(32), np.uint8)
    ends = np.cumsum([len(payload) for payload in payloads]).astype(np.int64)
    starts = ends - [len(payload) for payload in payloads]
    return decoder.decode(data, starts, ends)


def plain(decoded: Decoded, name: str) -> list[Any]:
    """Values of a column, None where they are not told."""
    column = decoded.columns[name]
    values = column.values.tolist()
    if column.texts is not None:
        values = [column.texts[value] for value in values]
    return (
        values
        if column.valid is None
        else [v if ok else None for v, ok in zip(values, column.valid, strict=True)]
    )
