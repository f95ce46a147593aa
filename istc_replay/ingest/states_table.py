"""From blocks of states to the states table: box centres, sorted, what is missing derived."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from istc_replay.config import VehiclesConfig
from istc_replay.ingest.batches import distinct
from istc_replay.ingest.columns import Block, Ints, Mask
from istc_replay.ingest.meaning import PLAIN, ROLES, Floats, Names
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.states import STATES_SCHEMA
from istc_replay.units import NS_PER_S, wrap_angle

#: Bits of the column `derived`.
HEADING_DERIVED, SPEED_DERIVED, ACCELERATION_DERIVED = 1, 2, 4
#: Neighbours further apart in time than this give no derived value.
_LONGEST_STEP_NS = NS_PER_S
#: Shorter displacements between the neighbours give no heading [m].
_LEAST_MOVE_M = 0.2
#: The recorder's and the message's clock drift apart by more than this at once: one of them was set.
_CLOCK_STEP_NS = NS_PER_S // 2


@dataclass(slots=True, eq=False)
class Columns:
    """The states of a log, all arrays (n,); see Block."""

    whole: dict[str, Ints]
    numbers: dict[str, Floats]

    @classmethod
    def of(cls, blocks: list[Block]) -> Columns:
        """Join blocks into the order of the log; the blocks are used up."""
        whole: dict[str, Ints] = {}
        names = ("ordinal", "time_ns", "log_time_ns", "publish_time_ns", "message_index", "topic", "vehicle")
        for name in (*names, "role"):
            parts = [block.whole.pop(name) for block in blocks]
            whole[name] = np.concatenate(parts) if parts else np.zeros(0, np.int64)
        told = {name for block in blocks for name in block.numbers} | {
            "x_m",
            "y_m",
            "heading_rad",
            "speed_mps",
        }
        numbers: dict[str, Floats] = {}
        for name in (name for name in PLAIN if name in told):
            parts_ = [block.numbers.pop(name, None) for block in blocks]
            sizes = np.diff([0, *np.cumsum([len(block.whole["frame"]) for block in blocks])])
            filled = [np.full(n, np.nan) if p is None else p for p, n in zip(parts_, sizes, strict=True)]
            numbers[name] = np.concatenate(filled) if filled else np.zeros(0)
        joined = cls(whole, numbers)
        if (np.diff(whole["ordinal"]) < 0).any():
            joined.turn(np.argsort(whole["ordinal"], kind="stable"))
        return joined

    def turn(self, order: Ints) -> None:
        """Put the states in this order, a column at a time."""
        for columns in (self.whole, self.numbers):
            for name in list(columns):
                columns[name] = columns[name][order]  # type: ignore[assignment]

    def __len__(self) -> int:
        return len(self.whole["vehicle"])


def check_times(states: Columns, names: Names, problems: Problems) -> None:
    """Tell times that go back within one vehicle's states of one topic, and clocks that are set.

    The states are in the order of the log, where such times still show.
    """
    if not len(states):
        return
    topic, vehicle = states.whole["topic"], states.whole["vehicle"]
    track = vehicle * (int(topic.max()) + 1) + topic
    order = np.argsort(_small(track), kind="stable")
    same = np.diff(track[order]) == 0
    time_ns, log_ns = states.whole["time_ns"][order], states.whole["log_time_ns"][order]
    step = np.diff(time_ns)
    _tell(states, names, order[1:][same & (step < 0)], "backward_time", "go back in time", problems)
    drift = np.abs(step.astype(np.float64) - np.diff(log_ns).astype(np.float64))
    at = order[1:][same & (drift > _CLOCK_STEP_NS) & (step >= 0)]
    what = "are apart from the one before by other spans of their own and of the log's clock"
    _tell(states, names, at, "clock_step", what, problems)


def _small(codes: Ints) -> NDArray[np.integer]:
    """Codes in the smallest type, which sorts fastest."""
    top = int(codes.max(initial=0))
    return codes.astype(np.uint16 if top < 2**16 else np.uint32 if top < 2**32 else np.int64)


def _tell(states: Columns, names: Names, rows: Ints, code: str, what: str, problems: Problems) -> None:
    topics = states.whole["topic"][rows]
    for topic in np.unique(topics).tolist():
        hit = rows[topics == topic]
        name, first = names.texts[topic], int(states.whole["message_index"][hit].min())
        detail = f"{len(hit)} states on {quoted(name)} {what}, first in its message {first}"
        problems.add(code, detail, None, name)


def sort_states(states: Columns, names: Names, problems: Problems) -> None:
    """Sort by vehicle id and time; states of the same time stay in the order of the log, and are told."""
    used = distinct(states.whole["vehicle"])[0]
    ranks = np.zeros(len(names.texts) + 1, np.int64)
    by_name = sorted(used.tolist(), key=names.texts.__getitem__)
    ranks[by_name] = np.arange(len(by_name))
    order = np.arange(len(states))
    if (np.diff(states.whole["time_ns"]) < 0).any():
        order = np.argsort(states.whole["time_ns"], kind="stable")
    order = order[np.argsort(_small(ranks[states.whole["vehicle"][order]]), kind="stable")]
    states.turn(order)
    again = np.flatnonzero(_same(states) & (np.diff(states.whole["time_ns"]) == 0)) + 1
    _tell(states, names, again, "duplicate_time", "repeat a time of their vehicle", problems)


def _same(states: Columns) -> Mask:
    """Tell where a state is of the same vehicle as the one before, (n - 1,)."""
    same: Mask = np.diff(states.whole["vehicle"]) == 0
    return same


# --- box centres ---------------------------------------------------------------------------------


def to_centres(
    states: Columns,
    references: dict[int, float | None],
    vehicles: VehiclesConfig,
    names: Names,
    problems: Problems,
) -> None:
    """Move positions from the topics' reference points to the box centres.

    Parameters
    ----------
    states : Columns
        The states.
    references : dict[int, float | None]
        For each topic (code) whose positions are not box centres, the distance from its reference
        point forward to the centre [m]; None for the rear axle of each vehicle.
    vehicles : VehiclesConfig
        Where a rear axle's distance comes from, after the log: half the wheelbase by default.
    names : Names
        The texts of the codes.
    problems : Problems
        Told where a position without heading cannot be moved; it becomes unknown.
    """
    topics = states.whole["topic"]
    moved = np.isin(topics, list(references))
    if not moved.any():
        return
    distance = _rear_axle_to_centre(states, vehicles, names)
    for topic, fixed in references.items():
        if fixed is not None:
            distance[topics == topic] = fixed
    heading = states.numbers["heading_rad"]
    lost = moved & np.isnan(heading) & ~np.isnan(states.numbers["x_m"])
    for topic in np.unique(topics[lost]).tolist():
        name, count = names.texts[topic], int((topics[lost] == topic).sum())
        detail = f"{count} positions on {quoted(name)} have no heading, so their box centres are unknown"
        problems.add("no_heading", detail, None, name)
    distance = np.where(moved, distance, 0.0)
    turned = np.where(moved, heading, 0.0)
    states.numbers["x_m"] = states.numbers["x_m"] + distance * np.cos(turned)
    states.numbers["y_m"] = states.numbers["y_m"] + distance * np.sin(turned)


def _rear_axle_to_centre(states: Columns, vehicles: VehiclesConfig, names: Names) -> Floats:
    """Distance from the rear axle to the box centre: by id, else from the log, else the default [m]."""
    half = vehicles.wheelbase_ratio / 2.0
    found = np.full(len(states), np.nan)
    codes = {names.texts[code]: code for code in np.unique(states.whole["vehicle"]).tolist()}
    for vehicle_id, vehicle in vehicles.by_id.items():
        code = codes.get(vehicle_id)
        distance = vehicle.rear_axle_to_centre_m
        if distance is None and vehicle.wheelbase_m is not None:
            distance = vehicle.wheelbase_m / 2.0
        if distance is None and vehicle.length_m is not None:
            distance = vehicle.length_m * half
        if code is not None and distance is not None:
            found[states.whole["vehicle"] == code] = distance
    for name, share in (("rear_axle_to_centre_m", 1.0), ("wheelbase_m", 0.5), ("length_m", half)):
        if name in states.numbers:
            found = np.where(np.isnan(found), states.numbers[name] * share, found)
    return np.where(np.isnan(found), vehicles.length_m * half, found)


# --- what is missing -------------------------------------------------------------------------------


def derive_headings(states: Columns) -> NDArray[np.uint8]:
    """Derive the headings of vehicles that tell none, in place; returns the marks.

    The heading is the direction of the displacement between the states before and after, where that
    is at least 0.2 m and no step is longer than 1 s; a vehicle that stands keeps it.
    """
    marks = np.zeros(len(states), np.uint8)
    heading, vehicle = states.numbers["heading_rad"], states.whole["vehicle"]
    if not np.isnan(heading).any():
        return marks
    told = np.bincount(vehicle, ~np.isnan(heading)) if len(states) else np.zeros(0)
    silent = told[vehicle] == 0
    if not silent.any():
        return marks
    span_s, dx, dy = _differences(states, states.numbers["x_m"], states.numbers["y_m"])
    moving = ~np.isnan(span_s) & (np.hypot(dx, dy) >= _LEAST_MOVE_M)
    derived = np.where(moving, np.arctan2(dy, dx), np.nan)
    for backward in (False, True):
        derived = _held(derived, vehicle, backward)
    filled = silent & ~np.isnan(derived)
    heading[filled] = derived[filled]
    marks[filled] = HEADING_DERIVED
    return marks


def _held(values: Floats, vehicle: Ints, backward: bool) -> Floats:
    """Hold known values over unknown ones of the same vehicle."""
    if backward:
        return _held(values[::-1], vehicle[::-1], False)[::-1]
    last = np.maximum.accumulate(np.where(np.isnan(values), 0, np.arange(len(values))))
    return np.where(vehicle[last] == vehicle, values[last], np.nan)


def derive_motion(states: Columns) -> NDArray[np.uint8]:
    """Derive missing speeds and accelerations of sorted box centres, in place; returns the marks.

    The speed is the displacement along the heading between the states before and after, by their
    time (one-sided at the ends); the acceleration is that difference of the speeds, for vehicles
    that tell none. Neither is known where a step is longer than 1 s.
    """
    marks = np.zeros(len(states), np.uint8)
    speed = states.numbers["speed_mps"]
    missing = np.isnan(speed)
    if missing.any():
        span_s, dx, dy = _differences(states, states.numbers["x_m"], states.numbers["y_m"])
        heading = states.numbers["heading_rad"]
        derived = (dx * np.cos(heading) + dy * np.sin(heading)) / span_s
        filled = missing & np.isfinite(derived)
        speed[filled] = derived[filled]
        marks[filled] |= SPEED_DERIVED
    vehicle = states.whole["vehicle"]
    acceleration = states.numbers.setdefault("acceleration_mps2", np.full(len(states), np.nan))
    if np.isnan(acceleration).any():
        silent = (np.bincount(vehicle, ~np.isnan(acceleration)) == 0)[vehicle]
        span_s, dv = _differences(states, speed)
        filled = silent & np.isfinite(dv / span_s)
        acceleration[filled] = (dv / span_s)[filled]
        marks[filled] |= ACCELERATION_DERIVED
    return marks


def _differences(states: Columns, *values: Floats) -> tuple[Floats, ...]:
    """Time [s] and values from the state before to the one after, own at the ends of a vehicle's states.

    The time is NaN where there is none, or a step is longer than 1 s.
    """
    count = len(states)
    same = _same(states)
    before, after = np.arange(count), np.arange(count)
    before[1:] -= same
    after[:-1] += same
    time_ns = states.whole["time_ns"]
    longest = np.maximum(time_ns - time_ns[before], time_ns[after] - time_ns)
    span_ns = time_ns[after] - time_ns[before]
    sound = (span_ns > 0) & (longest <= _LONGEST_STEP_NS)
    span_s = np.where(sound, span_ns / NS_PER_S, np.nan)
    return (span_s, *(value[after] - value[before] for value in values))


# --- the table -----------------------------------------------------------------------------------


def to_table(states: Columns, marks: NDArray[np.uint8], names: Names) -> pl.DataFrame:
    """Return the states with the columns of STATES_SCHEMA; they are used up."""
    texts = pl.Series(names.texts, dtype=pl.String)
    columns: dict[str, pl.Series] = {}
    count = len(states)
    heading = states.numbers["heading_rad"]
    turned = np.flatnonzero((heading < -np.pi) | (heading >= np.pi))
    heading[turned] = wrap_angle(heading[turned])  # the others stay as they were told, to the bit
    for name, dtype in STATES_SCHEMA.items():
        if name in ("vehicle_id", "topic"):
            codes = states.whole.pop("vehicle" if name == "vehicle_id" else name)
            columns[name] = texts.gather(pl.Series(codes.astype(np.uint32)))
        elif name == "role":
            columns[name] = pl.Series(ROLES).gather(pl.Series(states.whole.pop(name).astype(np.uint32)))
        elif name == "derived":
            columns[name] = pl.Series(marks)
        elif name in states.whole:
            columns[name] = pl.Series(states.whole.pop(name))
        elif name in states.numbers:
            columns[name] = pl.Series(states.numbers.pop(name), nan_to_null=True)
        else:
            columns[name] = pl.repeat(None, count, dtype=dtype, eager=True)
        columns[name] = columns[name].rename(name)
    return pl.DataFrame(columns, schema=STATES_SCHEMA)
