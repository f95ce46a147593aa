"""The records of a file that are no messages: attachments, metadata, statistics, checksums, private ones."""

from __future__ import annotations

from collections.abc import Callable

from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.records import (
    PRIVATE,
    Attachment,
    Buffer,
    Fields,
    MalformedRecordError,
    Metadata,
    Opcode,
    Statistics,
    crc_of,
    parse_attachment,
    parse_metadata,
    parse_statistics,
)

#: Metadata and attachments held at once [bytes, records].
_HELD_BYTES = 128 * 2**20
_HELD_RECORDS = 10_000
_SKIPPED = frozenset(Opcode) - {Opcode.FOOTER}


#: Takes a private record: its opcode and its content.
TakePrivate = Callable[[int, bytes], None]


class Extras:
    """What a walk met beside messages; see the attributes of LogFile."""

    def __init__(self, buffer: Buffer, problems: Problems, private: TakePrivate | None) -> None:
        self._buffer, self._problems = buffer, problems
        self._take = private
        self.attachment_count = self.metadata_count = self.private_count = 0
        self.attachments: list[Attachment] = []
        self.metadata: list[Metadata] = []
        self.data_over = False
        self._begin = 0
        self._held = 0
        self._statistics: dict[int, Statistics] = {}

    def begin(self, position: int) -> None:
        """Begin a file, or another that is joined to its end."""
        self._begin, self.data_over = position, False

    def read(self, opcode: int, fields: Fields, offset: int) -> None:
        """Take in one record."""
        try:
            if opcode == Opcode.ATTACHMENT:
                self._attachment(fields, offset)
            elif opcode == Opcode.METADATA:
                self._metadata(fields, offset)
            elif opcode == Opcode.STATISTICS:
                self._statistics[self._begin] = parse_statistics(fields)
            elif opcode == Opcode.DATA_END:
                self._data_end(fields.uint(4), offset)
            elif opcode >= PRIVATE:
                self.private(opcode, fields)
            elif opcode not in _SKIPPED:
                self._problems.add("unknown_record", f"a record of kind {opcode} is not read", offset)
        except MalformedRecordError as error:
            self._problems.lose("record_damaged", f"a record of kind {opcode}: {error}", offset)

    def private(self, opcode: int, fields: Fields) -> None:
        """Hand on a private record, which only its writer can read."""
        self.private_count += 1
        if self._take is not None:
            self._take(opcode, bytes(fields.buffer[fields.position : fields.end]))

    def compare(self, messages: int, chunks: int) -> None:
        """Compare what was met with what the summary states."""
        if not self._statistics:
            return
        found = (messages, self.attachment_count, self.metadata_count, chunks)
        names = ("messages", "attachments", "metadata records", "chunks")
        # Files joined end to end have a summary each.
        parts = [(s.messages, s.attachments, s.metadata, s.chunks) for s in self._statistics.values()]
        for name, count, stated in zip(names, found, map(sum, zip(*parts, strict=True)), strict=True):
            if count != stated:
                detail = f"the summary states {stated} {name}, {count} were found"
                self._problems.lose("statistics", detail)

    def _attachment(self, fields: Fields, offset: int) -> None:
        start = fields.position
        attachment, crc = parse_attachment(fields)
        self.attachment_count += 1
        if crc and crc_of(self._buffer, start, attachment.start + attachment.size) != crc:
            detail = f"attachment {quoted(attachment.name)} does not match its checksum; it is left out"
            self._problems.lose("attachment_crc", detail, offset)
        elif self._may_hold(len(self.attachments), 0, offset):
            self.attachments.append(attachment)

    def _metadata(self, fields: Fields, offset: int) -> None:
        size = fields.end - fields.position
        self.metadata_count += 1
        if self._may_hold(len(self.metadata), size, offset):
            self._held += size
            self.metadata.append(parse_metadata(fields))

    def _may_hold(self, held: int, size: int, offset: int) -> bool:
        fits = held < _HELD_RECORDS and self._held + size <= _HELD_BYTES
        if not fits:
            self._problems.lose("too_many_records", "more attachments or metadata than are held", offset)
        return fits

    def _data_end(self, crc: int, offset: int) -> None:
        if crc and not self.data_over and crc_of(self._buffer, self._begin, offset) != crc:
            detail = f"bytes {self._begin} to {offset} do not match their checksum"
            self._problems.lose("data_crc", detail, offset)
        self.data_over = True
