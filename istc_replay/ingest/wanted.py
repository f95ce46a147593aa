"""Which fields of a message are wanted: paths of names, as a tree for the parsers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from istc_replay.ingest.payload import PayloadError


@dataclass(frozen=True, slots=True)
class Mapping:
    """Where a message tells what: paths (`a.b.0.c`) by what they tell (see `TARGETS`).

    `items` is the path of the repeated part that holds a vehicle each; empty: the message tells of
    one. With items, a path that starts with `/` counts from the message. A path that ends at a
    message gives all its plain fields.
    """

    fields: dict[str, str]
    items: str = ""
    absent_is_zero: bool = False  # a plain field left out of a message that is there is 0
    optional: frozenset[str] = frozenset()  # what a schema may lack


@dataclass(slots=True)
class Node:
    """A level of the tree: wanted fields by name, and the targets that end here."""

    children: dict[str, Node] = field(default_factory=dict)
    targets: list[str] = field(default_factory=list)
    items: bool = False  # the repeated part: its children are those of each item

    def every_target(self) -> set[str]:
        """Return the targets of this node and below."""
        return {*self.targets}.union(*(child.every_target() for child in self.children.values()))

    def at(self, path: str) -> Node:
        """Return the node at a path, made where it is not there yet."""
        node = self
        for name in filter(None, path.split(".")):
            node = node.children.setdefault(name, Node())
        return node


def tree(mapping: Mapping) -> Node:
    """Make the tree of a mapping."""
    root = Node()
    place = root.at(mapping.items)
    if mapping.items:
        place.items = True
    for target, path in mapping.fields.items():
        start = root if path.startswith("/") else place
        start.at(path.removeprefix("/")).targets.append(target)
    return root


def check_found(mapping: Mapping, kinds: Iterable[str]) -> None:
    """Check that every path of a mapping has led to plain fields.

    Raises
    ------
    PayloadError
        If a path leads to something else, such as an array.
    """
    found = {part for name in kinds for part in (name, name.partition(".")[0])}
    for target, path in mapping.fields.items():
        if target not in found and target not in mapping.optional:
            raise PayloadError(f"{path!r} is neither a plain field nor a message of plain fields", "schema")


def missing(mapping: Mapping, node: Node, path: str, known: Iterable[str]) -> None:
    """Pass over a field that the schema does not have, if all that it tells is optional.

    Raises
    ------
    PayloadError
        If it is not.
    """
    if not node.every_target() <= mapping.optional:
        names = ", ".join(list(known)[:12])
        raise PayloadError(f"the schema has no field {path!r}; it has {names}", "schema")
