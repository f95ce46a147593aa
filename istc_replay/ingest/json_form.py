"""Forms: where the values stand in JSON messages that were written by one hand.

One message is taken apart into its literals (keys, brackets, blanks) and the values between them. All
messages with the same literals, byte for byte, have their values in the same order; each must be of the
kind of the first one's. So a message that is read by a form was checked to its last byte, and every
other is left to a parser.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from istc_replay.ingest.batches import Bytes, Ints
from istc_replay.ingest.layout import Column, coded
from istc_replay.ingest.numerals import LONGEST, Mask, Words, floats, integers, texts, words
from istc_replay.ingest.payload import ITEMS_AT_ONCE, TooManyItemsError

#: A message that is taken apart is no longer than this [bytes], and has no more values.
_LENGTH, _VALUES = 2**16, 1024
_COMMA, _WORD = ord(","), 8
#: A text, or a key if a colon follows; a number; a boolean.
_TOKEN = re.compile(
    rb'"(?P<text>(?:[^"\\]|\\.)*)"(?P<key>\s*:)?|(?P<number>-?\d[\d.eE+-]*)|(?P<boolean>true|false)'
)
_NUMBER = re.compile(rb"-?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][+-]?[0-9]+)?")
_INTEGER = re.compile(rb"-?(?:0|[1-9][0-9]*)")
_PLAIN = re.compile(r'[^"\\\x00-\x1f]*')
#: Longest number that is looked at alone [bytes], and how many of a message may be: more are for a parser.
_LONG, _ALONE = 64, 3
_INT64 = 2**63
#: Values of several places that are read at once, as they fit the caches.
_AT_ONCE = 2**13
_TEXT, _BOOLEAN, _WHOLE, _FLOAT = "text", "boolean", "whole", "float"
_BOOLEANS = texts(words(np.frombuffer(b"truefalse" + bytes(32), np.uint8)), *np.array([[0, 4], [4, 9]]))[0]

#: Gives the wanted values of a message by name, one dict an item; raises ValueError where it cannot.
Gather = Callable[[bytes], Iterable[dict[str, Any]]]


class Commas:
    """Where the commas of many payloads stand."""

    def __init__(self, data: Bytes, starts: Ints, ends: Ints) -> None:
        self.places = np.flatnonzero(data == _COMMA)
        self.first = np.searchsorted(self.places, starts)
        self.counts = np.searchsorted(self.places, ends) - self.first


@dataclass(frozen=True, slots=True)
class Form:
    """The form of one message; `items` has the wanted values by name, as places among all its values."""

    items: list[dict[str, int]]
    _literals: list[bytes]
    _kinds: list[str]  # of each value

    @classmethod
    def of(cls, payload: bytes, gather: Gather, whole: Callable[[str], bool]) -> Form | None:
        """Take a message apart.

        Parameters
        ----------
        payload : bytes
            The message.
        gather : callable
            Finds the wanted values in a message.
        whole : callable
            Tells by its name whether a number is told as an integer, where it is one.

        Returns
        -------
        Form or None
            None where other messages cannot be read by it.
        """
        if len(payload) > _LENGTH or b"\0" in payload:  # JSON that is not UTF-8 has zeros
            return None
        literals, kinds, numbered = _apart(payload)
        # Values have a comma between them; it tells where the next one is looked for.
        if not 0 < len(kinds) <= _VALUES or not all(b"," in literal for literal in literals[1:-1]):
            return None
        try:
            # What is wanted must be one of the values: int fails on all else.
            items = [{name: int(str(place)) for name, place in item.items()} for item in gather(numbered)]
        except ValueError:
            return None
        wanted = {name for item in items for name in item}
        if not wanted:
            return None
        told = {place for item in items for name, place in item.items() if whole(name)}
        kinds = [_FLOAT if kind == _WHOLE and place not in told else kind for place, kind in enumerate(kinds)]
        for name in wanted:
            own = {kinds[item[name]] for item in items if name in item}
            # Where one number is told by a point, others may well be whole.
            if len(own) > 1 or _BOOLEAN in own or (whole(name) and _FLOAT in own):
                return None
        return cls(items, literals, kinds)

    def read(
        self, data: Bytes, starts: Ints, ends: Ints, commas: Commas, rows: Ints
    ) -> tuple[Ints, dict[str, Column]]:
        """Read the messages in the rows' spans of data; returns the rows that fit, and items' columns.

        Raises
        ------
        TooManyItemsError
            If they hold more items than are decoded at once.
        """
        rows = rows[commas.counts[rows] == sum(literal.count(b",") for literal in self._literals)]
        if not len(rows):
            return rows, {}
        word = words(data)
        found = self._found(starts[rows], ends[rows], commas, commas.first[rows])
        lengths = np.array([[len(literal)] for literal in self._literals])
        begins, stops = found[:-1] + lengths[:-1], found[1:]
        fits = (begins <= stops).all(axis=0)
        if not fits.all():
            rows, found, begins, stops = rows[fits], found[:, fits], begins[:, fits], stops[:, fits]
        fits = self._same(word, found)
        values = self._values(data, word, begins, stops, fits)
        if not fits.all():
            rows = rows[fits]
            values = {place: value[fits] for place, value in values.items()}
        if len(self.items) * len(rows) > ITEMS_AT_ONCE and len(starts) > 1:
            raise TooManyItemsError(max(ITEMS_AT_ONCE // len(self.items), 1))
        return rows, self._columns(values, len(rows)) if len(rows) else {}

    def _found(self, starts: Ints, ends: Ints, commas: Commas, first: Ints) -> Ints:
        """Tell where the literals begin if the messages are of this form, (literals, n)."""
        own = np.cumsum([0] + [literal.count(b",") for literal in self._literals])
        found = np.empty((len(self._literals), len(starts)), np.int64)
        for place, literal in enumerate(self._literals[1:-1], start=1):
            found[place] = commas.places[first + own[place]] - literal.index(b",")
        found[0], found[-1] = starts, ends - len(self._literals[-1])
        return found

    def _same(self, word: Words, found: Ints) -> Mask:
        """Tell which messages have the literals there, (n,)."""
        fits = np.ones(found.shape[1], np.bool_)
        for literal, places in zip(self._literals, found, strict=True):
            size = len(literal)
            expected = words(np.frombuffer(literal + bytes(_WORD), np.uint8))
            if size < _WORD:
                mask = np.uint64((1 << 8 * size) - 1)
                fits &= (word[places] & mask) == (expected[0] & mask)
                continue
            for step in (*range(0, size - _WORD, _WORD), size - _WORD):
                fits &= word[places + step] == expected[step]
        return fits

    def _values(
        self, data: Bytes, word: Words, begins: Ints, stops: Ints, fits: Mask
    ) -> dict[int, NDArray[Any]]:
        """Read all values; returns those that are wanted, (n,) or words of texts (n, k), and narrows fits."""
        wanted = {place for item in self.items for place in item.values()}
        values: dict[int, NDArray[Any]] = {}
        messages = len(fits)
        count, left = max(_AT_ONCE // messages, 1), _ALONE * messages
        for kind, read in _READERS.items():
            own = np.array([place for place, other in enumerate(self._kinds) if other == kind], np.int64)
            for some in (own[start : start + count] for start in range(0, len(own), count)):
                first, after = begins[some].reshape(-1), stops[some].reshape(-1)
                told, sound = read(word, first, after)
                odd = np.flatnonzero(~sound & np.tile(fits, len(some)))
                left -= 0 if kind == _TEXT else len(odd)
                if left < 0:
                    fits[odd % messages] = False
                elif len(odd):
                    settled = _settled(data, first[odd], after[odd], kind, told, odd)
                    fits[odd[~settled] % messages] = False
                for index, place in enumerate(some.tolist()):
                    if place in wanted:
                        values[place] = told[index * messages : (index + 1) * messages]
        return values

    def _columns(self, values: dict[int, NDArray[Any]], count: int) -> dict[str, Column]:
        """Make the columns of the items of count messages, a message's items together."""
        columns = {}
        for name in {name: None for item in self.items for name in item}:
            places = [item.get(name) for item in self.items]
            one = next(values[place] for place in places if place is not None)
            parts = [np.zeros_like(one) if place is None else values[place] for place in places]
            valid = None
            if None in places:
                valid = np.tile([place is not None for place in places], count)
            columns[name] = _column(parts, valid)
        return columns


def _apart(payload: bytes) -> tuple[list[bytes], list[str], bytes]:
    """Return literals, the kinds of the values between them, and the message with their numbers as texts."""
    literals: list[bytes] = []
    kinds: list[str] = []
    numbered: list[bytes] = []
    after = told = 0
    for token in _TOKEN.finditer(payload):
        kind = token.lastgroup or ""
        if kind == "key" or b"," in token[kind]:
            continue
        literals.append(payload[after : token.start(kind)])
        numbered += [payload[told : token.start()], b'"%d"' % len(kinds)]
        after, told = token.end(kind), token.end()
        kinds.append(kind if kind != "number" else _WHOLE if _INTEGER.fullmatch(token[kind]) else _FLOAT)
    return [*literals, payload[after:]], kinds, b"".join([*numbered, payload[told:]])


def _settled(data: Bytes, begins: Ints, stops: Ints, kind: str, told: NDArray[Any], odd: Ints) -> Mask:
    """Look at values alone that are written in an uncommon way, and put numbers in their places.

    Returns
    -------
    array
        Which of them are of their kind, (len(odd),).
    """

    def text(place: int) -> bytes:
        return data[begins[place] : stops[place]].tobytes()

    if kind == _TEXT:
        first, own = coded(np.column_stack([told[odd], (stops - begins).view(np.uint64)]))
        return np.array([_is_text(text(place)) for place in first.tolist()], np.bool_)[own]
    sound = np.zeros(len(odd), np.bool_)
    for place, at in enumerate(odd.tolist()):
        value = _number(text(place), kind)
        if value is not None:
            told[at], sound[place] = value, True
    return sound


def _is_text(text: bytes) -> bool:
    """Tell whether it is UTF-8 that stands for itself, and no longer than what is read."""
    try:
        return len(text) <= LONGEST and bool(_PLAIN.fullmatch(text.decode("utf-8")))
    except UnicodeDecodeError:
        return False


def _number(text: bytes, kind: str) -> float | None:
    """Read a number; None where it is none of this kind."""
    if kind == _BOOLEAN or len(text) > _LONG:
        return None
    if kind == _FLOAT:
        return float(text) if _NUMBER.fullmatch(text) else None
    value = int(text) if _INTEGER.fullmatch(text) else _INT64
    return value if abs(value) < _INT64 else None


def _booleans(word: Words, starts: Ints, ends: Ints) -> tuple[Words, Mask]:
    found, sound = texts(word, starts, ends)
    return found, sound & np.isin(found[:, 0], _BOOLEANS) & (ends - starts <= len("false"))


#: What reads the values of a kind.
_READERS: dict[str, Callable[[Words, Ints, Ints], tuple[NDArray[Any], Mask]]] = {
    _TEXT: texts,
    _BOOLEAN: _booleans,
    _WHOLE: integers,
    _FLOAT: floats,
}


def _column(parts: list[NDArray[Any]], valid: Mask | None) -> Column:
    if parts[0].ndim == 1:
        return Column(parts[0] if len(parts) == 1 else np.stack(parts, axis=1).reshape(-1), valid)
    wide = max(part.shape[1] for part in parts)
    table = np.zeros((len(parts[0]), len(parts), wide), np.uint64)
    for index, part in enumerate(parts):
        table[:, index, : part.shape[1]] = part
    table = table.reshape(-1, wide)
    first, own = coded(table)
    return Column(own, valid, [_text(row) for row in table[first]])


def _text(row: Words) -> str:
    """Put a text's words, which end at their last bytes, together."""
    return b"".join(word.tobytes().lstrip(b"\0") for word in row).decode("utf-8")
