"""Small logs made on the spot, and payloads decoded as a reader decodes them."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from istc_replay.ingest.layout import Decoded
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


def write_log(
    *topics: Topic,
    compression: CompressionType = CompressionType.NONE,
    attachments: Iterable[tuple[str, bytes]] = (),
    metadata: Iterable[tuple[str, dict[str, str]]] = (),
    **options: Any,
) -> bytes:
    """Topics as an MCAP file, written by the reference library in order of log time."""
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


def vehicle_state(time_ns: int = T0_NS, vehicle_id: str = "1", **values: Any) -> bytes:
    """The payload of an `istc.v1.VehicleState`."""
    state = message("VehicleState")(time_ns=time_ns, vehicle_id=vehicle_id)
    for name, value in values.items():
        if name in ("length_m", "width_m", "wheelbase_m", "rear_axle_to_centre_m"):
            setattr(state.dimensions, name, value)
        else:
            setattr(state, name, value)
    payload: bytes = state.SerializeToString()
    return payload


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
