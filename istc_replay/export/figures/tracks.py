"""What the pictures of one window show, as arrays in one frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from istc_replay.config import Config, parse_config
from istc_replay.datatypes import SOUND, FloatArray, Frame, Result, WindowStatus
from istc_replay.errors import ConfigError, UsageError
from istc_replay.export.figures.style import VehicleStyle, vehicle_styles
from istc_replay.geometry import box_corners, to_map
from istc_replay.units import NS_PER_S, median_step

#: Only these windows have a plan to show.
PLANNED = (*SOUND, WindowStatus.NOT_CERTIFIED)
#: Past this distance from the origin of the map a coordinate cannot be a place [m].
_FAR_M = 1e8
_WALLS = ("x_min_m", "x_max_m", "y_min_m", "y_max_m")


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One vehicle's motion in one window, box centre, picture frame.

    `times_s` (S,) from the window's start, strictly increasing; `poses` (S, 3) x, y, unwrapped
    heading; `speeds_mps` and `accelerations_mps2` (S,), NaN where unknown.
    """

    vehicle_id: str
    times_s: FloatArray
    poses: FloatArray
    speeds_mps: FloatArray
    accelerations_mps2: FloatArray
    length_m: float
    width_m: float

    @property
    def longest_step_s(self) -> float:
        """Steps longer than this are gaps: three times the median step."""
        return 3.0 * median_step(self.times_s)

    def at(self, times_s: FloatArray) -> FloatArray:
        """Poses (T, 3) at given times, linear between samples, NaN outside and in gaps."""
        poses = np.stack([np.interp(times_s, self.times_s, column) for column in self.poses.T], axis=-1)
        after = np.searchsorted(self.times_s, times_s, side="right")
        last = len(self.times_s) - 1
        steps = self.times_s[np.clip(after, 0, last)] - self.times_s[np.clip(after - 1, 0, last)]
        outside = (times_s < self.times_s[0] - 1e-6) | (times_s > self.times_s[-1] + 1e-6)
        in_gap = (steps > self.longest_step_s) & ~np.isin(times_s, self.times_s)
        poses[outside | in_gap] = np.nan
        return poses

    def boxes(self, times_s: FloatArray) -> FloatArray:
        """Outlines (T, 4, 2) of the vehicle's box at given times [m]; NaN where it has no pose."""
        poses = self.at(times_s)
        return box_corners(poses[:, 0], poses[:, 1], poses[:, 2], self.length_m, self.width_m)

    def with_gaps(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Times and values with a NaN in each gap, so that no line is drawn across it."""
        at = np.flatnonzero(np.diff(self.times_s) > self.longest_step_s) + 1
        return np.insert(self.times_s, at, np.nan), np.insert(values, at, np.nan, axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class CorridorShape:
    """One vehicle's corridor or one obstacle, picture frame.

    `outlines_m` (K, 4, 2) of its cubes, `spans_s` (K, 2) their units; `pivots_m` and
    `references_m` (K+1, 2) with `knots_s` (K+1,), empty for an obstacle.
    """

    name: str
    outlines_m: FloatArray
    spans_s: FloatArray
    pivots_m: FloatArray
    references_m: FloatArray
    knots_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class WindowScene:
    """All that the pictures of one window show, in the map frame moved by `origin_m`.

    `names` are what the two motions of each vehicle are called: `recorded` and `planned` hold them.
    `lanes_m` and `edges_m` (P, 2) have a NaN row after each lane line and road edge; `standing_m`
    (O, 4, 2) are the true outlines of standing obstacles.
    """

    window: dict[str, Any]
    has_plan: bool
    duration_s: float
    unit_s: float
    origin_m: tuple[float, float]
    styles: dict[str, VehicleStyle]
    recorded: dict[str, Track]
    planned: dict[str, Track]
    guidance: dict[str, Track]
    corridors: dict[str, CorridorShape]
    obstacles: tuple[CorridorShape, ...]
    lanes_m: FloatArray
    edges_m: FloatArray
    standing_m: FloatArray
    config: Config
    names: tuple[str, str] = ("recorded", "planned")

    @property
    def compared(self) -> tuple[dict[str, Track], dict[str, Track]]:
        """Recorded and planned tracks to compare.

        They are of the planned vehicles where there are several. Else they are of all, and what
        has no plan moves as recorded in both.
        """
        alike = {name: track for name, track in self.recorded.items() if name in self.planned}
        if len(alike) > 1:
            return alike, self.planned
        return self.recorded, self.recorded | self.planned if self.planned else {}


def window_summary(result: Result, window: int) -> dict[str, Any]:
    """Return the figures of one window.

    Raises
    ------
    UsageError
        If the result has no such window.
    """
    windows = result.summary.get("windows") or []
    for entry in windows:
        if entry.get("index") == window:
            return dict(entry)
    known = ", ".join(str(entry.get("index")) for entry in windows[:10])
    raise UsageError(f"window {window} is not in the result; its windows begin {known or 'nowhere'}")


def window_scene(result: Result, window: int, origin_m: tuple[float, float] | None = None) -> WindowScene:
    """Gather what the pictures of one window show, about an origin of its own if none is given."""
    entry = window_summary(result, window)
    start_ns, end_ns = int(entry["start_ns"]), int(entry["end_ns"])
    has_plan = entry.get("status") in PLANNED
    # A recorded state on a boundary, or in windows that overlap, carries the later window's number.
    shown = pl.col("source").eq("recorded") | pl.col("window").eq(window)
    states = result.states.filter(
        pl.col("time_ns").is_between(start_ns, end_ns),
        shown,
        pl.col("x_m").abs() < _FAR_M,
        pl.col("y_m").abs() < _FAR_M,
    )
    origin_m = _origin(states) if origin_m is None else origin_m
    try:
        config = parse_config(result.config_toml)
    except ConfigError:
        config = Config()
    tracks = {
        source: _tracks(states, source, start_ns, origin_m, config)
        for source in ("recorded", "planned", "guidance")
    }
    return WindowScene(
        window=entry,
        has_plan=has_plan,
        duration_s=max((end_ns - start_ns) / NS_PER_S, 1e-3),
        unit_s=float(entry.get("unit_s") or config.window.unit_s),
        origin_m=origin_m,
        styles=vehicle_styles(
            result.states["vehicle_id"].unique().drop_nulls(),
            {
                str(left.get("vehicle_id"))
                for left in (*(entry.get("frozen") or []), *(entry.get("exclusions") or []))
            },
        ),
        recorded=tracks["recorded"],
        planned=tracks["planned"] if has_plan else {},
        guidance=tracks["guidance"] if has_plan else {},
        corridors=_corridors(result.corridors, window, start_ns, origin_m) if has_plan else {},
        obstacles=_obstacles(result.obstacles, window, start_ns, origin_m),
        lanes_m=_in_a_row([line.points_m for line in result.scene.lane_lines], origin_m),
        edges_m=_in_a_row(result.scene.edges_m, origin_m),
        standing_m=_standing(result, origin_m),
        config=config,
    )


def _origin(states: pl.DataFrame) -> tuple[float, float]:
    if states.is_empty():
        return 0.0, 0.0
    centre = [float(states[name].median() or 0.0) for name in ("x_m", "y_m")]  # type: ignore[arg-type]
    x_m, y_m = (round(value, -2) if abs(value) >= 1000.0 else 0.0 for value in centre)
    return x_m, y_m


def _tracks(
    states: pl.DataFrame, source: str, start_ns: int, origin_m: tuple[float, float], config: Config
) -> dict[str, Track]:
    rows = states.filter(pl.col("source") == source).unique(["vehicle_id", "time_ns"], keep="first")
    tracks = {}
    for (name,), part in rows.sort("time_ns").partition_by("vehicle_id", as_dict=True).items():
        sizes = (part["length_m"].drop_nulls(), part["width_m"].drop_nulls())
        tracks[str(name)] = Track(
            vehicle_id=str(name),
            times_s=(part["time_ns"] - start_ns).to_numpy() / NS_PER_S,
            poses=np.column_stack(
                [
                    part["x_m"].to_numpy() - origin_m[0],
                    part["y_m"].to_numpy() - origin_m[1],
                    np.unwrap(part["heading_rad"].fill_null(0.0).to_numpy()),
                ]
            ),
            speeds_mps=_column(part, "speed_mps"),
            accelerations_mps2=_column(part, "acceleration_mps2"),
            length_m=sizes[0][0] if len(sizes[0]) else config.vehicles.length_m,
            width_m=sizes[1][0] if len(sizes[1]) else config.vehicles.width_m,
        )
    return dict(sorted(tracks.items(), key=lambda item: (len(item[0]), item[0])))


def _column(table: pl.DataFrame, *names: str) -> FloatArray:
    columns = [table[name].cast(pl.Float64).fill_null(float("nan")).to_numpy() for name in names]
    return columns[0] if len(names) == 1 else np.column_stack(columns)


def _corridors(
    table: pl.DataFrame, window: int, start_ns: int, origin_m: tuple[float, float]
) -> dict[str, CorridorShape]:
    shapes = {}
    rows = table.filter(pl.col("window") == window, *(pl.col(wall).is_finite() for wall in _WALLS)).sort("k")
    for (name,), part in rows.partition_by("vehicle_id", as_dict=True).items():
        frame = _frame(part)
        pivots, references = (_points(part, frame, kind) - origin_m for kind in ("pivot", "reference"))
        spans_s = _spans(part, start_ns)
        knots_s = np.append(spans_s[:, 0], spans_s[-1:, 1])
        outlines = _outlines(part, frame) - origin_m
        shapes[str(name)] = CorridorShape(str(name), outlines, spans_s, pivots, references, knots_s)
    return dict(sorted(shapes.items(), key=lambda item: (len(item[0]), item[0])))


def _obstacles(
    table: pl.DataFrame, window: int, start_ns: int, origin_m: tuple[float, float]
) -> tuple[CorridorShape, ...]:
    nothing = np.empty((0, 2))
    sound = (pl.col(wall).is_finite() for wall in _WALLS)
    rows = table.filter(pl.col("window") == window, *sound).sort("obstacle_id", "k")
    return tuple(
        CorridorShape(
            str(name),
            _outlines(part, _frame(part)) - origin_m,
            _spans(part, start_ns),
            nothing,
            nothing,
            np.empty(0),
        )
        for (name,), part in rows.partition_by("obstacle_id", as_dict=True).items()
    )


def _points(rows: pl.DataFrame, frame: Frame, kind: str) -> FloatArray:
    """Points (K+1, 2) at the unit boundaries: each row's start, and the last row's end."""
    starts = _column(rows, f"{kind}_x_m", f"{kind}_y_m")
    end = _column(rows[-1:], f"{kind}_end_x_m", f"{kind}_end_y_m")
    return to_map(np.vstack([starts, end]), frame)


def _frame(rows: pl.DataFrame) -> Frame:
    return Frame(*(float(rows[name][0] or 0.0) for name in ("frame_x_m", "frame_y_m", "frame_yaw_rad")))


def _spans(rows: pl.DataFrame, start_ns: int) -> FloatArray:
    return (rows.select("start_ns", "end_ns").to_numpy() - start_ns) / NS_PER_S


def _outlines(rows: pl.DataFrame, frame: Frame) -> FloatArray:
    x_min, x_max, y_min, y_max = _column(rows, *_WALLS).T
    corners = np.stack(
        [
            np.stack([x_min, y_min], axis=-1),
            np.stack([x_max, y_min], axis=-1),
            np.stack([x_max, y_max], axis=-1),
            np.stack([x_min, y_max], axis=-1),
        ],
        axis=1,
    )  # (K, 4, 2)
    return to_map(corners, frame)


def _in_a_row(lines: list[FloatArray], origin_m: tuple[float, float]) -> FloatArray:
    """All lines as one (P, 2) array, with a NaN row after each."""
    gap = np.full((1, 2), np.nan)
    parts = [part for line in lines for part in (line - origin_m, gap)]
    return np.vstack(parts) if parts else np.empty((0, 2))


def _standing(result: Result, origin_m: tuple[float, float]) -> FloatArray:
    boxes = [(o.x_m, o.y_m, o.heading_rad, o.length_m, o.width_m) for o in result.scene.obstacles]
    return box_corners(*np.array(boxes).reshape(-1, 5).T) - origin_m
