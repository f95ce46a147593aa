"""The summary at the end of an MCAP file: a help for walking its damaged parts, never the truth."""

from __future__ import annotations

from dataclasses import dataclass, field

from istc_replay.ingest.records import (
    FOOTER,
    MAGIC,
    PRIVATE,
    RECORD,
    Buffer,
    Channel,
    Fields,
    MalformedRecordError,
    Opcode,
    Schema,
    crc_of,
    parse_channel,
    parse_place,
    parse_schema,
)

_FOOTER_CONTENT = FOOTER.size - RECORD.size
#: Index record -> the kind of record it points at.
_POINTS_AT = {
    Opcode.CHUNK_INDEX: Opcode.CHUNK,
    Opcode.ATTACHMENT_INDEX: Opcode.ATTACHMENT,
    Opcode.METADATA_INDEX: Opcode.METADATA,
}
_BELONGS = {
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
    Opcode.SUMMARY_OFFSET,
}


@dataclass(frozen=True, slots=True)
class Summary:
    """What a summary lends to the walk.

    `schemas` and `channels` by id, and `anchors`: offsets, in order, where a record surely starts.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    anchors: tuple[int, ...] = ()


def read_summary(buffer: Buffer) -> Summary:
    """Read the summary that the footer at the very end of the buffer points at.

    Returns
    -------
    Summary
        Empty where the file has no summary, or no footer in its place.

    Raises
    ------
    MalformedRecordError
        If there is a summary which cannot be trusted: its checksum or a record in it is wrong.
    """
    footer = len(buffer) - len(MAGIC) - FOOTER.size
    if footer < len(MAGIC) or buffer[footer + FOOTER.size :] != MAGIC:
        return Summary()
    opcode, length, start, _, crc = FOOTER.unpack(buffer[footer : footer + FOOTER.size])
    if opcode != Opcode.FOOTER or length != _FOOTER_CONTENT or start == 0:
        return Summary()
    if not len(MAGIC) <= start <= footer:
        raise MalformedRecordError(f"the footer points at byte {start}, outside of the file")
    # The checksum covers the summary and the footer up to itself.
    if crc and crc_of(buffer, start, footer + FOOTER.size - 4) != crc:
        raise MalformedRecordError(f"the summary at byte {start} does not match its checksum")
    return _read(buffer, start, footer)


def _read(buffer: Buffer, start: int, end: int) -> Summary:
    summary = Summary()
    anchors = {start}
    channels: list[Fields] = []
    position = start
    while position < end:
        opcode, fields = _record(buffer, position, end)
        position = fields.end
        if opcode == Opcode.SCHEMA:
            schema_id, schema = parse_schema(fields)
            summary.schemas[schema_id] = schema
        elif opcode == Opcode.CHANNEL:
            channels.append(fields)
        elif opcode in _POINTS_AT:
            place, length = parse_place(fields, skip=16 if opcode == Opcode.CHUNK_INDEX else 0)
            if buffer[place : place + RECORD.size] == RECORD.pack(
                _POINTS_AT[Opcode(opcode)], max(length - RECORD.size, 0)
            ):
                anchors.add(place)
    for fields in channels:
        _, channel = parse_channel(fields, summary.schemas)
        summary.channels[channel.id] = channel
    return Summary(summary.schemas, summary.channels, tuple(sorted(anchors)))


def _record(buffer: Buffer, position: int, end: int) -> tuple[int, Fields]:
    if position + RECORD.size > end:
        raise MalformedRecordError(f"the summary ends inside a record at byte {position}")
    opcode, length = RECORD.unpack(buffer[position : position + RECORD.size])
    content = position + RECORD.size
    # Private records are allowed anywhere; data records here mean that the footer points wrongly.
    if (opcode not in _BELONGS and opcode < PRIVATE) or length > end - content:
        raise MalformedRecordError(f"byte {position} of the summary begins no record of a summary")
    return opcode, Fields(buffer, content, content + length)
