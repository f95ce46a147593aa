"""Reading XML as a stream: bounded in memory, and deaf to what makes XML dangerous."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, NoReturn, Protocol
from xml.parsers import expat

from istc_replay.errors import LogError

_PIECE, _HEAD = 2**18, 2**14
#: Elements in elements, characters of one element's text, bytes of one tag.
_DEPTH, _TEXT, _TAG = 64, 2**20, 2**22
#: What a compressed file may inflate to: so many bytes, and so many for each byte of it.
_INFLATED_FLOOR, _INFLATED_RATIO = 4 * 2**20, 40
_GZIP = b"\x1f\x8b"

Progress = Callable[[int, int], None]


class Handler(Protocol):
    """Takes in the elements of a file as they come."""

    def start(self, path: tuple[str, ...], attributes: dict[str, str], line: int, /) -> None:
        """Take in an element's start; path holds the names from the root down to it."""

    def end(self, path: tuple[str, ...], text: str, line: int, /) -> None:
        """Take in an element's end, and the text directly in it."""


def head_of(path: Path) -> tuple[str, str]:
    """Return the name of a file's outermost element, empty if it is no XML, and its first characters.

    Raises
    ------
    LogError
        If it declares entities, or begins with a tag or comment without an end.
    """
    found: list[str] = []
    parser = _parser()
    parser.StartElementHandler = lambda name, _: found.append(name)
    head = b""
    try:
        with path.open("rb") as raw:
            for piece in _pieces(raw, path.stat().st_size):
                head += piece[: _HEAD - len(head)]
                parser.Parse(piece, False)
                if found:
                    break
                if raw.tell() > _TAG:
                    raise _RefusedError(f"a tag or comment of more than {_TAG} bytes")
    except _RefusedError as error:
        raise LogError(f"{path}: line {parser.CurrentLineNumber}: {error}") from None
    except (expat.ExpatError, zlib.error, OSError):
        pass
    return (found[0] if found else ""), head.decode("utf-8", "replace")


def read_xml(path: Path, handler: Handler, progress: Progress) -> str:
    """Read a file, plain or compressed by gzip, element by element.

    Parameters
    ----------
    path : Path
        The file.
    handler : Handler
        Takes in the elements.
    progress : callable
        Told bytes read and bytes in all.

    Returns
    -------
    str
        Where and why the file ends early, such as one that was cut; empty if it is whole.

    Raises
    ------
    LogError
        If it is not XML from the start, declares entities, or is above a limit.
    """
    walk = _Walk(handler)
    try:
        with path.open("rb") as raw:
            size = path.stat().st_size
            for piece in _pieces(raw, size):
                walk.feed(piece)
                progress(raw.tell(), size)
            walk.feed(b"", last=True)
    except _RefusedError as error:
        raise LogError(f"{path}: line {walk.line}, column {walk.column}: {error}") from None
    except expat.ExpatError as error:
        where = f"line {error.lineno}, column {error.offset + 1}: {expat.ErrorString(error.code)}"
    except zlib.error as error:
        where = f"line {walk.line}: it cannot be unpacked any further: {error}"
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from None
    else:
        return ""
    if not walk.elements:
        raise LogError(f"{path}: not XML: {where}; give a CommonRoad or SUMO file")
    return where


class _RefusedError(Exception):
    """The file is above a limit, or declares what is not read."""


def _pieces(raw: BinaryIO, size: int) -> Iterator[bytes]:
    """Give a file's bytes, unpacked where gzip has packed them; what a cut one still holds is given."""
    piece = raw.read(_PIECE)
    if not piece.startswith(_GZIP):
        while piece:
            yield piece
            piece = raw.read(_PIECE)
        return
    left = _INFLATED_FLOOR + _INFLATED_RATIO * size
    unpack = zlib.decompressobj(zlib.MAX_WBITS | 16)
    while piece:
        data = unpack.decompress(piece, _PIECE)
        left -= len(data)
        if left < 0:
            raise _RefusedError("it inflates to more than a file of its size may hold")
        if data:
            yield data
        if unpack.eof:
            piece, unpack = unpack.unused_data, zlib.decompressobj(zlib.MAX_WBITS | 16)
        else:
            piece = unpack.unconsumed_tail
        piece = piece or raw.read(_PIECE)


def _parser() -> expat.XMLParserType:
    parser = expat.ParserCreate()
    parser.EntityDeclHandler = _no_entities
    return parser


def _no_entities(*_: object) -> NoReturn:
    raise _RefusedError("it declares entities, which are not read: remove the DOCTYPE")


class _Walk:
    """One reading: where in the file it is, and the text of the open elements."""

    def __init__(self, handler: Handler) -> None:
        self.elements = 0
        self._handler = handler
        self._path: tuple[str, ...] = ()
        self._texts: list[list[str]] = []
        self._lengths: list[int] = []
        self._fed = 0
        self._parser = parser = _parser()
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._characters

    @property
    def line(self) -> int:
        return int(self._parser.CurrentLineNumber)

    @property
    def column(self) -> int:
        return int(self._parser.CurrentColumnNumber) + 1

    def feed(self, piece: bytes, last: bool = False) -> None:
        self._parser.Parse(piece, last)
        self._fed += len(piece)
        if self._fed - self._parser.CurrentByteIndex > _TAG:
            raise _RefusedError(f"a tag or comment of more than {_TAG} bytes")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        if len(self._path) >= _DEPTH:
            raise _RefusedError(f"more than {_DEPTH} elements within each other")
        self.elements += 1
        self._path = (*self._path, name)
        self._texts.append([])
        self._lengths.append(0)
        self._handler.start(self._path, attributes, self.line)

    def _end(self, _name: str) -> None:
        self._lengths.pop()
        self._handler.end(self._path, "".join(self._texts.pop()).strip(), self.line)
        self._path = self._path[:-1]

    def _characters(self, text: str) -> None:
        if self._texts:
            self._lengths[-1] += len(text)
            if self._lengths[-1] > _TEXT:
                raise _RefusedError(f"a text of more than {_TEXT} characters")
            self._texts[-1].append(text)
