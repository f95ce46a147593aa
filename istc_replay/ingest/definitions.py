"""The schemas and channels that a walk has met so far."""

from __future__ import annotations

from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.records import Channel, Fields, Opcode, Schema, parse_channel, parse_schema
from istc_replay.ingest.summary import Summary

#: Bytes of schemas and channels held at once.
_LIMIT = 128 * 2**20
#: Declarations of one kind that are read: each id once, and some that say another thing.
_DECLARATIONS = 2**16 + 2**14


class Definitions:
    """Schemas and channels by id; those of the summary stand in until the data declare them."""

    def __init__(self, problems: Problems, summary: Summary) -> None:
        self.channels: dict[int, Channel] = dict(summary.channels)
        self._schemas: dict[int, Schema] = dict(summary.schemas)
        self.schemas: dict[Schema, None] = dict.fromkeys(summary.schemas.values())
        self._declared: set[tuple[int, int]] = set()
        self._problems = problems
        self._held = 0
        self._left: dict[int, int] = {Opcode.SCHEMA: _DECLARATIONS, Opcode.CHANNEL: _DECLARATIONS}
        self._same: dict[tuple[int, int], int] = {}  # hashes of what was declared last, by kind and id

    def declare(self, opcode: int, fields: Fields, offset: int) -> None:
        """Take in a schema or channel record; the latest declaration of an id holds.

        Raises
        ------
        MalformedRecordError
            If its fields run past its end.
        """
        size = fields.end - fields.position
        raw = bytes(fields.buffer[fields.position : fields.end])
        key, known = (opcode, int.from_bytes(raw[:2], "little")), hash(raw)
        if self._same.get(key) == known:
            return
        if not self._left[opcode] or self._held + size > _LIMIT:
            self._refuse(key, offset)
            return
        self._left[opcode] -= 1
        new = self._schema(fields, offset) if opcode == Opcode.SCHEMA else self._channel(fields, offset)
        self._same[key] = known
        if new:
            self._held += size
        if fields.replaced:
            self._problems.add("not_utf8", "a name in a schema or channel is not UTF-8", offset)

    def _refuse(self, key: tuple[int, int], offset: int) -> None:
        """Leave a declaration out: what its id meant before holds no longer."""
        (self.channels if key[0] == Opcode.CHANNEL else self._schemas).pop(key[1], None)
        self._same.pop(key, None)
        self._problems.lose("too_many_definitions", "more schemas or channels than are held", offset)

    def _schema(self, fields: Fields, offset: int) -> bool:
        schema_id, schema = parse_schema(fields)
        new = self._schemas.get(schema_id) != schema
        if new and (Opcode.SCHEMA, schema_id) in self._declared:
            self._problems.add(
                "schema_conflict", f"schema {schema_id} is declared twice, differently", offset
            )
        self._schemas[schema_id] = schema
        self.schemas[schema] = None
        self._declared.add((Opcode.SCHEMA, schema_id))
        return new

    def _channel(self, fields: Fields, offset: int) -> bool:
        schema_id, channel = parse_channel(fields, self._schemas)
        known = self.channels.get(channel.id)
        new = known is None or not known.same_as(channel)
        if new:
            # What is the same stays the same object: messages are counted by it.
            self.channels[channel.id] = channel
            if (Opcode.CHANNEL, channel.id) in self._declared:
                detail = f"channel {channel.id} is declared twice: {quoted(channel.topic)} from here on"
                self._problems.add("channel_conflict", detail, offset)
            if schema_id and channel.schema is None:
                detail = f"channel {quoted(channel.topic)} names schema {schema_id}, which is not declared"
                self._problems.lose("missing_schema", detail, offset)
        self._declared.add((Opcode.CHANNEL, channel.id))
        return new
