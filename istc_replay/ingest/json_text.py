"""Decoding JSON payloads: whole batches by Polars where they are regular, else one by one."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import polars as pl

from istc_replay.ingest.batches import Bytes, Ints
from istc_replay.ingest.layout import Column, Decoded
from istc_replay.ingest.payload import ITEMS_AT_ONCE, PayloadError, TooManyItemsError
from istc_replay.ingest.wanted import Mapping, Node, tree

#: Brackets in one payload that the fast reader is given: how deeply it may nest is not known.
_BRACKETS = 2000
_ITEMS = 20_000
#: Bytes between two payloads that are blanked at most, in words of eight spaces.
_GAP, _WORD, _SPACES = 64, 8, 0x2020202020202020
_LINE_BREAK = 10
_INT64 = 2**63
#: What is told in whole numbers.
_WHOLE = {"time", "time_ns", "vehicle_id"}


class JsonDecoder:
    """Decodes JSON objects; has the interface of Decoder. Of a repeated key, the first holds."""

    def __init__(self, mapping: Mapping) -> None:
        self._root = tree(mapping)
        self._items = [name for name in mapping.items.split(".") if name]

    def decode(self, data: Bytes, starts: Ints, ends: Ints) -> Decoded:
        """Decode the payloads that these spans of data hold."""
        # What is shorter than this cannot nest more deeply.
        deep = int((ends - starts).max(initial=0)) > _BRACKETS and any(
            map(_is_deep, _cut(data, starts, ends))
        )
        columns = None if self._items or deep else self._fast(data, starts, ends)
        if columns is not None:
            return Decoded(np.arange(len(starts)), columns, [])
        return self._exact(_cut(data, starts, ends))

    # --- by Polars -----------------------------------------------------------------------------

    def _fast(self, data: Bytes, starts: Ints, ends: Ints) -> dict[str, Column] | None:
        """Read all payloads as one table; None where any of them is not as the first one is."""
        try:
            first = _load(data[starts[0] : ends[0]].tobytes())
            schema = pl.Schema(_schema(self._root, first))
        except PayloadError:
            return None
        if not schema:
            return None
        lines = _lines(data, starts, ends)
        try:
            table = pl.read_ndjson(lines, schema=schema)
        except (pl.exceptions.PolarsError, ValueError, OverflowError):
            return None
        if table.height != len(starts):
            return None
        return {target: _column_of(column) for target, column in _columns(self._root, first, table)}

    # --- one by one ----------------------------------------------------------------------------

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
        columns = {name: _column([item.get(name) for item in found]) for name in names}
        return Decoded(np.array(rows, np.int64), columns, bad)

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


def _lines(data: Bytes, starts: Ints, ends: Ints) -> bytes:
    """Put each payload on a line of its own; what stands between two is blanked, where it is short."""
    gaps = starts[1:] - ends[:-1]
    if gaps.min(initial=_WORD) >= _WORD and gaps.max(initial=0) <= _GAP:
        text = data[starts[0] : ends[-1]].copy()
        ended = ends[:-1] - starts[0]
        # Eight bytes at a time, wherever they stand; the last eight may overlap those before.
        words = np.ndarray(max(len(text) - _WORD + 1, 0), np.uint64, text, strides=(1,))
        for step in range(0, int(gaps.max(initial=0)), _WORD):
            words[ended + np.minimum(step, gaps - _WORD)] = _SPACES
        text[ended] = _LINE_BREAK
        if np.count_nonzero(text == _LINE_BREAK) < len(starts):
            return text.tobytes()
    # A line break may stand between the tokens of JSON, never within one.
    return b"\n".join(payload.replace(b"\n", b" ") for payload in _cut(data, starts, ends))


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


def _column(values: list[Any]) -> Column:
    """Make a column of plain values; texts if any of them is one."""
    valid = np.array([value is not None for value in values], np.bool_)
    if any(isinstance(value, str) for value in values):
        codes: dict[Any, int] = {}
        own = [codes.setdefault("" if value is None else str(value), len(codes)) for value in values]
        return Column(np.array(own, np.int64), valid, list(codes))
    if all(value is None or (isinstance(value, int) and abs(value) < _INT64) for value in values):
        return Column(np.array([value or 0 for value in values], np.int64), valid)
    floats = [np.nan if value is None else _float(value) for value in values]
    return Column(np.array(floats, np.float64), valid)


def _float(value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        return float("inf")


def _schema(node: Node, value: Any) -> dict[str, pl.DataType]:
    """Make the table's schema of the wanted values as the first payload has them."""
    schema: dict[str, pl.DataType] = {}
    for name, child in node.children.items():
        inner = value.get(name)
        if isinstance(inner, dict):
            fields = _schema(child, inner)
            if child.targets:
                fields |= {
                    key: dtype for key, plain in inner.items() if (dtype := _dtype(child, plain)) is not None
                }
            if not fields:
                raise PayloadError("nothing in it is wanted")
            schema[name] = pl.Struct(fields)
        elif child.children or (dtype := _dtype(child, inner)) is None:
            raise PayloadError("the first payload does not show what is wanted")
        else:
            schema[name] = dtype
    return schema


def _dtype(node: Node, value: Any) -> pl.DataType | None:
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    if isinstance(value, str):
        return pl.String()
    # Times and ids are whole numbers; others may be written without a point now and then.
    whole = isinstance(value, int) and not _WHOLE.isdisjoint(node.targets)
    return pl.Int64() if whole else pl.Float64()


def _columns(node: Node, value: Any, table: pl.DataFrame) -> Iterator[tuple[str, pl.Series]]:
    """Give the columns of the targets, by the first payload as the table's schema was made."""
    for name, child in node.children.items():
        inner = value[name]
        if not isinstance(inner, dict):
            yield from ((target, table[name]) for target in child.targets)
            continue
        parts = table[name].struct.unnest()
        for target in child.targets:
            for key, plain in inner.items():
                if _dtype(child, plain) is not None:
                    yield f"{target}.{key}", parts[key]
        yield from _columns(child, inner, parts)


def _column_of(column: pl.Series) -> Column:
    valid = column.is_not_null().to_numpy() if column.null_count() else None
    if column.dtype == pl.String:
        told = column.fill_null("")
        texts = told.unique()
        codes = told.cast(pl.Enum(texts)).to_physical().to_numpy()
        return Column(codes.astype(np.int64), valid, texts.to_list())
    if valid is not None:
        column = column.fill_null(0 if column.dtype == pl.Int64 else 0.0)
    return Column(column.to_numpy(), valid)
