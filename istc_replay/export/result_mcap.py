"""Writing a result as MCAP: the `istc.v1` messages and what Foxglove shows with no plug-in."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import polars as pl
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from istc_replay.config import Config, parse_config
from istc_replay.datatypes import Certificate, Log, WindowPlan
from istc_replay.errors import ExportError
from istc_replay.export.encode import (
    Stamped,
    certificate_message,
    finding_messages,
    plan_messages,
    recorded_messages,
    scene_message,
    solve_records,
)
from istc_replay.export.foxglove import foxglove_messages
from istc_replay.export.foxglove_log import log_messages
from istc_replay.export.placing import first_ns
from istc_replay.ingest.result import repeatable_summary

#: MCAP numbers channels with 16 bits; 0 is none.
_TOPIC_LIMIT = 2**16 - 1


def result_bytes(
    log: Log,
    plans: Sequence[WindowPlan],
    certificates: Sequence[Certificate],
    summary: Mapping[str, Any],
    config_toml: str,
    provenance: Mapping[str, str],
    *,
    findings: pl.DataFrame | None = None,
    shown: bool = True,
) -> bytes:
    """Write a result as one MCAP file, in memory.

    The bytes follow from the arguments and the installed versions alone: equal results are equal
    byte for byte. Messages stand in order of time, then topic; log_time and publish_time are the
    time of what a message tells. Wall-clock times are left out of solves and summary.

    Parameters
    ----------
    log : Log
        What was recorded; every state is written as it was read.
    plans : sequence of WindowPlan
        One a window, in order.
    certificates : sequence of Certificate
        The checks of the plans.
    summary : mapping
        Attached as summary.json.
    config_toml : str
        The configuration in force, attached as config.toml.
    provenance : mapping of str to str
        The metadata record `istc.provenance`.
    findings : DataFrame, optional
        Those of the audit of what was recorded (FINDINGS_SCHEMA).
    shown : bool
        Whether to add the messages that Foxglove shows; none of the tables is made of them.

    Raises
    ------
    ExportError
        If the summary is not JSON, a certificate names a window that is not there, or there are
        more topics than an MCAP file can have.
    ConfigError
        If config_toml is not a configuration.
    """
    config = parse_config(config_toml)
    stamped = _encoded(_all_messages(log, plans, certificates, config, findings, shown=shown))
    attached = _json(repeatable_summary(summary))
    stream = io.BytesIO()
    writer = Writer(stream, compression=CompressionType.ZSTD, enable_crcs=True)
    writer.start(profile="", library="istc-replay")
    writer.add_metadata("istc.provenance", dict(sorted(provenance.items())))
    _write_messages(writer, stamped)
    start_ns = stamped[0][0]
    writer.add_attachment(start_ns, start_ns, "config.toml", "application/toml", config_toml.encode())
    writer.add_attachment(start_ns, start_ns, "summary.json", "application/json", attached)
    writer.finish()
    return stream.getvalue()


def solve_times(plans: Sequence[WindowPlan]) -> list[dict[str, Any]]:
    """List the wall-clock time of each row of the solves table, for `summary["solves"]`."""
    return [
        {
            "window": plan.scenario.window.index,
            "vehicle_id": record.vehicle_id,
            "layer": record.layer,
            "stage": record.stage,
            "wall_s": record.wall_s,
        }
        for plan in plans
        for record in solve_records(plan)
    ]


def _all_messages(
    log: Log,
    plans: Sequence[WindowPlan],
    certificates: Sequence[Certificate],
    config: Config,
    findings: pl.DataFrame | None,
    *,
    shown: bool,
) -> Iterator[Stamped]:
    starts = {plan.scenario.window.index: plan.scenario.window.start_ns for plan in plans}
    yield first_ns(log, plans), "/istc/static", scene_message(log.scene)
    yield from recorded_messages(log.states)
    for plan in plans:
        yield from plan_messages(plan, config.corridors)
    for certificate in certificates:
        if certificate.window not in starts:
            raise ExportError(f"certificate of window {certificate.window}: there is no plan of that window")
        yield certificate_message(certificate, starts[certificate.window])
    if findings is not None:
        yield from finding_messages(findings)
    if shown:
        yield from foxglove_messages(log, plans, config.vehicles)
        yield from log_messages(plans, certificates, findings)


def _encoded(stamped: Iterator[Stamped]) -> list[tuple[int, str, Any, bytes]]:
    # MCAP's times are unsigned; a log may count from an origin in its midst.
    encoded = [
        (max(time_ns, 0), topic, type(message), message.SerializeToString(deterministic=True))
        for time_ns, topic, message in stamped
    ]
    # Python's sort is stable: messages of one topic and instant keep the order they were made in.
    encoded.sort(key=lambda entry: entry[:2])
    return encoded


def _write_messages(writer: Writer, encoded: Sequence[tuple[int, str, Any, bytes]]) -> None:
    topics = len({topic for _, topic, _, _ in encoded})
    if topics > _TOPIC_LIMIT:
        raise ExportError(
            f"{topics} topics; an MCAP file has at most {_TOPIC_LIMIT}: cut the log into shorter spans"
        )
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    counts: dict[str, int] = {}
    for time_ns, topic, kind, data in encoded:
        if topic not in channels:
            name = kind.DESCRIPTOR.full_name
            if name not in schemas:
                schemas[name] = writer.register_schema(name, "protobuf", _schema(kind))
            channels[topic] = writer.register_channel(topic, "protobuf", schemas[name])
        sequence = counts[topic] = counts.get(topic, 0) + 1
        writer.add_message(channels[topic], time_ns, data, time_ns, sequence)


def _schema(kind: Any) -> bytes:
    return bytes(build_file_descriptor_set(kind).SerializeToString(deterministic=True))


def _json(values: Any) -> bytes:
    try:
        return json.dumps(values, indent=1, allow_nan=False).encode()
    except (TypeError, ValueError) as error:
        raise ExportError(
            f"the summary cannot be written as JSON: {error}; give plain finite values"
        ) from None
