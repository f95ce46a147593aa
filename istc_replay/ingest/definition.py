"""ROS message definitions: `ros1msg` and `ros2msg` texts as the types that they declare."""

from __future__ import annotations

import re
from typing import NamedTuple

from istc_replay.ingest.payload import PayloadError

#: Longest definition that is parsed [bytes].
_LIMIT = 2**18
#: Plain types: numpy code without byte order.
PLAIN = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
_TYPE = re.compile(r"^([\w/]+)(?:<=\d+)?(\[(?:<=)?\d*\])?$")
_SEPARATOR = re.compile(r"^={3,}\s*$", re.MULTILINE)


class Member(NamedTuple):
    """A field of a type; `length` is None (one), -1 (a sequence) or the length of an array."""

    name: str
    type: str
    length: int | None


Types = dict[str, tuple[Member, ...]]
_TIME = (Member("sec", "uint32", None), Member("nanosec", "uint32", None))
_DURATION = (Member("sec", "int32", None), Member("nanosec", "int32", None))


def parse_definition(text: bytes, ros1: bool) -> Types:
    """Parse a definition; the message itself has the name `""`.

    Raises
    ------
    PayloadError
        If the text is too long, or a line of it is no field.
    """
    if len(text) > _LIMIT:
        raise PayloadError(f"a message definition of {len(text)} bytes is not read", "schema")
    types: Types = {"time": _TIME, "duration": _DURATION} if ros1 else {}
    parts = _SEPARATOR.split(text.decode("utf-8", "replace").replace("\r\n", "\n"))
    for index, part in enumerate(parts):
        name, lines = "", part.strip().splitlines()
        if index:
            if not lines or not lines[0].startswith("MSG:"):
                raise PayloadError("a part of the message definition has no name", "schema")
            name = _last(lines.pop(0)[4:].strip())
        types[name] = tuple(member for line in lines if (member := _member(line)))
    return types


def _member(line: str) -> Member | None:
    words = line.partition("#")[0].split()
    if not words:
        return None
    if len(words) > 1 and ("=" in words[1] or (len(words) > 2 and words[2].startswith("="))):
        return None  # a constant
    match = _TYPE.match(words[0])
    if len(words) < 2 or match is None:
        raise PayloadError(f"no field of a message: {line.strip()[:80]!r}", "schema")
    array = match[2]
    length = None if array is None else int(array[1:-1]) if array[1:-1].isdigit() else -1
    return Member(words[1], _last(match[1]), length)


def _last(name: str) -> str:
    # Types are told apart by their last name: `std_msgs/msg/Header`, `std_msgs/Header`, `Header`.
    return name.rpartition("/")[2]
