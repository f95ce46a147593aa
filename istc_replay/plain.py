"""The data types as plain values that JSON can hold, and back, exactly.

Only the types of `datatypes` are made again: what is read cannot name any other.
"""

from __future__ import annotations

import base64
import dataclasses
from enum import StrEnum
from typing import Any

import numpy as np

from istc_replay import datatypes
from istc_replay.datatypes import read_only
from istc_replay.errors import LogError

_TYPES: dict[str, type[Any]] = {
    name: kind
    for name, kind in vars(datatypes).items()
    if isinstance(kind, type) and (dataclasses.is_dataclass(kind) or issubclass(kind, StrEnum))
}
_KIND, _ARRAY = "kind", "array"


def to_plain(value: Any) -> Any:
    """Turn data types, tuples, dicts and arrays into dicts, lists and strings.

    Raises
    ------
    TypeError
        If there is a value of any other type.
    """
    if isinstance(value, StrEnum):
        return {_KIND: type(value).__name__, "value": value.value}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        data = base64.b64encode(np.ascontiguousarray(value, dtype="<f8").tobytes()).decode()
        return {_KIND: _ARRAY, "shape": list(value.shape), "data": data}
    if isinstance(value, tuple | list):
        return [to_plain(item) for item in value]
    if isinstance(value, dict):
        return {_KIND: "dict", "items": [[key, to_plain(item)] for key, item in value.items()]}
    name = type(value).__name__
    if _TYPES.get(name) is not type(value):
        raise TypeError(f"{name} is no type of the data that flows")
    fields = {field.name: to_plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    return {_KIND: name, "fields": fields}


def from_plain(value: Any) -> Any:
    """Make the data types again; every list becomes a tuple.

    Raises
    ------
    LogError
        If the values are not what `to_plain` gives.
    """
    try:
        return _made(value)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise LogError(f"not a stored plan: {error}") from None


def _made(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_made(item) for item in value)
    if not isinstance(value, dict):
        return value
    kind = value[_KIND]
    if kind == _ARRAY:
        data = np.frombuffer(base64.b64decode(value["data"], validate=True), dtype="<f8")
        return read_only(data.reshape(value["shape"]))
    if kind == "dict":
        return {key: _made(item) for key, item in value["items"]}
    made = _TYPES[kind]
    if issubclass(made, StrEnum):
        return made(value["value"])
    return made(**{name: _made(item) for name, item in value["fields"].items()})
