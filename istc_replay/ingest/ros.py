"""Parsing ROS payloads: CDR as ROS 2 writes it, and the serialisation of ROS 1."""

from __future__ import annotations

import struct

from istc_replay.ingest.definition import PLAIN, Member, Types
from istc_replay.ingest.layout import Decoder, Layout, Leaf
from istc_replay.ingest.payload import Budget, PayloadError
from istc_replay.ingest.wanted import Mapping, Node, check_found, missing, tree

#: Parts of one payload, and levels of types in types, that are parsed.
_PARTS = 50_000
_DEPTH = 24


def ros_decoder(types: Types, mapping: Mapping, ros1: bool, budget: Budget) -> Decoder:
    """Make a decoder of payloads by their definition.

    Raises
    ------
    PayloadError
        If the definition does not have a field that the mapping names.
    """
    root = tree(mapping)
    kinds: dict[str, str] = {}
    _Resolver(types, mapping, kinds).resolve("", root, "", _DEPTH)
    check_found(mapping, kinds)
    flat = _flat_types(types)
    many = bool(mapping.items)

    def parse(payload: bytes) -> Layout:
        budget.check()
        reading = _Payload(types, flat, payload, ros1)
        try:
            return reading.layout(root, many)
        finally:
            budget.spend(3 * reading.parts)  # each costs as much as three of protobuf's

    return Decoder(parse, kinds)


def _flat_types(types: Types) -> dict[str, int]:
    """Return the types whose values all have one length, but for padding, by their alignment."""
    alignments: dict[str, int] = {}  # 0: not flat, or in a circle

    def alignment(name: str, depth: int) -> int:
        if name in alignments or depth == 0:
            return alignments.get(name, 0)
        alignments[name] = 0
        parts = [1]
        for member in types.get(name, (Member("", "", -1),)):
            plain = PLAIN.get(member.type)
            parts.append(
                0 if member.length == -1 else int(plain[1]) if plain else alignment(member.type, depth - 1)
            )
        alignments[name] = max(parts) if all(parts) else 0
        return alignments[name]

    return {name: found for name in types if (found := alignment(name, _DEPTH))}


class _Resolver:
    """Checks the wanted paths against the types, and notes the kinds of their leaves."""

    def __init__(self, types: Types, mapping: Mapping, kinds: dict[str, str]) -> None:
        self._types, self._mapping, self._kinds = types, mapping, kinds

    def resolve(self, name: str, node: Node, where: str, depth: int) -> None:
        if depth == 0:
            raise PayloadError("the types of the message definition nest too deeply", "schema")
        members = {member.name: member for member in self._types.get(name, ())}
        for child_name, child in node.children.items():
            path = f"{where}{child_name}"
            member = members.get(child_name)
            if member is None:
                missing(self._mapping, child, path, members)
            elif member.length is not None and not child.items and child.children:
                for index, element in child.children.items():
                    if not index.isdigit():
                        raise PayloadError(f"{path!r} is repeated: name an item, as {path}.0", "schema")
                    self._one(member._replace(length=None), element, f"{path}.{index}", depth)
            else:
                self._one(member._replace(length=None) if child.items else member, child, path, depth)

    def _one(self, member: Member, node: Node, path: str, depth: int) -> None:
        code = _kind(member)
        if code:
            if node.children:
                raise PayloadError(f"{path!r} is plain: it has no fields", "schema")
            self._kinds.update(dict.fromkeys(node.targets, code))
            return
        for inner in self._types.get(member.type, ()) if member.length is None else ():
            if node.targets and _kind(inner):
                child = node.children.setdefault(inner.name, Node())
                child.targets += [f"{target}.{inner.name}" for target in node.targets]
        node.targets.clear()
        self.resolve(member.type, node, f"{path}.", depth - 1)


def _kind(member: Member) -> str:
    """Kind of a plain member; empty where it is a message, or many."""
    if member.length is None:
        return "text" if member.type == "string" else PLAIN.get(member.type, "")
    return "bytes" if member.type in ("byte", "char", "uint8") and member.length > 0 else ""


class _Payload:
    """One payload being parsed."""

    def __init__(self, types: Types, flat: dict[str, int], data: bytes, ros1: bool) -> None:
        self._types, self._flat, self._data, self._ros1 = types, flat, data, ros1
        self._layout = Layout(len(data))
        self._order, self._position, self._base = "<", 0, 0
        self._left = _PARTS
        self._header: dict[str, Leaf] = {}

    @property
    def parts(self) -> int:
        """How many parts were parsed."""
        return _PARTS - self._left

    def layout(self, root: Node, items: bool) -> Layout:
        if not self._ros1:
            head = self._data[:4]
            if len(head) < 4 or head[0] != 0 or head[1] not in (0, 1):
                raise PayloadError("not plain CDR: its first bytes are " + head.hex(" "))
            self._order = "<" if head[1] else ">"
            self._layout.fix(0, 2)
            self._position = self._base = 4
        self._struct("", root, self._header, _DEPTH)
        found = self._layout
        found.items = [{**self._header, **item} for item in found.items] if items else [self._header]
        return found

    def _struct(self, name: str, node: Node | None, leaves: dict[str, Leaf], depth: int) -> None:
        if depth == 0:
            raise PayloadError("the payload nests too deeply")
        if name not in self._types:
            raise PayloadError(f"the message definition does not declare {name!r}", "schema")
        members = self._types[name]
        if not members and not self._ros1:
            self._skip(1, 1)  # ROS 2 gives an empty message one byte
        for member in members:
            self._member(member, node.children.get(member.name) if node else None, leaves, depth)

    def _member(self, member: Member, node: Node | None, leaves: dict[str, Leaf], depth: int) -> None:
        self._step(1)
        if member.length is None:
            self._one(member, node, leaves, depth)
            return
        count = self._length() if member.length < 0 else member.length
        code = PLAIN.get(member.type)
        if code and (node is None or not node.children):
            size = int(code[1])
            start = self._skip(size * count, 1 if self._ros1 or not count else size)
            for target in node.targets if node else ():
                leaves[target] = Leaf("bytes", start, size * count)
            return
        if count > len(self._data):
            raise PayloadError(f"a sequence of {count} parts in {len(self._data)} bytes")
        single = Member(member.name, member.type, None)
        alike = member.type in self._flat and (node is None or not (node.children or node.items))
        for index in range(count):
            self._step(1)
            before = self._position
            if node is not None and node.items:
                item: dict[str, Leaf] = {}
                self._one(single, node, item, depth)
                self._layout.items.append(item)
            else:
                self._one(single, node.children.get(str(index)) if node else None, leaves, depth)
            if alike and (self._ros1 or (self._position - before) % self._flat[member.type] == 0):
                # Aligned as this one is, all that follow are as long.
                self._skip((count - index - 1) * (self._position - before), 1)
                return

    def _one(self, member: Member, node: Node | None, leaves: dict[str, Leaf], depth: int) -> None:
        code = PLAIN.get(member.type)
        if code:
            size = int(code[1])
            leaf = Leaf(self._order + code, self._skip(size, 1 if self._ros1 else size), size)
        elif member.type == "string":
            leaf = self._string()
        elif member.type == "wstring":
            raise PayloadError("wide strings are not read", "schema")
        else:
            self._struct(member.type, node, leaves, depth - 1)
            return
        for target in node.targets if node else ():
            leaves[target] = leaf

    def _string(self) -> Leaf:
        size = self._length()
        start = self._skip(size, 1)
        return Leaf("text", start, size if self._ros1 else max(size - 1, 0))  # without the zero behind it

    def _length(self) -> int:
        start = self._skip(4, 1 if self._ros1 else 4)
        self._layout.fix(start, start + 4)
        return int(struct.unpack_from(f"{self._order}I", self._data, start)[0])

    def _skip(self, size: int, align: int) -> int:
        """Pass over size bytes, aligned; returns where they start."""
        start = self._base + -(-(self._position - self._base) // align) * align
        if start + size > len(self._data):
            raise PayloadError(f"a field of {size} bytes at byte {start} of {len(self._data)}")
        self._position = start + size
        return start

    def _step(self, count: int) -> None:
        self._left -= count
        if self._left < 0:
            raise PayloadError(f"more than {_PARTS} parts in one payload")
