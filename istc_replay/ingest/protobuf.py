"""Parsing protobuf payloads along their descriptor: wanted fields alone, the rest passed over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError, EncodeError

from istc_replay.ingest.batches import Bytes, Ints
from istc_replay.ingest.layout import NULL, ZERO, Column, Decoded, Decoder, Layout, Leaf, joined_parts, take
from istc_replay.ingest.payload import ITEMS_AT_ONCE, Budget, PayloadError, TooManyItemsError, TooMuchError
from istc_replay.ingest.scan import FIELDS_LIMIT, Spans, next_field, scan
from istc_replay.ingest.wanted import Mapping, Node, check_found, missing, tree

#: Fields of one message that are parsed.
_FIELDS = 100_000
#: Descriptor's type number -> kind of leaf and wire type.
_KINDS = {
    1: ("<f8", 1),
    2: ("<f4", 5),
    3: ("int", 0),
    4: ("varint", 0),
    5: ("int", 0),
    6: ("<u8", 1),
    7: ("<u4", 5),
    8: ("varint", 0),
    9: ("text", 2),
    12: ("bytes", 2),
    13: ("varint", 0),
    14: ("int", 0),
    15: ("<i4", 5),
    16: ("<i8", 1),
    17: ("zigzag", 0),
    18: ("zigzag", 0),
}
_MESSAGE = 11
#: Items of one message that are decoded.
_ITEMS = 20_000
#: What reading a foreign descriptor can raise.
_FOREIGN = (AttributeError, KeyError, TypeError, ValueError)


@dataclass(slots=True)
class _Plan:
    """What to do with the fields of one message, by number."""

    leaves: dict[int, tuple[str, int, int, list[str]]] = field(default_factory=dict)
    inner: dict[int, _Plan] = field(default_factory=dict)
    repeated: dict[int, dict[int, _Plan]] = field(default_factory=dict)


class ProtobufDecoder:
    """Decodes payloads of one message type; has the interface of Decoder.

    Repeated items are found in all payloads at once, then decoded as payloads of their own, and so
    are the parts of the message beside them: neither their number nor the length of one makes the
    layout of another differ.
    """

    def __init__(self, type_: Any, mapping: Mapping, budget: Budget) -> None:
        self._type = type_
        self._budget = budget
        self._mapping = mapping
        self._zero = mapping.absent_is_zero
        self._watched: dict[int, Callable[[Bytes, Spans], None]] = {}
        self.kinds: dict[str, str] = {}
        root = tree(mapping)
        self._way: list[int] = []
        self._header: dict[int, dict[int, Decoder]] = {}
        self._items = self._level(
            type_.DESCRIPTOR, root, 0, mapping.items.split(".") if mapping.items else []
        )
        check_found(mapping, self.kinds)

    def _level(self, descriptor: Any, node: Node, depth: int, way: list[str]) -> Decoder:
        """Make the decoders of the header on the way to the items; returns that of the items."""
        if not way:
            return self._decoder(descriptor, node)
        for name, child in node.children.items():
            declared = descriptor.fields_by_name.get(name)
            if declared is None:
                missing(self._mapping, child, f"{descriptor.name}.{name}", descriptor.fields_by_name)
            elif name == way[0]:
                if declared.type != _MESSAGE or declared.is_repeated != (len(way) == 1):
                    what = "repeated" if len(way) == 1 else "one message"
                    raise PayloadError(f"items: {name!r} of {descriptor.full_name} is not {what}", "schema")
                self._way.append(declared.number)
            else:
                # The header's fields are decoded as if each were a message with that field alone.
                alone = Node({name: child})
                self._header.setdefault(depth, {})[declared.number] = self._decoder(descriptor, alone)
        if way[0] not in descriptor.fields_by_name:
            raise PayloadError(f"{descriptor.full_name} has no field {way[0]!r}", "schema")
        inner = descriptor.fields_by_name[way[0]].message_type
        return self._level(inner, node.children[way[0]], depth + 1, way[1:])

    def _decoder(self, descriptor: Any, node: Node) -> Decoder:
        kinds: dict[str, str] = {}
        plan = self._plan(descriptor, node, kinds)
        self.kinds.update(kinds)
        return Decoder(lambda payload: _parse(payload, plan, self._budget), kinds)

    def _plan(self, descriptor: Any, node: Node, kinds: dict[str, str]) -> _Plan:
        plan = _Plan()
        for name, child in node.children.items():
            declared = descriptor.fields_by_name.get(name)
            if declared is None:
                missing(self._mapping, child, f"{descriptor.name}.{name}", descriptor.fields_by_name)
                continue
            number = declared.number
            if not declared.is_repeated:
                self._one(declared, child, plan, kinds)
                continue
            if declared.type != _MESSAGE or not all(index.isdigit() for index in child.children):
                raise PayloadError(f"{name!r} is repeated: name an item, as {name}.0", "schema")
            for index, element in child.children.items():
                inside = self._plan(declared.message_type, _spread(declared, element), kinds)
                plan.repeated.setdefault(number, {})[int(index)] = inside
        return plan

    def _one(self, declared: Any, child: Node, plan: _Plan, kinds: dict[str, str]) -> None:
        if declared.type == _MESSAGE:
            plan.inner[declared.number] = self._plan(declared.message_type, _spread(declared, child), kinds)
            return
        if declared.type not in _KINDS or child.children:
            raise PayloadError(f"{declared.name!r} is not a message", "schema")
        kind, wire = _KINDS[declared.type]
        absent = NULL if declared.has_presence and not self._zero else ZERO
        plan.leaves[declared.number] = (kind, wire, absent, child.targets)
        kinds.update(dict.fromkeys(child.targets, kind))

    def decode(self, data: Bytes, starts: Ints, ends: Ints) -> Decoded:
        """Decode the payloads that these spans of data hold; data must go on for 16 bytes after."""
        decoded = self._decode(data, starts, ends)
        if not decoded.bad:
            return decoded
        # The reference library judges what could not be parsed, and writes it in the plain way.
        parts = [(decoded.rows, decoded.columns)]
        bad: list[tuple[int, PayloadError]] = []
        for row, error in decoded.bad:
            if isinstance(error, TooMuchError):
                bad.append((row, error))
                continue
            try:
                plain = self._plain(data[starts[row] : ends[row]].tobytes())
                alone = self._decode(*plain)
                if alone.bad:
                    raise alone.bad[0][1]
                parts.append((np.full(len(alone.rows), row), alone.columns))
            except PayloadError as error:
                bad.append((row, error))
        return joined_parts(parts, bad, self.kinds)

    def watch(self, name: str, take_in: Callable[[Bytes, Spans], None]) -> None:
        """Hand over the spans of another repeated field, one beside the items."""
        descriptor = self._type.DESCRIPTOR
        for part in self._mapping.items.split(".")[:-1]:
            descriptor = descriptor.fields_by_name[part].message_type
        if name in descriptor.fields_by_name:
            self._watched[descriptor.fields_by_name[name].number] = take_in

    def _plain(self, payload: bytes) -> tuple[Bytes, Ints, Ints]:
        name = self._type.DESCRIPTOR.full_name
        try:
            plain = self._type.FromString(payload).SerializeToString()
        except (DecodeError, EncodeError, *_FOREIGN) as error:
            reason = " ".join(str(error).split())[:200]
            raise PayloadError(f"not an {name}: {reason}") from None
        data = np.frombuffer(plain + bytes(16), np.uint8)
        return data, np.zeros(1, np.int64), np.full(1, len(plain))

    def _decode(self, data: Bytes, starts: Ints, ends: Ints) -> Decoded:
        if not self._way:
            return self._items.decode(data, starts, ends)
        bad: dict[int, PayloadError] = {}
        header: dict[str, Column] = {}
        spans = Spans(np.arange(len(starts)), starts, starts, ends)
        for depth, number in enumerate(self._way):
            wanted = self._header.get(depth, {})
            watched = self._watched if depth == len(self._way) - 1 else {}
            found, broken = scan(data, spans, {number, *wanted, *watched}, self._budget)
            for other, take_in in watched.items():
                take_in(data, found[other])
            for row in broken.tolist():
                # So long a one may have too many fields for the reference library as well.
                kind = TooMuchError if ends[row] - starts[row] > 2 * FIELDS_LIMIT else PayloadError
                bad[row] = kind("a field of it is damaged, or there are too many")
            for other, decoder in wanted.items():
                header |= _header(data, found[other], decoder, len(starts), bad)
            spans = found[number]
            if depth < len(self._way) - 1:
                bad |= _twice(spans.rows)
        many = np.flatnonzero(np.bincount(spans.rows, minlength=1) > _ITEMS)
        if len(many):
            bad |= {row: TooMuchError(f"it has more than {_ITEMS} items") for row in many.tolist()}
            few = ~np.isin(spans.rows, many)
            spans = Spans(*(column[few] for column in spans))
        if len(spans.rows) > ITEMS_AT_ONCE and len(starts) > 1:
            raise TooManyItemsError(max(ITEMS_AT_ONCE * len(starts) // len(spans.rows), 1))
        items = self._items.decode(data, spans.starts, spans.ends)
        bad |= {int(spans.rows[row]): error for row, error in items.bad}
        rows = spans.rows[items.rows]
        index = np.flatnonzero(~np.isin(rows, list(bad))) if bad else np.arange(len(rows))
        rows = rows[index]
        columns = (
            {name: take(column, index) for name, column in items.columns.items()} if bad else items.columns
        )
        columns = columns | {name: take(column, rows) for name, column in header.items()}
        return Decoded(rows, columns, sorted(bad.items(), key=lambda entry: entry[0]))


def _header(
    data: Bytes, found: Spans, decoder: Decoder, count: int, bad: dict[int, PayloadError]
) -> dict[str, Column]:
    """Decode one field of the messages' own, a row each of count; left out where it is nowhere."""
    starts = ends = np.zeros(count, np.int64)
    starts, ends = starts.copy(), ends.copy()
    starts[found.rows], ends[found.rows] = found.tags, found.ends
    bad |= _twice(found.rows)
    decoded = decoder.decode(data, starts, ends)
    bad |= dict(decoded.bad)
    index = np.zeros(count, np.int64)
    index[decoded.rows] = np.arange(len(decoded.rows))
    if not len(decoded.rows):
        return {}
    return {name: take(column, index) for name, column in decoded.columns.items()}


def _twice(rows: Ints) -> dict[int, PayloadError]:
    """Rows of messages that hold twice what they may hold once; protobuf merges these."""
    values, counts = np.unique(rows, return_counts=True)
    return {row: PayloadError("a part of it stands twice") for row in values[counts > 1].tolist()}


def _spread(declared: Any, node: Node) -> Node:
    """Turn targets at a message into targets at its plain fields."""
    if not node.targets:
        return node
    spread = Node({name: Node(dict(c.children), list(c.targets)) for name, c in node.children.items()})
    for inner in declared.message_type.fields:
        if inner.type in _KINDS and not inner.is_repeated:
            child = spread.children.setdefault(inner.name, Node())
            child.targets += [f"{target}.{inner.name}" for target in node.targets]
    return spread


def _parse(payload: bytes, plan: _Plan, budget: Budget) -> Layout:
    budget.check()
    layout = Layout(len(payload))
    leaves: dict[str, Leaf] = {}
    try:
        _parse_message(payload, 0, len(payload), plan, layout, leaves)
    finally:
        budget.spend(len(layout.fixed) + 1)
    layout.items = [leaves]
    return layout


def _parse_message(
    data: bytes, position: int, end: int, plan: _Plan, layout: Layout, leaves: dict[str, Leaf]
) -> None:
    """Parse one message and note its deciding bytes: tags, lengths, and how long varints are."""
    seen: dict[int, int] = {}
    for kind, _, absent, targets in plan.leaves.values():
        leaves.update(dict.fromkeys(targets, Leaf(kind, absent)))
    left = _FIELDS
    while position < end:
        number, wire, start, after = next_field(data, position, end)
        left -= 1
        if after < 0 or left < 0:
            raise PayloadError("a field of it is damaged" if after < 0 else "it has too many fields")
        seen[number] = seen.get(number, 0) + 1
        if wire == 0:
            layout.fix(start, after, 0x80)
        layout.fix(position, start)
        leaf = plan.leaves.get(number)
        inner = plan.inner.get(number) or plan.repeated.get(number, {}).get(seen[number] - 1)
        if leaf and wire == leaf[1]:
            for target in leaf[3]:
                leaves[target] = Leaf(leaf[0], start, after - start)
        elif inner and wire == 2:
            if number in plan.inner and seen[number] > 1:
                raise PayloadError("a part of it stands twice")
            _parse_message(data, start, after, inner, layout, leaves)
        position = after
