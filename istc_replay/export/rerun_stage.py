"""A result laid out for the Rerun view: its windows, its local frame, its tracks."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import ArrayLike, NDArray

from istc_replay.config import Config, ViewConfig, parse_config
from istc_replay.datatypes import FloatArray, Frame, Result
from istc_replay.export.colours import Colour, vehicle_colours
from istc_replay.export.rerun_chunks import FOREVER_NS, Clock, IntArray, label, quaternions
from istc_replay.geometry import to_map
from istc_replay.units import seconds_to_ns

BoolArray = NDArray[np.bool_]

#: A recording is interrupted where states are this many sampling periods apart, or this long.
_GAP_PERIODS = 4.0
_LONGEST_GAP_NS = 3_000_000_000
#: No place on Earth is this far from its map's origin; single precision could not hold it.
_FARTHEST_M = 1e8
_GREY = 150
_MARGIN_M = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Span:
    """A window as shown: until `shown_end_ns`, where the next window may begin before its end."""

    index: int
    start_ns: int
    end_ns: int
    shown_end_ns: int
    units: int
    frame: Frame
    summary: dict[str, Any]

    @property
    def duration_s(self) -> float:
        """Length of the window [s]."""
        return (self.end_ns - self.start_ns) / 1e9


def _spans(windows: list[dict[str, Any]]) -> tuple[Span, ...]:
    ordered = sorted(windows, key=lambda w: (w["start_ns"], w["index"]))
    nexts = [*(w["start_ns"] for w in ordered), FOREVER_NS][1:]
    return tuple(
        Span(
            index=w["index"],
            start_ns=w["start_ns"],
            end_ns=w["end_ns"],
            shown_end_ns=min(w["end_ns"], following),
            units=max(1, w["units"]),
            frame=Frame(**w["frame"]),
            summary=w,
        )
        for w, following in zip(ordered, nexts, strict=True)
    )


def _clock(spans: tuple[Span, ...], states: pl.DataFrame) -> Clock:
    if not spans:
        first = int(states["time_ns"].to_numpy().min(initial=FOREVER_NS)) if states.height else 0
        return Clock(first, np.array([first], dtype=np.int64))
    starts = [
        s.start_ns + (s.end_ns - s.start_ns) * np.arange(s.units, dtype=np.int64) // s.units for s in spans
    ]
    shown = [unit[unit < s.shown_end_ns] for unit, s in zip(starts, spans, strict=True)]
    return Clock(spans[0].start_ns, np.concatenate([*shown, [spans[-1].end_ns]]).astype(np.int64))


# --- tracks ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One vehicle's states from one source, in the view's local frame.

    `times_ns` (S,); `ends_ns` (S,) until when each state is shown; `poses` (S, 3) x, y, unwrapped
    heading; `sizes_m` (S, 2) length, width; the others (S,), NaN where unknown.
    """

    vehicle_id: str
    times_ns: IntArray
    ends_ns: IntArray
    poses: FloatArray
    sizes_m: FloatArray
    speeds_mps: FloatArray
    accelerations_mps2: FloatArray
    steering_rad: FloatArray
    jerks_mps3: FloatArray

    def within(self, start_ns: int, end_ns: int) -> FloatArray:
        """Times and poses (n, 4) of the states from start to end."""
        rows = (self.times_ns >= start_ns) & (self.times_ns <= end_ns)
        return np.column_stack([(self.times_ns[rows] - start_ns) / 1e9, self.poses[rows]])

    def segments(self) -> list[slice]:
        """The stretches between interruptions."""
        breaks = np.flatnonzero(self.ends_ns[:-1] < self.times_ns[1:]) + 1
        bounds = [0, *breaks.tolist(), len(self.times_ns)]
        return [slice(a, b) for a, b in itertools.pairwise(bounds) if b > a]

    def boxes_at(self, times_ns: IntArray) -> FloatArray:
        """Oriented boxes (T, 5) x, y, heading, length, width at the instants; NaN where absent."""
        boxes = np.full((len(times_ns), 5), np.nan)
        for part in self.segments():
            own = self.times_ns[part]
            inside = (times_ns >= own[0]) & (times_ns <= own[-1])
            values = np.column_stack([self.poses[part], self.sizes_m[part]])
            # Differences first: float64 cannot tell nanoseconds of absolute time apart.
            at, known = (times_ns[inside] - own[0]) / 1e9, (own - own[0]) / 1e9
            boxes[inside] = np.column_stack([np.interp(at, known, column) for column in values.T])
        return boxes


def _track(vehicle_id: str, table: pl.DataFrame, origin_m: tuple[float, float], default: Config) -> Track:
    table = table.sort("time_ns", maintain_order=True).unique("time_ns", keep="last", maintain_order=True)
    times = table["time_ns"].to_numpy().astype(np.int64)
    steps = np.diff(times)
    period = min(int(np.median(steps)), _LONGEST_GAP_NS) if len(steps) else seconds_to_ns(0.1)
    nexts = np.append(times[1:], FOREVER_NS)
    kept = np.append(steps <= min(_GAP_PERIODS * period, _LONGEST_GAP_NS), False)
    alone = np.minimum(times, FOREVER_NS - period) + period
    column = {name: table[name].cast(pl.Float64).to_numpy().copy() for name in _TRACK_COLUMNS}
    sizes = np.column_stack([column["length_m"], column["width_m"]])
    fallback = np.array([default.vehicles.length_m, default.vehicles.width_m])
    poses = [column["x_m"] - origin_m[0], column["y_m"] - origin_m[1], np.unwrap(column["heading_rad"])]
    return Track(
        vehicle_id=vehicle_id,
        times_ns=times,
        ends_ns=np.where(kept, nexts, alone),
        poses=np.column_stack(poses),
        sizes_m=np.where(np.isfinite(sizes) & (sizes > 0.0), sizes, fallback),
        speeds_mps=column["speed_mps"],
        accelerations_mps2=column["acceleration_mps2"],
        steering_rad=column["steering_rad"],
        jerks_mps3=column["jerk_mps3"],
    )


_TRACK_COLUMNS = (
    "x_m",
    "y_m",
    "heading_rad",
    "speed_mps",
    "acceleration_mps2",
    "steering_rad",
    "jerk_mps3",
    "length_m",
    "width_m",
)


# --- the stage -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A result laid out for the view; positions are relative to `origin_m` of the map frame.

    `recorded` and `in_force` by vehicle (in_force: of every window's plan the part that is shown);
    `planned` and `guidance` by window and vehicle. `extents` by window: see `_extent`.
    """

    result: Result
    config: Config
    clock: Clock
    spans: tuple[Span, ...]
    origin_m: tuple[float, float]
    metres_per_second: float
    colours: dict[str, Colour]
    recorded: dict[str, Track]
    in_force: dict[str, Track]
    planned: dict[tuple[int, str], Track]
    guidance: dict[tuple[int, str], Track]
    names: dict[str, str]
    extents: dict[int, FloatArray]

    @property
    def vehicle_ids(self) -> list[str]:
        """All vehicles, sorted."""
        return sorted(self.colours)

    def height_m(self, span: Span, times_ns: ArrayLike) -> FloatArray:
        """Height of instants in the (x, y, t) view: every window starts on the ground."""
        return (np.asarray(times_ns, dtype=np.int64) - span.start_ns) / 1e9 * self.metres_per_second

    def overview_end_ns(self, span: Span) -> int:
        """When a window's overview is cleared: never, if nothing at all follows it."""
        last = max((int(track.times_ns[-1]) for track in self.recorded.values()), default=0)
        follows = span is not self.spans[-1] or last > span.end_ns
        return span.shown_end_ns if follows else FOREVER_NS

    def overview(self, spans: list[Span]) -> tuple[IntArray, IntArray]:
        """When the overviews of windows begin and end; (W,) each."""
        starts = np.array([span.start_ns for span in spans], dtype=np.int64)
        return starts, np.array([self.overview_end_ns(span) for span in spans], dtype=np.int64)

    def by_span(self, table: pl.DataFrame) -> list[tuple[Span, pl.DataFrame]]:
        """A table's rows window by window, as far as there are any."""
        tables = table.partition_by("window", as_dict=True, maintain_order=True)
        return [(span, tables[(span.index,)]) for span in self.spans if (span.index,) in tables]

    def in_view(self, tables: list[tuple[Span, pl.DataFrame]]) -> tuple[IntArray, IntArray, BoolArray]:
        """Which rows (n,) of the tables begin while their window is shown, their starts and ends."""
        limits = np.concatenate([np.full(own.height, span.shown_end_ns) for span, own in tables])
        starts = np.concatenate([own["start_ns"].to_numpy() for _, own in tables])
        ends = np.concatenate([own["end_ns"].to_numpy() for _, own in tables])
        keep = starts < limits
        return starts[keep], np.minimum(ends, limits)[keep], keep

    def window_states(self, span: Span, vehicle_id: str) -> dict[str, FloatArray]:
        """A vehicle's states in a window by source: times and poses (n, 4), two at least."""
        tracks = {
            "planned": self.planned.get((span.index, vehicle_id)),
            "recorded": self.recorded.get(vehicle_id),
            "guidance": self.guidance.get((span.index, vehicle_id)),
        }
        states = {key: t.within(span.start_ns, span.end_ns) for key, t in tracks.items() if t is not None}
        return {key: values for key, values in states.items() if len(values) >= 2}

    def recorded_colour(self, vehicle_id: str) -> Colour:
        """The colour of what the vehicle was recorded to do."""
        return greyed(self.colours[vehicle_id])


def greyed(colour: Colour) -> Colour:
    """Half grey: readable on light and dark grounds, and still of its hue."""
    red, green, blue = colour
    return (red + _GREY) // 2, (green + _GREY) // 2, (blue + _GREY) // 2


def make_stage(result: Result, view: ViewConfig) -> Stage:
    """Lay a result out for the view.

    Raises
    ------
    ConfigError
        If the result's configuration cannot be read by this version.
    """
    config = parse_config(result.config_toml, f"{result.path}: config.toml")
    spans = _spans(result.summary["windows"])
    placed = pl.all_horizontal(pl.col("x_m", "y_m").abs() < _FARTHEST_M)
    states = result.states.filter(placed & pl.col("heading_rad").is_finite())
    origin = _origin(spans, states)
    sources = {
        source: {
            key: _track(str(key[1]), table, origin, config)
            for key, table in states.filter(pl.col("source") == source)
            .sort("window", "vehicle_id", maintain_order=True)
            .partition_by("window", "vehicle_id", as_dict=True)
            .items()
        }
        for source in ("planned", "guidance")
    }
    shown_end = {s.index: s.shown_end_ns if s is not spans[-1] else FOREVER_NS for s in spans}
    in_force = states.filter(
        pl.col("source") == "planned",
        pl.col("time_ns") < pl.col("window").replace_strict(shown_end, default=0, return_dtype=pl.Int64),
    )
    ids = sorted(set(states["vehicle_id"]) | set(result.corridors["vehicle_id"]))
    stage = Stage(
        result=result,
        config=config,
        clock=_clock(spans, states),
        spans=spans,
        origin_m=origin,
        metres_per_second=view.metres_per_second,
        colours=vehicle_colours(ids),
        recorded=_by_vehicle(states.filter(pl.col("source") == "recorded"), origin, config),
        in_force=_by_vehicle(in_force, origin, config),
        planned=sources["planned"],
        guidance=sources["guidance"],
        names={vehicle_id: label(vehicle_id) for vehicle_id in ids},
        extents={},
    )
    return replace(stage, extents={span.index: _extent(stage, span) for span in spans})


def _origin(spans: tuple[Span, ...], states: pl.DataFrame) -> tuple[float, float]:
    if spans:
        return spans[0].frame.x_m, spans[0].frame.y_m
    if states.height:
        return float(np.median(states["x_m"])), float(np.median(states["y_m"]))
    return 0.0, 0.0


def _by_vehicle(states: pl.DataFrame, origin: tuple[float, float], config: Config) -> dict[str, Track]:
    tables = states.sort("vehicle_id", maintain_order=True).partition_by("vehicle_id", as_dict=True)
    return {str(key[0]): _track(str(key[0]), table, origin, config) for key, table in tables.items()}


# --- boxes and points of the corridor frame --------------------------------------------------


def local_cubes(stage: Stage, table: pl.DataFrame) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centres (n, 2) and half sizes (n, 2) [m] and turns (n, 4) of a table's boxes, in the view's frame."""
    low = table.select("x_min_m", "y_min_m").to_numpy()
    high = table.select("x_max_m", "y_max_m").to_numpy()
    centres = local_points(stage, table, (low + high) / 2.0)
    return centres, (high - low) / 2.0, quaternions(table["frame_yaw_rad"].to_numpy())


def local_points(stage: Stage, table: pl.DataFrame, points_m: FloatArray) -> FloatArray:
    """Corridor-frame points (n, 2) of a table's rows in the view's frame [m]."""
    frames = table.select("frame_x_m", "frame_y_m", "frame_yaw_rad").to_numpy()
    unique, which = np.unique(frames, axis=0, return_inverse=True)
    points = np.empty_like(points_m)
    for number, (x, y, yaw) in enumerate(unique):
        rows = which.ravel() == number
        frame = Frame(x - stage.origin_m[0], y - stage.origin_m[1], yaw)
        points[rows] = to_map(points_m[rows], frame)
    return points


def _extent(stage: Stage, span: Span) -> FloatArray:
    """What a window's scene covers: x_min, x_max, y_min, y_max [m], with a margin."""
    table = stage.result.corridors.filter(pl.col("window") == span.index)
    points = [np.empty((0, 2))]
    if table.height:
        corners = itertools.product(("x_min_m", "x_max_m"), ("y_min_m", "y_max_m"))
        points += [local_points(stage, table, table.select(corner).to_numpy()) for corner in corners]
    else:
        tracks = stage.recorded.values()
        points += [track.within(span.start_ns, span.end_ns)[:, 1:3] for track in tracks]
    found = np.vstack(points)
    if not len(found):
        return np.array([-20.0, 20.0, -20.0, 20.0])
    low, high = found.min(axis=0) - _MARGIN_M, found.max(axis=0) + _MARGIN_M
    return np.array([low[0], high[0], low[1], high[1]])
