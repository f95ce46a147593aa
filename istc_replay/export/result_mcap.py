"""Writing a result as MCAP: the `istc.v1` messages and what Foxglove shows with no plug-in."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO, cast

import polars as pl
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from istc_replay.config import Config, parse_config
from istc_replay.datatypes import Certificate, Log, WindowPlan
from istc_replay.errors import ExportError
from istc_replay.export.encode import (
    certificate_message,
    finding_messages,
    plan_messages,
    recorded_messages,
    scene_message,
    solve_records,
)
from istc_replay.export.foxglove import foxglove_messages
from istc_replay.export.foxglove_log import log_messages
from istc_replay.export.hashed import HashedFile
from istc_replay.export.placing import first_ns
from istc_replay.export.stamped import Stamped, in_order, merged, place
from istc_replay.export.summary import summary_text
from istc_replay.ingest.result import repeatable_summary

#: MCAP numbers channels with 16 bits; 0 is none.
_TOPIC_LIMIT = 2**16 - 1


@dataclass(frozen=True, slots=True, eq=False)
class Contents:
    """What the file of one result tells.

    Parameters
    ----------
    log : Log
        What was recorded; every state is written as it was read.
    plans : sequence of WindowPlan
        One a window, in order; gone through more than once, and never held all at once.
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
    """

    log: Log
    plans: Sequence[WindowPlan]
    certificates: Sequence[Certificate]
    summary: Mapping[str, Any]
    config_toml: str
    provenance: Mapping[str, str]
    findings: pl.DataFrame | None = None
    shown: bool = True


def write_result(stream: BinaryIO | HashedFile, contents: Contents) -> None:
    """Write a result as one MCAP file.

    The bytes follow from the contents and the installed versions alone: equal results are equal
    byte for byte. Messages stand in order of time, then topic; log_time and publish_time are the
    time of what a message tells. Wall-clock times are left out of solves and summary.

    Raises
    ------
    ExportError
        If the summary is not JSON, a certificate names a window that is not there, or there are
        more topics than an MCAP file can have.
    ConfigError
        If the configuration is none.
    """
    config = parse_config(contents.config_toml)
    attached = _json(repeatable_summary(contents.summary))
    # What it asks of a file is to write, to tell and to flush.
    writer = Writer(cast(BinaryIO, stream), compression=CompressionType.ZSTD, enable_crcs=True)
    writer.start(profile="", library="istc-replay")
    writer.add_metadata("istc.provenance", dict(sorted(contents.provenance.items())))
    start_ns = _write_messages(writer, _messages(contents, config))
    toml = contents.config_toml.encode()
    writer.add_attachment(start_ns, start_ns, "config.toml", "application/toml", toml)
    writer.add_attachment(start_ns, start_ns, "summary.json", "application/json", attached)
    writer.finish()


def result_bytes(contents: Contents) -> bytes:
    """The bytes of a result's file; errors as of `write_result`."""
    stream = io.BytesIO()
    write_result(stream, contents)
    return stream.getvalue()


def solve_times(plan: WindowPlan) -> list[dict[str, Any]]:
    """List the wall-clock time of each row of a window in the solves table, for `summary["solves"]`."""
    return [
        {
            "window": plan.scenario.window.index,
            "vehicle_id": record.vehicle_id,
            "layer": record.layer,
            "stage": record.stage,
            "wall_s": record.wall_s,
        }
        for record in solve_records(plan)
    ]


def _messages(contents: Contents, config: Config) -> Iterator[Stamped]:
    """All messages in their order in the file."""
    log, plans, certificates = contents.log, contents.plans, contents.certificates
    windows = [plan.scenario.window for plan in plans]
    starts_ns = {window.index: window.start_ns for window in windows}
    for certificate in certificates:
        if certificate.window not in starts_ns:
            raise ExportError(f"certificate of window {certificate.window}: there is no plan of that window")
    checks = [certificate_message(certificate, starts_ns[certificate.window]) for certificate in certificates]
    planned = ((plan.scenario.window.start_ns, plan_messages(plan, config.corridors)) for plan in plans)
    sources: list[Iterable[Stamped]] = [
        [(first_ns(log, windows), "/istc/static", scene_message(log.scene))],
        recorded_messages(log.states),
        in_order(planned),
        sorted(checks, key=place),
        finding_messages(contents.findings) if contents.findings is not None else (),
    ]
    if contents.shown:
        sources.append(foxglove_messages(log, plans, windows, config.vehicles))
        sources.append(log_messages(plans, starts_ns, certificates, contents.findings))
    return merged(*sources)


def _write_messages(writer: Writer, ordered: Iterator[Stamped]) -> int:
    """Write messages in their order; returns the first one's time."""
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    counts: dict[str, int] = {}
    first_ns: int | None = None
    for stamped in ordered:
        time_ns, topic = place(stamped)
        message = stamped[2]
        if topic not in channels:
            if len(channels) == _TOPIC_LIMIT:
                raise ExportError(
                    f"more than {_TOPIC_LIMIT} topics, which is what an MCAP file can have: "
                    "cut the log into shorter spans"
                )
            name = message.DESCRIPTOR.full_name
            if name not in schemas:
                schemas[name] = writer.register_schema(name, "protobuf", _schema(type(message)))
            channels[topic] = writer.register_channel(topic, "protobuf", schemas[name])
        first_ns = time_ns if first_ns is None else first_ns
        sequence = counts[topic] = counts.get(topic, 0) + 1
        data = message.SerializeToString(deterministic=True)
        writer.add_message(channels[topic], time_ns, data, time_ns, sequence)
    return first_ns or 0


def _schema(kind: Any) -> bytes:
    return bytes(build_file_descriptor_set(kind).SerializeToString(deterministic=True))


def _json(summary: Mapping[str, Any]) -> bytes:
    try:
        return b"".join(piece.encode() for piece in summary_text(summary))
    except (TypeError, ValueError) as error:
        raise ExportError(
            f"the summary cannot be written as JSON: {error}; give plain finite values"
        ) from None
