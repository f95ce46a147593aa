"""Reading JSON payloads by Polars, which takes keys in any order and anything between them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import polars as pl

from istc_replay.ingest.layout import Column
from istc_replay.ingest.payload import PayloadError
from istc_replay.ingest.wanted import Node

Whole = Callable[[str], bool]


def read_lines(
    payloads: list[bytes], first: dict[str, Any], root: Node, whole: Whole
) -> dict[str, Column] | None:
    """Read payloads as one table.

    Parameters
    ----------
    payloads : list of bytes
        What is read.
    first : dict
        The first of them, which says what kinds of values there are.
    root : Node
        What is wanted.
    whole : callable
        Tells by its target whether a number that is written without a point is told as an integer.

    Returns
    -------
    dict[str, Column] or None
        The columns by name; None where any payload is not as the first one is.
    """
    try:
        schema = pl.Schema(_schema(root, first, whole))
    except PayloadError:
        return None
    if not schema:
        return None
    lines = b"\n".join(payloads)
    if lines.count(b"\n") >= len(payloads):
        # A line break may stand between the tokens of JSON, never within one.
        lines = b"\n".join(payload.replace(b"\n", b" ") for payload in payloads)
    try:
        table = pl.read_ndjson(lines, schema=schema)
    except (pl.exceptions.PolarsError, ValueError, OverflowError):
        return None
    if table.height != len(payloads):
        return None
    return {target: _column_of(column) for target, column in _columns(root, first, table, whole)}


def _schema(node: Node, value: Any, whole: Whole) -> dict[str, pl.DataType]:
    """Make the table's schema of the wanted values as the first payload has them."""
    schema: dict[str, pl.DataType] = {}
    for name, child in node.children.items():
        inner = value.get(name)
        if isinstance(inner, dict):
            fields = _schema(child, inner, whole)
            if child.targets:
                fields |= {
                    key: dtype
                    for key, plain in inner.items()
                    if (dtype := _dtype(child, plain, whole)) is not None
                }
            if not fields:
                raise PayloadError("nothing in it is wanted")
            schema[name] = pl.Struct(fields)
        elif child.children or (dtype := _dtype(child, inner, whole)) is None:
            raise PayloadError("the first payload does not show what is wanted")
        else:
            schema[name] = dtype
    return schema


def _dtype(node: Node, value: Any, whole: Whole) -> pl.DataType | None:
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    if isinstance(value, str):
        return pl.String()
    # Times and ids are whole numbers; others may be written without a point now and then.
    return pl.Int64() if isinstance(value, int) and any(map(whole, node.targets)) else pl.Float64()


def _columns(node: Node, value: Any, table: pl.DataFrame, whole: Whole) -> Iterator[tuple[str, pl.Series]]:
    """Give the columns of the targets, by the first payload as the table's schema was made."""
    for name, child in node.children.items():
        inner = value[name]
        if not isinstance(inner, dict):
            yield from ((target, table[name]) for target in child.targets)
            continue
        parts = table[name].struct.unnest()
        for target in child.targets:
            for key, plain in inner.items():
                if _dtype(child, plain, whole) is not None:
                    yield f"{target}.{key}", parts[key]
        yield from _columns(child, inner, parts, whole)


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
