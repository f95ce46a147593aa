"""Decoding by layouts gives what the reference libraries give, payload by payload."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_ros2._dynamic import serialize_dynamic

from istc_replay.ingest.batches import distinct, rows
from istc_replay.ingest.chunk import chunk_records
from istc_replay.ingest.definition import parse_definition
from istc_replay.ingest.payload import Budget, TooManyItemsError
from istc_replay.ingest.protobuf import ProtobufDecoder
from istc_replay.ingest.records import MalformedRecordError
from istc_replay.ingest.ros import ros_decoder
from istc_replay.ingest.scan import Spans, scan
from istc_replay.ingest.wanted import Mapping

from ..support.logs import decode, plain
from ..support.mcap_bytes import record

# --- protobuf ------------------------------------------------------------------------------------


def make_type() -> Any:
    """A message of every kind of field, proto3, with a repeated part and a header."""
    file = descriptor_pb2.FileDescriptorProto(name="t.proto", package="t", syntax="proto3")
    part = file.message_type.add(name="Part")
    for number, (name, kind) in enumerate(
        [("x", 1), ("f", 2), ("i", 3), ("u", 4), ("z", 18), ("s", 9), ("b", 8), ("h", 16)], start=1
    ):
        part.field.add(name=name, number=number, type=kind, label=1)
    part.field.add(name="inner", number=20, type=11, label=1, type_name=".t.Part")
    whole = file.message_type.add(name="Whole")
    whole.field.add(name="name", number=1, type=9, label=1)
    whole.field.add(name="head", number=2, type=11, label=1, type_name=".t.Part")
    whole.field.add(name="parts", number=3, type=11, label=3, type_name=".t.Part")
    whole.field.add(name="noise", number=200, type=12, label=1)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("t.Whole"))


TYPE = make_type()
MAPPING = Mapping(
    {
        **{name: name for name in ("x", "f", "i", "u", "z", "s", "b", "h")},
        "inner_x": "inner.x",
        "name": "/name",
        "head_i": "/head.i",
    },
    "parts",
)
INT64 = st.integers(-(2**63), 2**63 - 1)
PART = st.fixed_dictionaries(
    {},
    optional={
        "x": st.floats(allow_nan=False),
        "f": st.floats(width=32, allow_nan=False),
        "i": INT64,
        "u": st.integers(0, 2**64 - 1),
        "z": INT64,
        "s": st.text(max_size=4).filter(lambda s: not s.endswith("\0")),
        "b": st.booleans(),
        "h": INT64,
    },
)
WHOLE = st.fixed_dictionaries(
    {"parts": st.lists(PART, max_size=12)},
    optional={
        "name": st.text(max_size=3).filter(lambda s: not s.endswith("\0")),
        "head": PART,
        "noise": st.binary(max_size=300),
    },
)


@settings(max_examples=120, deadline=None)
@given(values=st.lists(WHOLE, min_size=1, max_size=12), inner=st.booleans())
def test_protobuf_is_decoded_as_by_the_reference_library(values: list[Any], inner: bool) -> None:
    messages = [TYPE(**value) for value in values]
    if inner:
        for message in messages:
            for part in message.parts:
                part.inner.x = 4.5
    decoded = decode(
        ProtobufDecoder(TYPE, MAPPING, Budget(10**9)), [message.SerializeToString() for message in messages]
    )
    assert decoded.bad == []
    items = [(row, message, part) for row, message in enumerate(messages) for part in message.parts]
    assert decoded.rows.tolist() == [row for row, _, _ in items]
    if not items:
        return
    for name in ("x", "f", "i", "u", "z", "s", "b", "h"):
        assert plain(decoded, name) == [getattr(part, name) for _, _, part in items], name
    assert plain(decoded, "inner_x") == [part.inner.x if inner else None for _, _, part in items]
    assert plain(decoded, "name") == [message.name for _, message, _ in items]
    assert plain(decoded, "head_i") == [m.head.i if m.HasField("head") else None for _, m, _ in items]


@settings(max_examples=150, deadline=None)
@given(
    payload=st.binary(max_size=60),
    damage=st.lists(st.tuples(st.integers(0, 80), st.integers(0, 255)), max_size=3),
)
def test_damaged_protobuf_is_refused_where_the_reference_library_refuses_it(
    payload: bytes, damage: list[tuple[int, int]]
) -> None:
    sound = TYPE(name="a", parts=[{"x": 1.0, "s": "b"}, {"i": -5}], head={"i": 7}).SerializeToString()
    hurt = bytearray(sound)
    for position, value in damage:
        hurt[position % len(hurt)] = value
    payloads = [payload, sound, bytes(hurt)]
    decoded = decode(ProtobufDecoder(TYPE, MAPPING, Budget(10**9)), payloads)
    bad = {row for row, _ in decoded.bad}
    assert 1 not in bad
    for row, data in enumerate(payloads):
        try:
            message = TYPE.FromString(data)
        except Exception:  # noqa: S112
            continue  # ours may pass over damage in what is not wanted
        if row not in bad:
            assert (decoded.rows == row).sum() == len(message.parts)


def test_of_many_messages_those_that_are_cut_are_refused_and_no_other_is_touched() -> None:
    # So many of so many sizes that their fields are found all at once, one message behind the other.
    random = np.random.default_rng(6)
    messages = [
        TYPE(name=f"n{k}", noise=random.bytes(int(random.integers(0, 200))), parts=[{"x": float(k), "i": k}])
        for k in range(400)
    ]
    payloads = [message.SerializeToString() for message in messages]
    cut = set(random.choice(400, 40, replace=False).tolist())
    for row in cut:
        payloads[row] = payloads[row][:-1]
        with pytest.raises(DecodeError):
            TYPE.FromString(payloads[row])
    decoded = decode(ProtobufDecoder(TYPE, MAPPING, Budget(10**9)), payloads)
    assert {row for row, _ in decoded.bad} == cut
    whole = [row for row in range(400) if row not in cut]
    assert decoded.rows.tolist() == whole
    assert plain(decoded, "x") == [float(row) for row in whole]
    assert plain(decoded, "name") == [f"n{row}" for row in whole]


def test_parts_that_stand_twice_are_merged_as_protobuf_says() -> None:
    first = TYPE(head={"i": 7}, parts=[{"x": 1.0}]).SerializeToString()
    payload = first + TYPE(head={"x": 2.0}, parts=[{"x": 3.0}]).SerializeToString()
    decoded = decode(ProtobufDecoder(TYPE, MAPPING, Budget(10**9)), [payload, first])
    assert decoded.bad == []
    assert (plain(decoded, "x"), plain(decoded, "head_i")) == ([1.0, 3.0, 1.0], [7, 7, 7])


@pytest.mark.parametrize(("count", "whole"), [(40_000, True), (1_000_000, False)])
def test_many_fields_in_one_message_among_many_are_scanned_alone(count: int, whole: bool) -> None:
    payloads = [b"\x08\x01"] * 20 + [b"\x08\x01" * count]
    data = np.frombuffer(b"".join(payloads) + bytes(32), np.uint8)
    ends = np.cumsum([len(payload) for payload in payloads]).astype(np.int64)
    starts = np.concatenate([[0], ends[:-1]])
    found, broken = scan(data, Spans(np.arange(21), starts, starts, ends), {1}, Budget(10**9))
    assert (len(found[1].rows) == count + 20, len(broken)) == (whole, not whole)


# --- CDR -----------------------------------------------------------------------------------------

DEFINITION = """
string name
int8 small
Part[] parts
float32[] noise
float64 last
================================================================================
MSG: p/Part
uint8 flag
float64 x
string label
int16[3] triple
"""
CDR = Mapping({"x": "x", "flag": "flag", "label": "label", "name": "/name", "last": "/last"}, "parts")


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(
        st.tuples(
            st.text(max_size=5).filter(lambda s: "\0" not in s),
            st.lists(
                st.tuples(st.integers(0, 255), st.floats(allow_nan=False), st.sampled_from(["", "a", "bé"])),
                max_size=4,
            ),
            st.integers(0, 3),
        ),
        min_size=1,
        max_size=8,
    )
)
def test_cdr_is_decoded_as_the_reference_library_encodes_it(values: list[Any]) -> None:
    encode = serialize_dynamic("p/msg/Whole", DEFINITION)["p/msg/Whole"]
    payloads = [
        encode(
            {
                "name": name,
                "small": 3,
                "parts": [{"flag": f, "x": x, "label": label, "triple": [1, 2, 3]} for f, x, label in parts],
                "noise": [0.5] * noise,
                "last": 2.5 * row,
            }
        )
        for row, (name, parts, noise) in enumerate(values)
    ]
    decoded = decode(
        ros_decoder(parse_definition(DEFINITION.encode(), False), CDR, False, Budget(10**9)), payloads
    )
    items = [(row, name, part) for row, (name, parts, _) in enumerate(values) for part in parts]
    assert decoded.bad == []
    assert decoded.rows.tolist() == [row for row, _, _ in items]
    if items:
        assert plain(decoded, "name") == [name for _, name, _ in items]
        assert plain(decoded, "last") == [2.5 * row for row, _, _ in items]
        for index, name in enumerate(("flag", "x", "label")):
            assert plain(decoded, name) == [part[index] for _, _, part in items]


def test_a_definition_of_nothing_cannot_make_a_payload_endless() -> None:
    types = parse_definition(b"Empty[] many\nfloat64 x\n===\nMSG: p/Empty\n", True)
    decoder = ros_decoder(types, Mapping({"x": "x"}), True, Budget(10**9))
    payload = struct.pack("<I", 2**32 - 1) + bytes(8)
    assert [error.code for _, error in decode(decoder, [payload]).bad] == ["payload"]
    circle = parse_definition(b"A a\nfloat64 x\n===\nMSG: p/A\nA a\n", True)
    assert decode(ros_decoder(circle, Mapping({"x": "x"}), True, Budget(10**9)), [bytes(50)]).bad
    wide = "".join(f"===\nMSG: p/T{k}\n" + f"T{k + 1} a\nT{k + 1} b\n" for k in range(60))
    types = parse_definition(f"float64 x\nT0 t\n{wide}===\nMSG: p/T60\nuint8 q\n".encode(), True)
    assert decode(ros_decoder(types, Mapping({"x": "x"}), True, Budget(10**9)), [bytes(50)]).bad


# --- what they stand on --------------------------------------------------------------------------


@given(values=st.lists(INT64, max_size=50), small=st.booleans())
def test_distinct_is_unique_with_inverse(values: list[int], small: bool) -> None:
    array = np.array([value % 17 - 5 if small else value for value in values], np.int64)
    found, own = distinct(array)
    assert found.tolist() == sorted(set(array.tolist()))
    assert (found[own] == array).all() if len(array) else not len(own)


def test_rows_are_copied_from_anywhere() -> None:
    data = np.arange(100, dtype=np.uint8)
    assert rows(data, np.array([0, 93, 5]), 7).tolist() == [list(range(s, s + 7)) for s in (0, 93, 5)]


@settings(max_examples=200, deadline=None)
@given(
    sizes=st.lists(st.tuples(st.sampled_from([5, 5, 5, 4, 9]), st.integers(0, 30)), max_size=12),
    lie=st.one_of(st.none(), st.lists(st.integers(-5, 500), max_size=12)),
    cut=st.integers(0, 40),
)
def test_a_hint_never_changes_what_a_chunk_holds(
    sizes: list[tuple[int, int]], lie: list[int] | None, cut: int
) -> None:
    data, places = b"", []
    for opcode, size in sizes:
        if opcode == 5:
            places.append(len(data))
        data += struct.pack("<BQ", opcode, size) + bytes(size)
    data = data[: len(data) - cut] if cut < 20 else data

    def told(hint: Any) -> list[Any]:
        found: list[Any] = []
        try:
            for opcode, positions in chunk_records(data, hint):
                found += [(opcode, p) for p in positions] if opcode == 5 else [(opcode, tuple(positions))]
        except MalformedRecordError:
            found.append("damage")
        return found

    hint = np.array(sorted(p for p in (places if lie is None else lie) if 0 <= p < len(data)), np.int64)
    assert told(hint) == told(None)


# --- bounds --------------------------------------------------------------------------------------


def test_messages_of_many_items_are_decoded_in_parts() -> None:
    messages = [b"\x12\x02\x08\x01" * 10_000] * 20
    spans = Spans(np.arange(20), *(np.arange(20) * 40_000 for _ in range(2)), np.arange(1, 21) * 40_000)
    data = np.frombuffer(b"".join(messages) + bytes(16), np.uint8)
    with pytest.raises(TooManyItemsError) as error:
        scan(data, spans, {2}, Budget(10**9))
    few = error.value.rows
    assert 1 <= few < 20
    found, broken = scan(data, Spans(*(column[:few] for column in spans)), {2}, Budget(10**9))
    assert (len(found[2].rows), len(broken)) == (few * 10_000, 0)


def test_a_small_file_cannot_ask_for_much_work() -> None:
    budget = Budget(0)
    budget.spend(10**6)
    decoded = decode(ProtobufDecoder(TYPE, MAPPING, budget), [b"\x08\x01"])
    assert "more fields than a file of this size may hold" in str(decoded.bad[0][1])


def test_a_hint_at_records_that_are_no_messages_is_not_believed() -> None:
    message, channel = record(0x05, bytes(30)), record(0x04, bytes(8))
    data = message + message + channel + message
    hint = np.array([0, 39, 78, 95], np.int64)  # where every record begins
    assert [len(message), len(channel)] == [39, 17]

    def told(believed: Any) -> list[Any]:
        return [(opcode, list(map(int, places))) for opcode, places in chunk_records(data, believed)]

    assert told(hint) == told(None) == [(0x05, [0, 39]), (0x04, [87, 95]), (0x05, [95])]
