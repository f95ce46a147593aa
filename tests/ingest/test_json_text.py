"""JSON payloads are decoded as the standard library reads them, in whichever way they are."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from istc_replay.ingest.json_form import Form
from istc_replay.ingest.json_text import JsonDecoder
from istc_replay.ingest.layout import Decoded
from istc_replay.ingest.wanted import Mapping

from ..support.logs import decode, plain

JSON = Mapping({"x_m": "pose.x", "vehicle_id": "id", "time": "stamp"})


def one_by_one(payloads: list[bytes]) -> list[tuple[Any, Any]]:
    rows_ = []
    for payload in payloads:
        value = json.loads(payload)
        rows_.append((value.get("pose", {}).get("x"), value.get("id")))
    return rows_


@pytest.mark.parametrize(
    "extra",
    [
        b'{"pose": {"x": 3}, "id": "b", "stamp": {"sec": 5, "nsec": 6}}',
        b'{"pose": {},\n "id": null, "stamp": {"sec": 5}}',
        b'{"id": "\\u00e9\\n", "more": [1, {"deep": []}]}',
        b'{"pose": {"x": 1e3}, "id": "c"}',
        b"{}",
    ],
)
def test_json_is_decoded_as_by_the_reference_library(extra: bytes) -> None:
    sound = b'{"pose": {"x": 1.25, "y": 2}, "id": "a", "stamp": {"sec": 1700000000, "nsec": 999999999}}'
    payloads = [sound, extra, sound]
    decoded = decode(JsonDecoder(JSON), payloads)
    assert decoded.bad == []
    assert list(zip(plain(decoded, "x_m"), plain(decoded, "vehicle_id"), strict=True)) == one_by_one(payloads)
    assert plain(decoded, "time.sec")[0] == 1_700_000_000


@pytest.mark.parametrize(
    "damage",
    [b"", b"[1]", b'"x"', b'{"id": ', b'{"pose": {"x": true}}', b"\xff", b"[" * 100_000, b'{"a":' * 50_000],
)
def test_what_is_no_json_object_of_this_kind_is_bad_alone(damage: bytes) -> None:
    sound = b'{"pose": {"x": 1.25}, "id": "a", "stamp": {"sec": 1, "nsec": 2}}'
    decoded = decode(JsonDecoder(JSON), [sound, damage, sound])
    assert [row for row, _ in decoded.bad] == [1]
    assert decoded.rows.tolist() == [0, 2]


def test_numbers_of_json_that_are_not_finite_or_too_long_are_kept_as_such() -> None:
    values = [b"NaN", b"1e999", b"-Infinity", b"123456789012345678901234567890"]
    decoded = decode(JsonDecoder(Mapping({"x_m": "x"})), [b'{"x": ' + value + b"}" for value in values])
    assert decoded.bad == []
    assert [str(value) for value in plain(decoded, "x_m")] == ["nan", "inf", "-inf", "1.2345678901234568e+29"]


def test_json_lists_give_their_items() -> None:
    mapping = Mapping({"vehicle_id": "id", "time_ns": "/t", "x_m": "p.0"}, "objects")
    payload = b'{"t": 1700000000000000001, "objects": [{"id": 7, "p": [1.5, 2]}, {"id": 8, "p": []}]}'
    decoded = decode(JsonDecoder(mapping), [payload, b'{"t": 1}', b'{"objects": 3}'])
    assert [row for row, _ in decoded.bad] == [2]
    assert (plain(decoded, "vehicle_id"), plain(decoded, "x_m")) == ([7, 8], [1.5, None])
    assert plain(decoded, "time_ns") == [1_700_000_000_000_000_001] * 2


LINE = '{"stamp": {"sec": 1, "nsec": 2}, "id": "a", "pose": {"x": 1.5, "p": [1, 2e3]}, "last": -0.25}'


@pytest.mark.parametrize(
    "other",
    [
        LINE,
        LINE.replace("1.5", "-17.000000000000001"),
        LINE.replace('"a"', '"another"'),
        LINE.replace('"a"', '"a,b"'),
        LINE.replace('"a"', r'"a\"b"'),
        LINE.replace('"a"', '"é"'),
        LINE.replace('"a"', "7"),
        LINE.replace("1.5", "NaN"),
        LINE.replace("1.5", "-Infinity"),
        LINE.replace("1.5", "1e999"),
        LINE.replace("1.5", "null"),
        LINE.replace("1.5", '"1.5"'),
        LINE.replace("1.5", "true"),
        LINE.replace("1.5,", '1.5, "y": 3,'),
        LINE.replace('"last"', '"lost"'),
        LINE.replace(" ", ""),
        LINE.replace(", ", ",\n"),
        LINE.replace('"nsec": 2', '"nsec": 2.5'),
        LINE[:-1],
        LINE + "}",
        LINE + LINE,
        "",
        "[]",
        "x",
    ],
)
def test_json_of_one_form_is_read_as_one_by_one(other: str) -> None:
    mapping = Mapping({"time": "stamp", "vehicle_id": "id", "x_m": "pose.x", "y_m": "last", "p": "pose.p.0"})
    payloads = [line.encode() for line in (LINE, LINE, other, LINE)]
    for wanted in (mapping, Mapping({k: v for k, v in mapping.fields.items() if k != "p"})):
        decoder, exact = JsonDecoder(wanted), JsonDecoder(wanted)
        found = decode(decoder, payloads)
        truth = exact._exact(payloads)
        assert found.rows.tolist() == truth.rows.tolist()
        assert [row for row, _ in found.bad] == [row for row, _ in truth.bad]
        for name in truth.columns:
            assert plain(found, name) == pytest.approx(plain(truth, name), nan_ok=True), name
        assert odd(found) == odd(truth)


def odd(decoded: Decoded) -> dict[str, list[int]]:
    """The rows with texts where numbers are wanted."""
    return {
        name: sorted(row for own, rows in decoded.texts if own == name for row in rows.tolist())
        for name, _ in decoded.texts
    }


def test_texts_for_numbers_are_told_in_whichever_way_they_are_read() -> None:
    lines = [
        LINE,
        LINE.replace("1.5", '"fast"'),
        LINE.replace("1.5", "null"),
        LINE.replace("1.5", '"7"'),
        LINE,
    ]
    mapping = Mapping({"time": "stamp", "vehicle_id": "id", "x_m": "pose.x", "y_m": "last"})
    for some in (lines, lines[:2], lines[1:2], [lines[1]] * 8, lines * 4):
        payloads = [line.encode() for line in some]
        wrong = [row for row, line in enumerate(some) if '"x": "' in line]
        assert odd(decode(JsonDecoder(mapping), payloads)) == {"x_m": wrong}
        assert odd(JsonDecoder(mapping)._exact(payloads)) == {"x_m": wrong}


# --- by forms ------------------------------------------------------------------------------------


@pytest.fixture
def by_form(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Counts the messages that are read by forms, for each form and batch."""
    counts: list[int] = []
    read = Form.read

    def counted(self: Form, *arguments: Any) -> Any:
        rows, columns = read(self, *arguments)
        counts.append(len(rows))
        return rows, columns

    monkeypatch.setattr(Form, "read", counted)
    return counts


NUMBERS = st.one_of(
    st.floats().map(lambda value: json.dumps(value)),
    st.floats(-100, 100).map(repr),
    st.integers(-(2**70), 2**70).map(str),
    st.integers(-999, 999).map(str),
    st.sampled_from(
        ["-0", "0.0", "1e5", "1E-05", "null", "true", "[]", '"7"', "1.", ".5", "01", "--1", "1,2", ""]
    ),
)
NAMES = st.one_of(
    st.sampled_from(["a", "car_17", "", " a", "0123456789abcdef-0123456789abcdef"]).map(json.dumps),
    st.text(max_size=9).map(json.dumps),
    st.sampled_from(
        ['"a', r'"\""', r'"\u0041"', '"\x01"', '"a,b"', "7", "7.5", "-2", "null", "{}", '"x": 1', '--"x"']
    ),
)
ONE = Mapping({"time": "t", "vehicle_id": "id", "x_m": "p.x", "y_m": "p.y.0", "speed_mps": "v"})
MANY = Mapping({"time_ns": "/t", "vehicle_id": "id", "x_m": "x", "velocity": "v"}, "cars")


@st.composite
def messages(draw: st.DrawFn, many: bool) -> list[bytes]:
    """Messages of a few forms: most values are usual, some are not, some messages have a byte changed."""
    texts = []
    for _ in range(draw(st.integers(1, 12))):
        odd = draw(st.booleans())
        number = NUMBERS if odd else st.floats(-1e3, 1e3).map(repr)
        name = NAMES if odd else st.sampled_from(['"a"', '"b"', '"car_17"'])
        if many:
            cars = [
                f'{{"id":{draw(name)},"x":{draw(number)},"v":{{"x":{draw(number)},"y":{draw(number)}}}}}'
                for _ in range(draw(st.sampled_from([2, 2, 2, 1, 0])))
            ]
            texts.append(f'{{"t":{draw(st.integers(0, 2**62))},"cars":[{",".join(cars)}]}}')
        else:
            texts.append(
                f'{{"t": {{"sec": {draw(st.integers(0, 2**31))}, "nsec": 7}}, "id": {draw(name)}, '
                f'"on": true, "p": {{"x": {draw(number)}, "y": [{draw(number)}, 1.5]}}, "map": {draw(name)}, '
                f'"v": {draw(number)}}}'
            )
        if draw(st.integers(0, 9)) == 0:
            at, byte = draw(st.integers(0, len(texts[-1]))), draw(st.sampled_from(list('{}[]",:.-0e \\\n')))
            texts[-1] = texts[-1][:at] + byte + texts[-1][at + 1 :]
    return [text.encode("utf-8", "surrogatepass") for text in texts]


def told(decoder: JsonDecoder, payloads: list[bytes]) -> Any:
    """All that is decoded; numbers that are no times and names as floats, which they become."""
    decoded = decode(decoder, payloads)
    columns = {}
    for name in decoded.columns:
        values = plain(decoded, name)
        if name.partition(".")[0] not in ("time", "time_ns", "vehicle_id"):
            values = [None if value is None else str(float(value) + 0.0) for value in values]
        elif name == "vehicle_id" and any(isinstance(value, str) for value in values):
            values = [None if value is None else str(value) for value in values]
        if any(value is not None for value in values):
            columns[name] = values
    return decoded.rows.tolist(), [(row, str(error)) for row, error in decoded.bad], columns


@pytest.mark.parametrize("many", [False, True])
@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_forms_never_tell_what_a_parser_would_not(many: bool, data: st.DataObject) -> None:
    payloads = data.draw(messages(many))
    decoder, exact = JsonDecoder(MANY if many else ONE), JsonDecoder(MANY if many else ONE)
    exact.decode = lambda *_: exact._exact(payloads)  # type: ignore[method-assign]
    assert told(decoder, payloads) == told(exact, payloads)


def test_messages_of_one_hand_are_read_by_forms(by_form: list[int]) -> None:
    line = '{"t": {"sec": %d, "nsec": 2}, "id": "v%d", "p": {"x": %r, "y": [%s]}, "v": %s}'
    payloads = [(line % (k, k % 3, -0.1 * k, "1e-7" if k % 5 else "7", 12)).encode() for k in range(40)] + [
        b'{"t": {"sec": 41}, "id": "a,b"}',
        b"{",
    ]
    decoder = JsonDecoder(ONE)
    first, second = decode(decoder, payloads), decode(decoder, payloads)
    assert by_form == [40, 40]
    assert plain(first, "x_m") == [-0.1 * k for k in range(40)] + [None]
    assert plain(first, "vehicle_id") == [f"v{k % 3}" for k in range(40)] + ["a,b"]
    assert [row for row, _ in second.bad] == [41]


def test_lists_of_one_form_give_their_items_in_order(by_form: list[int]) -> None:
    item = '{"id": %d, "x": %r, "v": {"x": 1.5, "y": 0}}'
    payloads = [
        f'{{"t": {k}, "cars": [{", ".join(item % (v, k + v / 8) for v in range(3))}]}}'.encode()
        for k in range(20)
    ]
    decoded = decode(JsonDecoder(MANY), payloads)
    assert by_form == [20]
    assert decoded.rows.tolist() == [k for k in range(20) for _ in range(3)]
    assert plain(decoded, "x_m") == [k + v / 8 for k in range(20) for v in range(3)]
    assert plain(decoded, "time_ns") == [k for k in range(20) for _ in range(3)]
    assert plain(decoded, "vehicle_id") == [0, 1, 2] * 20


def test_a_text_where_a_number_is_wanted_is_unknown_and_leaves_the_others_known() -> None:
    payloads = [LINE.replace("1.5", value).encode() for value in ("1.5", '"east"', "2", '"1.5"', "3e0")]
    decoded = decode(JsonDecoder(Mapping({"x_m": "pose.x", "vehicle_id": "id"})), payloads)
    assert plain(decoded, "x_m") == [1.5, None, 2.0, None, 3.0]


def test_names_that_are_numbers_stay_apart() -> None:
    payloads = [b'{"id": %s}' % value for value in (b"1.5", b"1.25", b"NaN", b"7", b'"7"')]
    decoded = decode(JsonDecoder(Mapping({"vehicle_id": "id"})), payloads)
    assert plain(decoded, "vehicle_id") == ["1.5", "1.25", "nan", "7", "7"]


def test_no_payloads_give_nothing() -> None:
    decoded = JsonDecoder(ONE).decode(np.zeros(32, np.uint8), np.zeros(0, np.int64), np.zeros(0, np.int64))
    assert (len(decoded.rows), decoded.columns, decoded.bad) == (0, {}, [])


def test_booleans_and_other_alphabets_keep_messages_in_their_form(by_form: list[int]) -> None:
    line = '{"t": {"sec": 1}, "id": "%s", "on": %s, "p": {"x": 1.5}, "v": 2}'
    names, flags = ["ä1", "b", "日本", 'q"', "ä\x01"], ["true", "false", "true", "false", "true"]
    payloads = [(line % pair).encode() for pair in zip(names, flags, strict=True)] * 4
    payloads.append(payloads[0].replace("ä".encode(), b"\xe4"))
    payloads.append(payloads[0].replace(b"true", b"tru "))
    decoded = decode(JsonDecoder(ONE), payloads)
    assert by_form[0] == 12
    assert plain(decoded, "vehicle_id") == names[:3] * 4
    assert [row for row, _ in decoded.bad] == [*(k for k in range(20) if k % 5 > 2), 20, 21]


def test_messages_of_many_numbers_with_exponents_are_left_to_a_parser(by_form: list[int]) -> None:
    payload = b'{"id": "a", "p": {"x": 1e5}, "q": [' + b", ".join([b"1e5"] * 900) + b"]}"
    decoded = decode(JsonDecoder(ONE), [payload] * 10)
    assert sum(by_form) == 0
    assert plain(decoded, "x_m") == [1e5] * 10
