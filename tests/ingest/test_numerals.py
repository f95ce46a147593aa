"""Numbers that are read many at a time are those that Python reads one by one, to the bit."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from decimal import Decimal
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from istc_replay.ingest.numerals import floats, integers, texts, words

NUMBER = re.compile(r"-?(0|[1-9][0-9]*)(\.[0-9]+)?([eE][+-]?[0-9]+)?")


def read(reader: Callable[..., Any], written: list[str]) -> tuple[Any, list[bool]]:
    """Read texts that stand between commas."""
    raw = [text.encode("utf-8", "surrogatepass") for text in written]
    ends = np.cumsum([len(text) + 1 for text in raw], dtype=np.int64)
    data = np.frombuffer(b"," + b",".join(raw) + bytes(32), np.uint8)
    values, sound = reader(words(data), ends - [len(text) for text in raw], ends)
    return values, sound.tolist()


def bits(value: float) -> bytes:
    return struct.pack("<d", value)


def halfway(value: float) -> str:
    """A decimal as near to the middle of two floats as so many digits allow."""
    return format((Decimal(value) + Decimal(float(np.nextafter(value, 1e9)))) / 2, "f")


DECIMALS = st.one_of(
    st.floats(-1e7, 1e7).map(repr),
    st.floats(allow_nan=False).map(repr),
    st.builds(lambda value, digits: f"{value:.{digits}f}", st.floats(-1e7, 1e7), st.integers(0, 24)),
    st.builds(lambda value, size: halfway(value)[:size], st.floats(0, 16), st.integers(12, 24)),
    st.from_regex(r"-?[0-9]{0,8}\.?[0-9]{0,24}", fullmatch=True),
    st.text('0123456789.-+eE," xN', max_size=12),
)


@settings(max_examples=200, deadline=None)
@given(written=st.lists(DECIMALS, min_size=1, max_size=40))
def test_floats_are_the_nearest_ones(written: list[str]) -> None:
    values, sound = read(floats, written)
    for text, value, read_ in zip(written, values.tolist(), sound, strict=True):
        if read_:
            assert NUMBER.fullmatch(text)
            assert bits(value) == bits(float(text)), text


@settings(max_examples=200, deadline=None)
@given(written=st.lists(st.one_of(st.integers(-(2**66), 2**66).map(str), DECIMALS), min_size=1, max_size=40))
def test_integers_are_exact(written: list[str]) -> None:
    values, sound = read(integers, written)
    for text, value, read_ in zip(written, values.tolist(), sound, strict=True):
        if read_:
            assert re.fullmatch("-?(0|[1-9][0-9]*)", text)
            assert value == int(text)


def test_usual_numbers_are_read() -> None:
    written = [repr(0.1 * k - 40.0) for k in range(800)] + [
        "0",
        "-7",
        "12345678",
        "1234567.123456789",
        "0.001",
    ]
    values, sound = read(floats, written)
    assert all(sound)
    assert values.tolist() == [float(text) for text in written]
    stamps = ["0", "1700000000123456789", "-5", "999999999"]
    values, sound = read(integers, stamps)
    assert (values.tolist(), all(sound)) == ([int(text) for text in stamps], True)


@pytest.mark.parametrize(
    "text", ["", "-", ".5", "5.", "01", "-01.5", "+1", "1e5", "NaN", "1 ", "1.5.2", "0x1", "--1"]
)
def test_what_json_does_not_allow_or_is_written_otherwise_is_left_to_the_caller(text: str) -> None:
    assert read(floats, ["1.5", text, "2"])[1] == [True, False, True]
    assert read(integers, ["15", text, "2"])[1] == [True, False, True]


@settings(max_examples=200, deadline=None)
@given(written=st.lists(st.one_of(st.text(max_size=12), st.text("ab", max_size=70)), min_size=1, max_size=30))
def test_texts_are_told_apart_where_they_are_plain(written: list[str]) -> None:
    found, sound = read(texts, written)
    for text, read_ in zip(written, sound, strict=True):
        assert read_ == bool(re.fullmatch(r"[ !#-\[\]-~\x7f]{0,64}", text))
    kept = [(text, row.tolist()) for text, row, read_ in zip(written, found, sound, strict=True) if read_]
    assert len({text for text, _ in kept}) == len({tuple(row) for _, row in kept})
