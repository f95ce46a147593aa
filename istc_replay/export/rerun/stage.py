"""A result laid out for the Rerun view: its windows, its local frame, its tracks."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
import polars as pl
from numpy.typing import ArrayLike, NDArray

from istc_replay.config import Config, ViewConfig, parse_config
from istc_replay.datatypes import FloatArray, Frame, Result
from istc_replay.export.colours import Colour, vehicle_colours
from istc_replay.export.rerun.chunks import FOREVER_NS, Clock, IntArray, label, quaternions
from istc_replay.export.rerun.ground import Ground, height_of_second, tower_shares
from istc_replay.export.rerun.spans import WHOLE, Anchor, Span, make_clock, make_spans
from istc_replay.export.rerun.tracks import Track, make_track
from istc_replay.geometry import rotate, to_map

BoolArray = NDArray[np.bool_]
Root = tuple[str, ...]

#: No place on Earth is this far from its map's origin; single precision could not hold it.
_FARTHEST_M = 1e8
_GREY = 150
_MARGIN_M = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A result laid out for the view; positions are relative to `origin_m` of the map frame.

    `recorded` and `in_force` by vehicle (in_force: of every window's plan the part that is shown);
    `planned` and `guidance` by window and vehicle. `grounds` by window. `starring` are the vehicles
    whose plots are shown, `leading` by window those that are named and whose corridors are shown
    there; the rest waits under `quiet` (see `rerun.cast`). `follows` are the vehicles that the
    close-up follows by window, `closest` the pairs whose clearance is plotted; `plots_all`: those of
    the others are in the view too. `anchor` tells which part of a result this is. `presence` tells from when
    to when [ns] each vehicle of the whole result is shown, and `slots` whose entities it has where many come
    and go (see `rerun.slots`).
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
    grounds: dict[int, Ground]
    anchor: Anchor = WHOLE
    plots_all: bool = True
    closest: tuple[tuple[str, str], ...] = ()
    starring: frozenset[str] = frozenset()
    leading: dict[int, frozenset[str]] = field(default_factory=dict)
    follows: dict[int, tuple[str, ...]] = field(default_factory=dict)
    presence: dict[str, tuple[int, int]] = field(default_factory=dict)
    slots: dict[str, str] = field(default_factory=dict)

    @property
    def vehicle_ids(self) -> list[str]:
        """All vehicles, sorted."""
        return sorted(self.colours)

    @property
    def first_ns(self) -> int:
        """Since when the first window's view is shown: since the first record, where no part is before."""
        if self.anchor.from_ns is not None:
            return self.anchor.from_ns
        tracks = self.recorded.values()
        return min([self.clock.origin_ns, *(int(track.times_ns[0]) for track in tracks)])

    @property
    def states_shown(self) -> int:
        """States of all vehicles, recorded and in force."""
        tracks = (*self.recorded.values(), *self.in_force.values())
        return sum(len(self.own(track).times_ns) for track in tracks)

    @property
    def limits_ns(self) -> tuple[int, int]:
        """Start and end of the time that this part shows."""
        low, high = self.anchor.from_ns, self.anchor.until_ns
        return -FOREVER_NS if low is None else low, FOREVER_NS if high is None else high

    def own(self, track: Track) -> Track:
        """The states of a track that this part shows."""
        return track.between(*self.limits_ns)

    def in_part(self, times_ns: IntArray) -> BoolArray:
        """Whether instants (S,) are in the time that this part shows."""
        low, high = self.limits_ns
        return (times_ns >= low) & (times_ns < high)

    def height_m(self, span: Span, times_ns: ArrayLike) -> FloatArray:
        """Height of instants in the (x, y, t) view: every window starts on the ground."""
        return (np.asarray(times_ns, dtype=np.int64) - span.start_ns) / 1e9 * self.metres_per_second

    def cubes_of(self, vehicle_id: str, windows: set[int]) -> list[tuple[Span, pl.DataFrame]]:
        """A vehicle's corridor-cubes in some windows, window by window."""
        mine = (pl.col("vehicle_id") == vehicle_id) & pl.col("window").is_in(sorted(windows))
        return self.by_span(self.result.corridors.filter(mine).sort("window", "k"))

    def roots(self, space: str, vehicle_id: str) -> list[tuple[Root, set[int]]]:
        """The roots of a vehicle's entities, and the windows in which it is shown there."""
        leads = {span.index for span in self.spans if vehicle_id in self.leading[span.index]}
        return [((space,), leads), ((space, "quiet"), {span.index for span in self.spans} - leads)]

    def leads_at(self, vehicle_id: str, times_ns: IntArray) -> BoolArray:
        """Whether a vehicle is among the leading ones at the instants (S,)."""
        if not self.spans:
            return np.ones(len(times_ns), dtype=bool)
        starts = np.array([span.start_ns for span in self.spans], dtype=np.int64)
        leads = np.array([vehicle_id in self.leading[span.index] for span in self.spans])
        # Before the first window it is as in it, after the last as in that.
        return leads[np.clip(np.searchsorted(starts, times_ns, side="right") - 1, 0, None)]

    def overview_end_ns(self, span: Span) -> int:
        """When a window's overview is cleared: never, if nothing at all follows it."""
        last = max((int(track.times_ns[-1]) for track in self.recorded.values()), default=0)
        follows = span is not self.spans[-1] or last > span.end_ns or self.anchor.until_ns is not None
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


def make_stage(result: Result, view: ViewConfig, anchor: Anchor = WHOLE) -> Stage:
    """Lay a result out for the view; `anchor` where it is a part of a larger one.

    Raises
    ------
    ConfigError
        If the result's configuration cannot be read by this version.
    """
    config = parse_config(result.config_toml, f"{result.path}: config.toml")
    until_ns = FOREVER_NS if anchor.until_ns is None else anchor.until_ns
    spans = make_spans(result.summary["windows"], until_ns)
    placed = pl.all_horizontal(pl.col("x_m", "y_m").abs() < _FARTHEST_M)
    states = result.states.filter(placed & pl.col("heading_rad").is_finite())
    origin = anchor.origin_m or _origin(spans, states)
    sources = {
        source: {
            key: make_track(str(key[1]), table, origin, config)
            for key, table in states.filter(pl.col("source") == source)
            .sort("window", "vehicle_id", maintain_order=True)
            .partition_by("window", "vehicle_id", as_dict=True)
            .items()
        }
        for source in ("planned", "guidance")
    }
    shown_end = {s.index: s.shown_end_ns if s is not spans[-1] else until_ns for s in spans}
    # Of the parts before and after, what a trail and the end of a motion need.
    low_ns = -FOREVER_NS if anchor.from_ns is None else anchor.from_ns
    beyond = ~pl.col("time_ns").is_between(low_ns, until_ns, closed="left")
    end = pl.col("window").replace_strict(shown_end, default=None, return_dtype=pl.Int64)
    in_force = states.filter(
        pl.col("source") == "planned",
        pl.when(end.is_null()).then(beyond).otherwise(pl.col("time_ns") < end),
    )
    ids = sorted(set(states["vehicle_id"]) | set(result.corridors["vehicle_id"]))
    stage = Stage(
        result=result,
        config=config,
        clock=make_clock(spans, states, anchor),
        spans=spans,
        origin_m=origin,
        metres_per_second=1.0,
        colours=vehicle_colours(ids),
        recorded=_by_vehicle(states.filter(pl.col("source") == "recorded"), origin, config),
        in_force=_by_vehicle(in_force, origin, config),
        planned=sources["planned"],
        guidance=sources["guidance"],
        names={vehicle_id: label(vehicle_id) for vehicle_id in ids},
        grounds={},
        anchor=anchor,
    )
    grounds = {span.index: _ground(stage, span) for span in spans}
    height = (
        view.metres_per_second or anchor.metres_per_second or height_of_second(tower_shares(spans, grounds))
    )
    return replace(stage, grounds=grounds, metres_per_second=height)


def _origin(spans: tuple[Span, ...], states: pl.DataFrame) -> tuple[float, float]:
    if spans:
        return spans[0].frame.x_m, spans[0].frame.y_m
    if states.height:
        return float(np.median(states["x_m"])), float(np.median(states["y_m"]))
    return 0.0, 0.0


def _by_vehicle(states: pl.DataFrame, origin: tuple[float, float], config: Config) -> dict[str, Track]:
    tables = states.sort("vehicle_id", maintain_order=True).partition_by("vehicle_id", as_dict=True)
    return {str(key[0]): make_track(str(key[0]), table, origin, config) for key, table in tables.items()}


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


# --- the ground of a window -------------------------------------------------------------------


def _ground(stage: Stage, span: Span) -> Ground:
    """What a window's scene covers, with a margin, along the axes of its corridor frame."""
    table = stage.result.corridors.filter(pl.col("window") == span.index)
    points = [np.empty((0, 2))]
    if table.height:
        corners = itertools.product(("x_min_m", "x_max_m"), ("y_min_m", "y_max_m"))
        points += [local_points(stage, table, table.select(corner).to_numpy()) for corner in corners]
    else:
        tracks = stage.recorded.values()
        points += [track.within(span.start_ns, span.end_ns)[:, 1:3] for track in tracks]
    found = np.vstack(points)
    yaw = span.frame.yaw_rad
    if not len(found):
        return Ground(np.zeros(2), np.full(2, 20.0), yaw)
    own = rotate(found, -yaw)
    low, high = own.min(axis=0) - _MARGIN_M, own.max(axis=0) + _MARGIN_M
    return Ground(rotate((low + high) / 2.0, yaw), (high - low) / 2.0, yaw)
