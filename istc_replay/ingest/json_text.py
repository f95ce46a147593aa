"""Decoding JSON payloads: by forms where many are written alike, by Polars where they tell alike, or each."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from istc_replay.ingest.batches import Bytes, Ints, distinct
from istc_replay.ingest.json_form import Commas, Form
from istc_replay.ingest.json_lines import read_lines
from istc_replay.ingest.layout import Column, Decoded, joined
from istc_replay.ingest.meaning import is_number, number_name
from istc_replay.ingest.payload import ITEMS_AT_ONCE, PayloadError, TooManyItemsError
from istc_replay.ingest.wanted import Mapping, Node, tree

#: Brackets in one payload that Polars is given: how deeply it may nest is not known.
_BRACKETS = 2000
_ITEMS = 20_000
_INT64 = 2**63
#: What is told in whole numbers, and what may be told as text.
_WHOLE, _TEXTS = {"time", "time_ns", "vehicle_id"}, {"vehicle_id", "vehicle_frame", "frame"}
#: A form that no more than one message in so many has is not kept; so many such, and what is left is parsed.
_FEW, _TRIES = 16, 4


class JsonDecoder:
    """Decodes JSON objects; has the interface of Decoder. Of a repeated key, the first holds."""

    def __init__(self, mapping: Mapping) -> None:
        self._root = tree(mapping)
        self._items = [name for name in mapping.items.split(".") if name]
        self._forms: list[Form] = []

    def decode(self, data: Bytes, starts: Ints, ends: Ints) -> Decoded:
        """Decode the payloads that these spans of data hold."""
        parts, left = self._by_forms(data, starts, ends)
        bad: list[tuple[int, PayloadError]] = []
        texts: list[tuple[str, Ints]] = []
        if len(left):
            rest = self._parsed(_cut(data, starts[left], ends[left]))
            parts.append((left[rest.rows], rest.columns))
            bad = [(int(left[row]), error) for row, error in rest.bad]
            texts = [(name, left[rows]) for name, rows in rest.texts]
        return _together(parts, bad, texts)

    def _by_forms(
        self, data: Bytes, starts: Ints, ends: Ints
    ) -> tuple[list[tuple[Ints, dict[str, Column]]], Ints]:
        """Decode what is of a form that is known or of several messages; returns the rows that are left."""
        parts: list[tuple[Ints, dict[str, Column]]] = []
        commas = Commas(data, starts, ends)
        left = np.arange(len(starts))

        def read(form: Form) -> int:
            nonlocal left
            rows, columns = form.read(data, starts, ends, commas, left)
            if len(rows):
                parts.append((np.repeat(rows, len(form.items)), columns))
                left = np.setdiff1d(left, rows, assume_unique=True)
            return len(rows)

        few = len(left) // _FEW
        kept = [form for form in self._forms if read(form) > few]
        odd: list[int] = []
        tries = _TRIES
        while len(left) and tries:
            first = left[0]
            form_ = Form.of(data[starts[first] : ends[first]].tobytes(), self._numbered, _is_whole)
            taken = read(form_) if form_ else 0
            if form_ and taken > few:
                kept.append(form_)
            else:
                tries -= 1
            if len(left) and left[0] == first:
                odd, left = [*odd, int(first)], left[1:]
        self._forms = kept
        return parts, np.concatenate([np.array(odd, np.int64), left])

    def _numbered(self, payload: bytes) -> Iterable[dict[str, Any]]:
        return self._values(_load(payload))

    def _parsed(self, payloads: list[bytes]) -> Decoded:
        # What is shorter than this cannot nest more deeply.
        deep = max(map(len, payloads)) > _BRACKETS and any(map(_is_deep, payloads))
        if not self._items and not deep:
            try:
                columns = read_lines(payloads, _load(payloads[0]), self._root, _is_whole)
            except PayloadError:
                columns = None
            if columns is not None:
                return Decoded(np.arange(len(payloads)), columns, [])
        return self._exact(payloads)

    def _exact(self, payloads: list[bytes]) -> Decoded:
        rows: list[int] = []
        found: list[dict[str, Any]] = []
        bad: list[tuple[int, PayloadError]] = []
        for row, payload in enumerate(payloads):
            try:
                items = list(self._values(_load(payload)))
            except PayloadError as error:
                bad.append((row, error))
                continue
            rows += [row] * len(items)
            found += items
            if len(found) > ITEMS_AT_ONCE and len(payloads) > 1:
                raise TooManyItemsError(max(row, 1))
        names = sorted({name for item in found for name in item})
        columns, texts = {}, []
        for name in names:
            values = [item.get(name) for item in found]
            columns[name] = _column(name, values)
            if is_number(name):
                odd = [row for row, value in zip(rows, values, strict=True) if isinstance(value, str)]
                texts += [(name, np.array(odd, np.int64))] if odd else []
        return Decoded(np.array(rows, np.int64), columns, bad, tuple(texts))

    def _values(self, value: dict[str, Any]) -> Iterator[dict[str, Any]]:
        header: dict[str, Any] = {}
        _gather(self._root, value, header, "")
        if not self._items:
            yield header
            return
        node = self._root
        parts: Any = value
        for name in self._items:
            node, parts = node.children[name], parts.get(name) if isinstance(parts, dict) else None
        if parts is None:
            return
        if not isinstance(parts, list):
            raise PayloadError(f"{'.'.join(self._items)!r} is not a list")
        if len(parts) > _ITEMS:
            raise PayloadError(f"a list of {len(parts)} items, above the limit of {_ITEMS}")
        for part in parts:
            item = dict(header)
            _gather(Node(node.children), part, item, "")
            yield item


def _cut(data: Bytes, starts: Ints, ends: Ints) -> list[bytes]:
    raw = data.base if isinstance(data.base, bytes) else data.tobytes()
    return list(map(raw.__getitem__, map(slice, starts.tolist(), ends.tolist())))


def _is_deep(payload: bytes) -> bool:
    return payload.count(b"{") + payload.count(b"[") > _BRACKETS


def _load(payload: bytes) -> dict[str, Any]:
    try:
        value = json.loads(payload, object_pairs_hook=lambda pairs: dict(reversed(pairs)))
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())[:120]
        raise PayloadError(f"not JSON: {reason}") from None
    if not isinstance(value, dict):
        raise PayloadError("not a JSON object")
    return value


def _gather(node: Node, value: Any, found: dict[str, Any], where: str) -> None:
    """Take the wanted values out of a JSON value."""
    if node.items:
        return
    for target in node.targets:
        for name, plain in _plain(target, value):
            if plain is not None:
                found[name] = _sound(plain, where)
    for name, child in node.children.items():
        inner = None
        if isinstance(value, dict):
            inner = value.get(name)
        elif isinstance(value, list) and name.isdigit() and int(name) < len(value):
            inner = value[int(name)]
        if inner is not None:
            _gather(child, inner, found, f"{where}{name}.")


def _plain(target: str, value: Any) -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        plain = ((name, inner) for name, inner in value.items() if not isinstance(inner, (dict, list)))
        return [(f"{target}.{name}", inner) for name, inner in plain]
    return [(target, value)]


def _sound(value: Any, where: str) -> Any:
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise PayloadError(f"{where.rstrip('.')!r} is neither a number nor a text")
    return value


def _column(name: str, values: list[Any]) -> Column:
    """Make a column of plain values; of texts if any is one and may be, else a text is unknown."""
    if any(isinstance(value, str) for value in values):
        if _target(name) in _TEXTS:
            valid = np.array([value is not None for value in values], np.bool_)
            codes: dict[Any, int] = {}
            own = [codes.setdefault(_name(value), len(codes)) for value in values]
            return Column(np.array(own, np.int64), valid, list(codes))
        values = [None if isinstance(value, str) else value for value in values]
    valid = np.array([value is not None for value in values], np.bool_)
    if all(value is None or (isinstance(value, int) and abs(value) < _INT64) for value in values):
        return Column(np.array([value or 0 for value in values], np.int64), valid)
    floats = [np.nan if value is None else _float(value) for value in values]
    return Column(np.array(floats, np.float64), valid)


def _float(value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        return float("inf")


def _target(name: str) -> str:
    return name.partition(".")[0]


def _is_whole(name: str) -> bool:
    return _target(name) in _WHOLE


def _together(
    parts: list[tuple[Ints, dict[str, Column]]],
    bad: list[tuple[int, PayloadError]],
    texts: list[tuple[str, Ints]],
) -> Decoded:
    """Join what was decoded apart, in the order of the payloads; a payload's items stay in theirs."""
    rows = np.concatenate([np.zeros(0, np.int64), *(own for own, _ in parts)])
    turn = np.argsort(rows, kind="stable")
    columns: dict[str, Column] = {}
    for name in sorted({name for _, own in parts for name in own}):
        told = [own.get(name) or _unknown(len(of)) for of, own in parts]
        if _target(name) not in _TEXTS:
            if is_number(name):
                odd = [own[name].texts_at(of) for of, own in parts if name in own]
                texts += [(name, at) for at in odd if len(at)]
            told = [column if column.texts is None else _unknown(len(column.values)) for column in told]
        elif any(column.texts is not None for column in told):
            told = [column if column.texts is not None else _as_texts(column) for column in told]
        columns[name] = joined(told, turn) if len(told) > 1 else told[0]
    return Decoded(rows[turn], columns, bad, tuple(texts))


def _name(value: Any) -> str:
    return value if isinstance(value, str) else "" if value is None else number_name(value)


def _unknown(count: int) -> Column:
    return Column(np.zeros(count, np.int64), np.zeros(count, np.bool_))


def _as_texts(column: Column) -> Column:
    values, own = distinct(column.values)
    return Column(own, column.valid, [number_name(value) for value in values.tolist()])
