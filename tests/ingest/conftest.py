"""Fixtures for reading logs: the shared reference files, and small logs made on the spot."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from istc_replay.ingest.walk import open_log

from ..support.logs import T0_NS, Topic, vehicle_state


@pytest.fixture
def save(tmp_path: Path) -> Callable[[bytes], Path]:
    """A function that saves bytes as a log and returns its path."""

    def to_file(data: bytes) -> Path:
        path = tmp_path / "log.mcap"
        path.write_bytes(data)
        return path

    return to_file


@pytest.fixture
def one_vehicle() -> Topic:
    """Ten states of one vehicle, 0.1 s apart, driving along +x at 5 m/s."""
    times = [T0_NS + k * 100_000_000 for k in range(10)]
    return Topic(
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
