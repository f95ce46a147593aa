"""Walking an MCAP file front to back, through whatever damage it has.

The rule: a message is given if its record is whole and, inside a chunk, if the chunk is whole and
its checksum holds. Everything else is left out and told as a problem. The summary is only a help:
it lends channels whose declarations are lost, and places where the walk can go on after damage.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Generator, Iterator
from pathlib import Path

import numpy as np

from istc_replay.datatypes import Problem
from istc_replay.errors import LogError
from istc_replay.ingest.batches import Batch, Ints, heads, rows
from istc_replay.ingest.chunk import chunk_records, indexed_positions
from istc_replay.ingest.definitions import Definitions
from istc_replay.ingest.extras import Extras, TakePrivate
from istc_replay.ingest.inflate import CHUNK_LIMIT, InflateError, Inflater
from istc_replay.ingest.problems import Problems
from istc_replay.ingest.records import (
    FOOTER,
    MAGIC,
    MESSAGE,
    PRIVATE,
    RECORD,
    Attachment,
    Buffer,
    Channel,
    Fields,
    MalformedRecordError,
    Message,
    Metadata,
    Opcode,
    Schema,
    parse_chunk,
    profile_of,
)
from istc_replay.ingest.source import map_file, other_format
from istc_replay.ingest.summary import Summary, read_summary
from istc_replay.ingest.tally import Tally, Wanted

#: Messages outside of chunks that make one batch [records, bytes].
_BATCH_RECORDS = 16_384
_BATCH_BYTES = 16 * 2**20
#: Records in chunks that are no messages: so many in a file, and one more for each 16 of its bytes.
_ODD_FLOOR = 300_000
_COLUMNS = ("channel", "sequence", "log_time", "publish_time")


def open_log(source: Path | bytes) -> LogFile:
    """Open an MCAP file, or its bytes, for walking.

    Raises
    ------
    LogError
        If there is nothing to walk: no such file, not a regular file, unreadable, or not MCAP.
    """
    if isinstance(source, bytes):
        return LogFile(source, "<bytes>")
    return LogFile(map_file(source), str(source))


class LogFile:
    """An open log. Walk it with `messages`; what the walk met stands in the attributes after it.

    Attributes
    ----------
    name : str
        The path, or `<bytes>`.
    size : int
        Bytes of the file.
    chunk_count : int
        Whole chunk records met.
    position : int
        The byte up to which the walk has come.
    """

    def __init__(self, buffer: Buffer, name: str) -> None:
        self.name = name
        self._buffer = buffer
        self.size = len(buffer)
        self._ends_well = self.size > len(MAGIC) and buffer[self.size - len(MAGIC) : self.size] == MAGIC
        head = buffer[: len(MAGIC)]
        if head != MAGIC and not self._ends_well:
            raise LogError(f"{name}: not an MCAP log: {other_format(buffer[:32])}")
        self._reset()

    def _reset(self, wants: Wanted | None = None, private: TakePrivate | None = None) -> None:
        self.position = self.chunk_count = self._odd = 0
        self._problems = Problems()
        self._tally = Tally(self._problems, wants)
        self._extras = Extras(self._buffer, self._problems, private)
        self._schemas: dict[Schema, None] = {}
        self._summary = Summary()
        self._inflater = Inflater(self.size, self._problems)
        self._definitions = Definitions(self._problems, self._summary)

    @property
    def profile(self) -> str:
        """The profile that the header states."""
        return profile_of(self._buffer)

    @property
    def message_count(self) -> int:
        """Whole messages met."""
        return self._tally.messages

    @property
    def counts(self) -> dict[Channel, int]:
        """Every channel met, and the number of its messages, wanted or not."""
        return self._tally.counts

    @property
    def spans(self) -> dict[Channel, tuple[int, int]]:
        """The first and last log time of every channel that has messages [ns], unsigned."""
        return self._tally.spans

    @property
    def start_ns(self) -> int | None:
        """The first log time that fits int64 [ns]; None without messages."""
        return self._tally.start_ns

    @property
    def end_ns(self) -> int | None:
        """The last log time that fits int64 [ns]."""
        return self._tally.end_ns

    @property
    def attachment_count(self) -> int:
        """Whole attachments met."""
        return self._extras.attachment_count

    @property
    def metadata_count(self) -> int:
        """Whole metadata records met."""
        return self._extras.metadata_count

    @property
    def private_count(self) -> int:
        """Private records met (opcodes from 0x80)."""
        return self._extras.private_count

    @property
    def schemas(self) -> list[Schema]:
        """Every schema met, whether or not a channel names it."""
        return list(self._schemas)

    @property
    def attachments(self) -> list[Attachment]:
        """The first 10 000 attachments; `attachment_data` reads one."""
        return self._extras.attachments

    @property
    def metadata(self) -> list[Metadata]:
        """The first 10 000 metadata records."""
        return self._extras.metadata

    @property
    def complete(self) -> bool:
        """The file ends as it should and, as far as it was walked, nothing in it was left out."""
        return not self._problems.lost

    @property
    def problems(self) -> tuple[Problem, ...]:
        """What the walk found damaged or left out."""
        return self._problems.found()

    def sha256(self) -> str:
        """Hash the file; hexadecimal."""
        return hashlib.sha256(self._buffer).hexdigest()

    def attachment_data(self, attachment: Attachment) -> bytes:
        """Read the data of one of the attachments."""
        return self._buffer[attachment.start : attachment.start + attachment.size]

    def messages(self, wanted: Wanted | None = None, private: TakePrivate | None = None) -> Iterator[Message]:
        """Walk as `batches` does, and give the messages one by one."""
        for batch in self.batches(wanted, private):
            yield from batch.messages()

    def batches(self, wanted: Wanted | None = None, private: TakePrivate | None = None) -> Iterator[Batch]:
        """Walk the file from its start and give the messages in file order, by the chunk.

        Parameters
        ----------
        wanted : callable, optional
            Which channels' messages to give, asked once a channel; all without it.
        private : callable, optional
            Handed the private records on the way, opcode and content.

        Yields
        ------
        Batch
            The messages whose records, and chunk, are whole.
        """
        self._reset(wanted, private)
        self._read_summary()
        if self._buffer[: len(MAGIC)] != MAGIC:
            self._problems.add(
                "no_magic", "the file does not begin with MCAP's magic bytes, but ends with them", 0
            )
        begin: int | None = 0
        while begin is not None:
            begin = yield from self._segment(begin)
            self._tally.declared(self._definitions.channels)
            self._schemas |= dict.fromkeys(self._definitions.schemas)
            # A file joined to the end of another has its own channels.
            self._definitions = Definitions(self._problems, Summary())
        self._extras.compare(self.message_count, self.chunk_count)

    def _read_summary(self) -> None:
        try:
            self._summary = read_summary(self._buffer)
            self._definitions = Definitions(self._problems, self._summary)
        except MalformedRecordError as error:
            self._problems.add(
                "summary_damaged", f"{error}; the summary is not used", self.size - len(MAGIC) - FOOTER.size
            )

    # --- the walk ----------------------------------------------------------------------------

    def _segment(self, begin: int) -> Generator[Batch, None, int | None]:
        """Walk one MCAP file; returns where the next begins, if another is joined to its end."""
        self._extras.begin(begin)
        position: int | None = begin + len(MAGIC)
        loose: list[int] = []  # messages outside of chunks
        while position is not None:
            head = self._head(position)
            if head is not None and head[0] == Opcode.MESSAGE:
                loose.append(position)
                position = head[2]
                if len(loose) < _BATCH_RECORDS and position - loose[0] < _BATCH_BYTES:
                    continue
            if loose:
                yield from self._batch(self._buffer, loose, None)
                loose = []
            if head is None:
                position = self._next_anchor(position)
                continue
            opcode, start, end = head
            self.position = end
            if opcode == Opcode.CHUNK:
                yield from self._chunk(start, end, position)
            elif opcode == Opcode.FOOTER and self._ends_at(end):
                return self._after(end)
            elif opcode != Opcode.MESSAGE:
                self._other(opcode, start, end, position)
            position = end
        return None

    def _head(self, position: int) -> tuple[int, int, int] | None:
        """Opcode, start and end of the content of the record at position; None where there is none."""
        left = self.size - position
        if left < RECORD.size:
            self._cut("the file ends without a footer", position)
            return None
        opcode, length = RECORD.unpack_from(self._buffer, position)
        start = position + RECORD.size
        if length > self.size - start:
            self._cut(f"a record of {length} bytes where the file has {self.size - start} left", position)
            return None
        anchor = self._next_anchor(position)
        if opcode == 0 or (anchor is not None and start + length > anchor):
            detail = f"no record begins here (kind {opcode}, {length} bytes)"
            self._problems.lose("record_damaged", f"{detail}; the walk goes on at byte {anchor}", position)
            return None
        return opcode, start, start + length

    def _cut(self, detail: str, position: int) -> None:
        # A file that still ends with the magic was not cut: a length in it is wrong.
        self._problems.lose("record_damaged" if self._ends_well else "truncated", detail, position)

    def _next_anchor(self, position: int) -> int | None:
        index = bisect_right(self._summary.anchors, position)
        return self._summary.anchors[index] if index < len(self._summary.anchors) else None

    def _ends_at(self, end: int) -> bool:
        left = self.size - end
        return left <= len(MAGIC) or self._buffer[end : end + len(MAGIC)] == MAGIC

    def _after(self, end: int) -> int | None:
        """Judge what follows a footer; returns where another file begins there."""
        if not self._extras.data_over:
            self._problems.add("no_data_end", "the data section is not closed by a data end record", end)
        rest = end + len(MAGIC)
        if self.size < rest:
            self._problems.lose("truncated", "the file ends inside the magic bytes after its footer", end)
        elif self._buffer[end:rest] != MAGIC:
            self._problems.add("no_magic", "the file does not end with MCAP's magic bytes", end)
        if self.size <= rest:
            return None
        if self._buffer[rest : rest + len(MAGIC)] == MAGIC:
            self._problems.add(
                "joined_files", "another MCAP file begins after the end of this one; both are read", rest
            )
            return rest
        self._problems.add(
            "trailing_bytes", f"{self.size - rest} bytes after the end of the file are not read", rest
        )
        return None

    def _chunk(self, start: int, end: int, offset: int) -> Iterator[Batch]:
        self.chunk_count += 1
        try:
            chunk = parse_chunk(Fields(self._buffer, start, end))
            data = self._inflater.records(self._buffer, chunk, offset)
        except InflateError as error:
            self._problems.lose(error.code, f"{error}; the chunk is left out", offset)
            return
        except MalformedRecordError as error:
            self._problems.lose("chunk_damaged", f"{error}; the chunk is left out", offset)
            return
        try:
            hint = indexed_positions(self._buffer, end, self.size, len(data))
            for opcode, places in chunk_records(data, hint):
                if opcode == Opcode.MESSAGE:
                    yield from self._batch(data, places, offset)
                    continue
                self._odd += 1
                if self._odd > _ODD_FLOOR + self.size // 16:
                    raise MalformedRecordError("too many records that are no messages")
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._definitions.declare(opcode, Fields(data, *places), offset)
                else:
                    detail = f"record kind {opcode} inside a chunk is not read"
                    self._problems.add("unexpected_record", detail, offset)
                    if opcode >= PRIVATE:
                        self._extras.private(opcode, Fields(data, *places))
        except MalformedRecordError as error:
            self._problems.lose("chunk_damaged", f"{error}; the rest of the chunk is left out", offset)

    def _batch(self, buffer: Buffer, messages: list[int] | Ints, offset: int | None) -> Iterator[Batch]:
        """Count the message records at these positions and give the wanted ones.

        offset is the chunk's; None where the positions are those in the file.
        """
        data = np.frombuffer(buffer, np.uint8)
        positions = np.asarray(messages, np.int64)
        lengths = rows(data, positions + 1, 8).view("<u8").reshape(-1)
        whole = (lengths >= MESSAGE.size) & (lengths <= MESSAGE.size + CHUNK_LIMIT)
        if not whole.all():
            for row in np.flatnonzero(~whole).tolist():
                detail = f"a message record of {lengths[row]} bytes"
                place = int(positions[row]) if offset is None else offset
                self._problems.lose("record_damaged", detail, place)
            positions, lengths = positions[whole], lengths[whole]
            if not len(positions):
                return
        head = heads(data, positions)
        offsets = positions if offset is None else np.full(len(positions), offset, np.int64)
        declared = self._definitions.channels
        channels, all_ = self._tally.count(head["channel"], head["log_time"], offsets, declared)
        if not all_:
            given = np.isin(head["channel"], list(channels))
            head, positions, offsets, lengths = head[given], positions[given], offsets[given], lengths[given]
        if len(head):
            starts = positions + RECORD.size + MESSAGE.size
            ends = positions + RECORD.size + lengths.astype(np.int64)
            ids, sequences, log_ns, publish_ns = (head[name] for name in _COLUMNS)
            yield Batch(buffer, channels, ids, sequences, log_ns, publish_ns, starts, ends, offsets)

    # --- records that are not messages ---------------------------------------------------------

    def _other(self, opcode: int, start: int, end: int, offset: int) -> None:
        fields = Fields(self._buffer, start, end)
        if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._extras.read(opcode, fields, offset)
        elif not self._extras.data_over:  # after that, the summary says it again
            try:
                self._definitions.declare(opcode, fields, offset)
            except MalformedRecordError as error:
                self._problems.lose("record_damaged", f"a record of kind {opcode}: {error}", offset)
