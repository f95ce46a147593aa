"""From decoded columns to states: what the fields of a mapping mean."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from istc_replay.ingest.batches import Ints, distinct
from istc_replay.ingest.layout import Column, Decoded
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.units import NS_PER_S

Floats = NDArray[np.float64]

#: Targets that are taken over as they are.
PLAIN = (
    "x_m",
    "y_m",
    "heading_rad",
    "speed_mps",
    "acceleration_mps2",
    "steering_rad",
    "steering_rate_radps",
    "jerk_mps3",
    "length_m",
    "width_m",
    "wheelbase_m",
    "rear_axle_to_centre_m",
)
#: What is wanted as a number besides, by the first part of its name.
_NUMBERS = frozenset(
    (*PLAIN, "time", "time_ns", "time_s", "heading_deg", "latitude", "longitude")
    + ("position", "orientation", "velocity", "acceleration")
)
#: Names of a vehicle's own frame that do not tell which vehicle.
GENERIC_FRAMES = {"", "base_link", "base_footprint", "base", "body", "ego", "rear_axle"}
#: A quaternion's norm may differ this much from 1.
_NORM_TOLERANCE = 1e-3
_SECONDS = ("sec", "secs", "seconds")
_NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")
#: Times beyond this many seconds are beyond int64 nanoseconds.
_SECONDS_LIMIT = 9_223_372_035
ROLES = ("vehicle", "pedestrian", "bicycle", "other")


@dataclass(slots=True, eq=False)
class States:
    """States of one group of payloads, in their order; all arrays have the shape (m,).

    `rows` are the payloads' rows, `header_ns` is 0 where not `stamped`, and `overflows` where the
    message's own time is beyond int64. `vehicles`, `frames` and `children` are codes into `names`,
    -1 where nothing is told. `numbers` has the floats that are told, NaN where they are not.
    """

    rows: Ints
    header_ns: Ints
    stamped: NDArray[np.bool_]
    overflows: NDArray[np.bool_]
    vehicles: Ints
    frames: Ints
    children: Ints
    roles: Ints
    numbers: dict[str, Floats]
    known: dict[str, NDArray[np.bool_]]


class Names:
    """Texts by code, the same for a whole log."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self._codes: dict[str, int] = {}

    def code(self, text: str) -> int:
        """Return the code of a text, made where it is new."""
        known = self._codes.get(text)
        if known is None:
            known = self._codes[text] = len(self.texts)
            self.texts.append(text)
        return known

    def codes(self, column: Column | None, count: int) -> Ints:
        """Code a column of ids or names: (count,), -1 where there is none."""
        if column is None:
            return np.full(count, -1, np.int64)
        if column.texts is None:
            values, own = distinct(column.values)
            texts: list[Any] = [number_name(value) for value in values.tolist()]
        else:
            texts, own = column.texts, column.values
        table = [-1 if text is None else self.code(_name(text)) for text in texts]
        codes = np.array(table or [-1], np.int64)[own]
        return codes if column.valid is None else np.where(column.valid, codes, -1)


def number_name(value: float) -> str:
    """Name what a number names; a whole one without a point."""
    return str(int(value)) if float(value).is_integer() else str(value)


def _name(text: str | bytes) -> str:
    if isinstance(text, str):
        return text
    if len(text) == 16:  # a UUID
        plain = text.hex()
        return "-".join((plain[:8], plain[8:12], plain[12:16], plain[16:20], plain[20:]))
    return text.hex()


Roles = Callable[[dict[str, Column], int], Ints]


@dataclass(slots=True)
class Meaning:
    """How one kind of message is understood beyond its mapping."""

    problems: Problems
    names: Names
    roles: Roles | None = None
    zero_is_unset: tuple[str, ...] = ()
    places: Callable[[Floats, Floats, NDArray[np.bool_]], tuple[Floats, Floats]] | None = None

    def states(self, decoded: Decoded, topic_of: Callable[[Ints], str]) -> States:
        """Make states of decoded columns; `topic_of` names the topic of a row, for problems."""
        columns, count = decoded.columns, len(decoded.rows)
        numbers, known = self._numbers(columns, count)
        header_ns, stamped, overflows = _times(columns, count)
        self._heading(columns, numbers, known, decoded.rows, topic_of)
        self._vectors(columns, numbers, known)
        self._positions(columns, numbers, known)
        vehicle = (
            columns.get("vehicle_id") or columns.get("vehicle_id.uuid") or columns.get("vehicle_id.value")
        )
        roles = np.zeros(count, np.int64) if self.roles is None else self.roles(columns, count)
        return States(
            decoded.rows,
            header_ns,
            stamped,
            overflows,
            self.names.codes(vehicle, count),
            self.names.codes(columns.get("frame"), count),
            self.names.codes(columns.get("vehicle_frame"), count),
            roles,
            numbers,
            known,
        )

    def _numbers(
        self, columns: dict[str, Column], count: int
    ) -> tuple[dict[str, Floats], dict[str, NDArray[np.bool_]]]:
        numbers: dict[str, Floats] = {}
        known: dict[str, NDArray[np.bool_]] = {}
        for name in PLAIN:
            column = columns.get(name)
            if column is None or column.texts is not None:
                continue
            numbers[name] = column.values.astype(np.float64, copy=False)
            known[name] = np.ones(count, np.bool_) if column.valid is None else column.valid
            if name in self.zero_is_unset:
                known[name] = known[name] & (numbers[name] != 0.0)
        if "heading_deg" in columns:
            heading, valid = number(columns, "heading_deg", count)
            numbers["heading_rad"], known["heading_rad"] = np.radians(heading), valid
        return numbers, known

    def _heading(
        self,
        columns: dict[str, Column],
        numbers: dict[str, Floats],
        known: dict[str, NDArray[np.bool_]],
        rows: Ints,
        topic_of: Callable[[Ints], str],
    ) -> None:
        """Yaw of the quaternion, where it is a rotation."""
        if not any(f"orientation.{axis}" in columns for axis in "xyzw"):
            return
        parts = [number(columns, f"orientation.{axis}", len(rows)) for axis in "xyzw"]
        told = np.logical_and.reduce([valid for _, valid in parts])
        x, y, z, w = (values for values, _ in parts)
        with np.errstate(all="ignore"):
            norm = np.sqrt(x * x + y * y + z * z + w * w)
            rotation = np.abs(norm - 1.0) <= _NORM_TOLERANCE
            heading = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        wrong = np.flatnonzero(told & ~rotation)
        if len(wrong):
            topic = topic_of(rows[wrong[:1]])
            detail = f"a quaternion of norm {norm[wrong[0]]:.6g} on {quoted(topic)} gives no heading"
            self.problems.add("quaternion", detail, kind=topic, times=len(wrong))
        numbers["heading_rad"], known["heading_rad"] = heading, told & rotation

    def _vectors(
        self, columns: dict[str, Column], numbers: dict[str, Floats], known: dict[str, NDArray[np.bool_]]
    ) -> None:
        """Components along the heading of vectors of the map frame."""
        vectors = (("velocity", "speed_mps"), ("acceleration", "acceleration_mps2"))
        told = [(name, target) for name, target in vectors if f"{name}.x" in columns]
        if not told or "heading_rad" not in numbers:
            return
        heading = numbers["heading_rad"]
        with np.errstate(all="ignore"):
            along, across = np.cos(heading), np.sin(heading)
        turned = known["heading_rad"] & np.isfinite(heading)
        for name, target in told:
            x, valid = number(columns, f"{name}.x", len(heading))
            y, _ = number(columns, f"{name}.y", len(heading))
            with np.errstate(all="ignore"):
                numbers[target] = x * along + y * across
            known[target] = valid & turned

    def _positions(
        self, columns: dict[str, Column], numbers: dict[str, Floats], known: dict[str, NDArray[np.bool_]]
    ) -> None:
        count = len(next(iter(columns.values())).values) if columns else 0
        if "position.x" in columns:
            for axis in "xy":
                numbers[f"{axis}_m"], known[f"{axis}_m"] = number(columns, f"position.{axis}", count)
        if self.places is not None and "latitude" in columns:
            latitude, valid = number(columns, "latitude", count)
            longitude, also = number(columns, "longitude", count)
            valid = valid & also & np.isfinite(latitude) & np.isfinite(longitude)
            numbers["x_m"], numbers["y_m"] = self.places(latitude, longitude, valid)
            known["x_m"] = known["y_m"] = valid


def number(columns: dict[str, Column], name: str, count: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Return a column as floats, and where it is told; nowhere if it is missing or a text."""
    column = columns.get(name)
    if column is None or column.texts is not None:
        return np.zeros(count), np.zeros(count, np.bool_)
    valid = np.ones(count, np.bool_) if column.valid is None else column.valid
    return column.values.astype(np.float64, copy=False), valid


def is_number(name: str) -> bool:
    """Whether a leaf is wanted as a number."""
    return name.partition(".")[0] in _NUMBERS


def texts_for_numbers(decoded: Decoded) -> list[tuple[str, Ints]]:
    """The leaves that have texts where numbers are wanted, with the rows of their payloads."""
    columns = [(name, column) for name, column in decoded.columns.items() if is_number(name)]
    return [
        *decoded.texts,
        *((name, at) for name, column in columns if len(at := column.texts_at(decoded.rows))),
    ]


def whole(columns: dict[str, Column], name: str, count: int) -> Ints:
    """Return a column as integers, -1 where it is not told."""
    column = columns.get(name)
    if column is None or column.texts is not None:
        return np.full(count, -1, np.int64)
    values = column.values.astype(np.int64)
    return values if column.valid is None else np.where(column.valid, values, -1)


def _times(columns: dict[str, Column], count: int) -> tuple[Ints, NDArray[np.bool_], NDArray[np.bool_]]:
    """Times of the messages' own [ns], where they are told, and where they are beyond int64."""
    none = np.zeros(count, np.bool_)
    for name in ("time_ns", "time"):
        column = columns.get(name)
        if column is not None and column.texts is None:
            told = ~none if column.valid is None else column.valid
            if column.values.dtype == np.uint64:
                over = column.values >= 2**63
                return column.values.astype(np.int64), told, over & told
            if column.values.dtype == np.int64:
                return column.values, told, none
    if "time_s" in columns:
        seconds, told = number(columns, "time_s", count)
        over = told & ~(np.abs(seconds) < _SECONDS_LIMIT)
        return np.rint(np.where(over, 0.0, seconds) * NS_PER_S).astype(np.int64), told, over
    column = next((columns[f"time.{name}"] for name in _SECONDS if f"time.{name}" in columns), None)
    if column is None or column.texts is not None:
        return np.zeros(count, np.int64), none, none
    told = ~none if column.valid is None else column.valid
    seconds_ = column.values
    over = told & ((seconds_ > _SECONDS_LIMIT) | (seconds_ < -_SECONDS_LIMIT))
    time_ns = np.where(over, 0, seconds_).astype(np.int64) * NS_PER_S
    rest = next((columns[f"time.{name}"] for name in _NANOSECONDS if f"time.{name}" in columns), None)
    if rest is not None and rest.texts is None:
        extra = rest.values if rest.valid is None else np.where(rest.valid, rest.values, 0)
        wild = (extra > 2**32) | (extra < -(2**32))
        over, time_ns = over | (told & wild), time_ns + np.where(wild, 0, extra).astype(np.int64)
    return time_ns, told, over


def vehicle_of(topic: str, child_frame: str) -> str:
    """Name the vehicle of a frame: its path, else its own name, else the first part of the topic."""
    prefix, _, name = child_frame.strip("/").rpartition("/")
    if prefix:
        return prefix
    if name not in GENERIC_FRAMES:
        return name
    return topic.strip("/").split("/")[0] or name
