"""Decimal numbers and short texts that stand in many places of a buffer, read at once and exactly.

Characters are taken by the word of eight. A value is given only where its text is one that JSON
allows and is read exactly as Python's `float` and `int` would; the others are for the caller.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from istc_replay.ingest.batches import Bytes, Ints

Words = NDArray[np.uint64]
Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]

_WORD = 8
#: Longest text that is read [bytes].
LONGEST = 64
_MINUS, _POINT, _QUOTE, _BACKSLASH, _SPACE = b'-."\\ '
#: Digits that are read at most [words]; where fewer than one text of so many is longer, it is read apart.
_WORDS, _FEW = 3, 4
#: Powers of ten that a float holds exactly.
_EXACT = 22
_FIXED = 2**53
_TENS = np.array([10**k for k in range(_WORD + 1)], np.uint64)
#: So many digits are always below 63 bits.
_SAFE = 18
#: Above these, so many more digits might pass 63 bits.
_LIMITS = np.array([(2**63 - 10**k) // 10**k for k in range(_WORD + 1)], np.uint64)
_SCALES = np.array([10.0**k for k in range(_EXACT + 1)], np.float64)
#: Splits a float into halves of 26 bits (Dekker).
_SPLIT = 2.0**27 + 1.0
#: What the correction of a quotient may be off, with room to spare.
_DOUBT = 2.0**-48


def _each(byte: int) -> np.uint64:
    return np.uint64(byte * 0x0101010101010101)


_ONES, _HIGHS, _ZEROS = _each(0x01), _each(0x80), _each(ord("0"))
#: Brings all bytes but 0 to 9 to the high bit.
_ABOVE_NINE = _each(0x80 - 10)
_FOLDS = tuple(
    (np.uint64(10 ** (bits // 8) * 2**bits + 1), np.uint64(bits), np.uint64(mask))
    for bits, mask in ((8, 0x00FF00FF00FF00FF), (16, 0x0000FFFF0000FFFF), (32, 0x00000000FFFFFFFF))
)
#: Spaces where a text of so many bytes leaves the first bytes of its word free.
_FILL = np.array([_each(_SPACE) & np.uint64((1 << 8 * (_WORD - size)) - 1) for size in range(_WORD + 1)])


def words(data: Bytes) -> Words:
    """View the eight bytes from every place of the data as a word, shape (len(data) - 7,)."""
    return np.ndarray((max(len(data) - _WORD + 1, 0),), "<u8", data, strides=(1,))


def floats(word: Words, starts: Ints, ends: Ints) -> tuple[Floats, Mask]:
    """Read numbers without exponents as the nearest floats.

    Parameters
    ----------
    word : array
        `words` of the buffer, which goes on for 32 bytes after the last end.
    starts, ends : array
        Spans of the texts, (n,).

    Returns
    -------
    array
        The values, (n,).
    array
        Where the value was read. It is not where the text is no number, or one with an exponent,
        more than 8 digits before its point, or too many behind it.
    """
    head, minus, first = _signed(word, starts)
    sizes = ends - first
    point = np.minimum(_place(head, _POINT), sizes)
    behind = sizes - point - 1  # -1: there is no point
    places = np.minimum(np.maximum(behind, 0), _EXACT)
    # Eight characters without a point are a number if nothing follows.
    sound = (point > 0) & (behind != 0) & (behind <= _EXACT) & ((point < _WORD) | (behind < 0))
    sound &= _leads(head, point)
    whole, odd = _folded(_last(head ^ _ZEROS, point))
    sound &= (odd & _HIGHS) == 0
    value, sound = _digits(word, first + point + 1, places, whole, _WORD, sound)
    value_, certain = _scaled(value, places)
    return np.where(minus, -value_, value_), sound & certain


def integers(word: Words, starts: Ints, ends: Ints) -> tuple[Ints, Mask]:
    """Read whole numbers, as `floats` does; not where one is beyond 63 bits or is no whole number."""
    head, minus, first = _signed(word, starts)
    sizes = ends - first
    sound = (sizes > 0) & (sizes <= _WORD * _WORDS) & _leads(head, sizes)
    sizes = np.minimum(sizes, _WORD * _WORDS)
    value, sound = _digits(word, first, sizes, np.zeros(len(starts), np.uint64), 0, sound)
    whole = value.view(np.int64)
    return np.where(minus, -whole, whole), sound


def texts(word: Words, starts: Ints, ends: Ints) -> tuple[Words, Mask]:
    """Read texts of plain ASCII without quotes, backslashes and control characters, up to 64 bytes.

    Returns
    -------
    array
        The texts by the word, (n, k): equal rows are equal texts. The bytes of a word stand at its
        end, behind zeros.
    array
        Where the text is so; others of that length are read as well.
    """
    sizes = ends - starts
    sound = (sizes >= 0) & (sizes <= LONGEST)
    count = max(-(-int(np.where(sound, sizes, 0).max(initial=0)) // _WORD), 1)
    found = np.empty((len(starts), count), np.uint64)
    odd = np.zeros(len(starts), np.uint64)
    for step in range(count):
        left = np.minimum(np.maximum(sizes - _WORD * step, 0), _WORD)
        part = _last(word[np.minimum(starts + _WORD * step, len(word) - 1)], left)
        found[:, step] = part
        part = part | _FILL[left]
        odd |= part | _zero(part ^ _each(_QUOTE)) | _zero(part ^ _each(_BACKSLASH))
        odd |= (part - _each(_SPACE)) & ~part
    return found, sound & ((odd & _HIGHS) == 0)


# --- the parts of a number -----------------------------------------------------------------------


def _signed(word: Words, starts: Ints) -> tuple[Words, Mask, Ints]:
    """Return the first seven or eight characters behind the sign, where it is a minus, where they begin."""
    head = word[starts]
    minus: Mask = (head & np.uint64(0xFF)) == _MINUS
    if not minus.any():
        return head, minus, starts
    return np.where(minus, head >> np.uint64(8), head), minus, starts + minus


def _leads(head: Words, whole: Ints) -> Mask:
    """Tell where the whole part, whose first characters these are, is a lone zero or begins with none."""
    leads: Mask = ((head & np.uint64(0xFF)) != ord("0")) | (whole == 1)
    return leads


def _zero(word: Words) -> Words:
    """Mark the lowest byte that is zero; bytes above it may be marked as well."""
    return (word - _ONES) & ~word & _HIGHS


def _place(word: Words, character: int) -> Ints:
    """Return the place of the first such character in each word; 8 where there is none."""
    marks = _zero(word ^ _each(character))
    below = (marks & (~marks + np.uint64(1))) - np.uint64(1)
    return (np.bitwise_count(below) >> np.uint8(3)).astype(np.int64)


def _last(word: Words, count: Ints) -> Words:
    """Move the first characters, as many as are counted, to the end of each word, behind zeros."""
    return word << (_WORD * (_WORD - count)).view(np.uint64)


def _folded(digits: Words) -> tuple[Words, Words]:
    """Return the numbers that eight digits make; a high bit of the second tells of what is none."""
    odd = (digits + _ABOVE_NINE) | digits
    # Into pairs, into fours, into all eight.
    for factor, shift, mask in _FOLDS:
        digits = ((digits * factor) >> shift) & mask
    return digits, odd


def _digits(
    word: Words, starts: Ints, sizes: Ints, value: Words, known: int, sound: Mask
) -> tuple[Words, Mask]:
    """Put digits behind those of the values, at most `known`.

    Returns the values, and where all were digits and the value is below 63 bits.
    """
    for step in range(min(-(-int(sizes.max(initial=0)) // _WORD), _WORDS)):
        left = sizes - _WORD * step
        longer = np.flatnonzero(left > 0) if step else starts[:0]
        if step and len(longer) < len(sizes) // _FEW:
            rest = starts[longer] + _WORD * step, left[longer], value[longer]
            value[longer], sound[longer] = _digits(word, *rest, known, sound[longer])
            break
        left = np.minimum(np.maximum(left, 0), _WORD)
        part, odd = _folded(_last(word[starts + _WORD * step] ^ _ZEROS, left))
        sound = sound & ((odd & _HIGHS) == 0)
        if known + _WORD > _SAFE:
            sound &= value <= _LIMITS[left]
        value = value * _TENS[left] + part
        known += _WORD
    return value, sound


def _scaled(value: Words, places: Ints) -> tuple[Floats, Mask]:
    """Divide by powers of ten, rounded once; tells where that is certain."""
    scale = _SCALES[places]
    high = value.astype(np.float64)
    quotient = high / scale
    certain = np.ones(len(value), np.bool_)
    if int(value.max(initial=0)) <= _FIXED:
        return quotient, certain
    # What the first division leaves, exactly: of the product by its halves, and of the value.
    q_high, q_low = _halves(quotient)
    s_high, s_low = _halves(scale)
    product = quotient * scale
    error = ((q_high * s_high - product) + q_high * s_low + q_low * s_high) + q_low * s_low
    low = (value - high.astype(np.uint64)).view(np.int64).astype(np.float64)
    correction = ((high - product) - error + low) / scale
    least, most = quotient + correction * (1.0 - _DOUBT), quotient + correction * (1.0 + _DOUBT)
    return least, least == most


def _halves(value: Floats) -> tuple[Floats, Floats]:
    wide = value * _SPLIT
    high = wide - (wide - value)
    return high, value - high
