"""The road: what lies between the edges of all lanes and in areas, up to edges that nobody drives across."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from istc_replay.datatypes import FloatArray

if TYPE_CHECKING:
    from collections.abc import Iterable

    from istc_replay.datatypes import StaticScene

#: Lanes side by side touch where no more than this is between them, and lanes that follow each other where
#: no more than twice the second is [m].
_GAP_M, _SEAM_M = 0.2, 0.1
#: An edge farther away than this bounds nothing [m].
_REACH_M = 30.0
#: Points of a line, times poses, that are looked at at once.
_AT_ONCE = 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Road:
    """Outlines (N, 2) of lanes and areas, closed by their last side, and edges (N, 2) [m, map frame]."""

    outlines: tuple[FloatArray, ...]
    edges: tuple[FloatArray, ...]

    @classmethod
    def of(cls, scene: StaticScene) -> Road | None:
        """The road of a scene; None where nothing tells of one."""
        outlines = [
            np.vstack([_longer(line.left_m), _longer(line.right_m)[::-1]])
            for line in scene.lane_lines
            if line.left_m is not None and line.right_m is not None
            if _sound(line.left_m) and _sound(line.right_m)
        ]
        outlines += [area.points_m for area in scene.road_areas if _sound(area.points_m)]
        edges = [edge.points_m for edge in scene.road_edges if _sound(edge.points_m)]
        return cls(tuple(outlines), tuple(edges)) if outlines or edges else None

    def free_m(self, poses: FloatArray) -> FloatArray:
        """How far the road goes to the left and right across the headings at poses (S, 3).

        Returns
        -------
        (S, 2) array
            Distances [m], NaN where nothing tells of the road on that side. They end at the first edge, or
            where neither a lane nor an area goes on.
        """
        outlines, edges = (_meeting(lines, poses) for lines in (self.outlines, self.edges))
        free = _between_lanes([_crossings(each, poses, closed=True) for each in outlines], len(poses))
        for edge in edges:
            at = _crossings(edge, poses, closed=False)
            left = np.min(at, axis=1, where=at >= 0.0, initial=np.inf)
            right = np.min(-at, axis=1, where=at <= 0.0, initial=np.inf)
            nearest = np.stack([left, right], axis=-1)
            free = np.fmin(free, np.where(nearest <= _REACH_M, nearest, np.nan))
        return free


def _meeting(lines: tuple[FloatArray, ...], poses: FloatArray) -> list[FloatArray]:
    """Those of the lines that are near some pose."""
    low, high = poses[:, :2].min(axis=0) - _REACH_M, poses[:, :2].max(axis=0) + _REACH_M
    return [line for line in lines if (line.max(axis=0) >= low).all() and (line.min(axis=0) <= high).all()]


def scene_near(scene: StaticScene, points_m: FloatArray) -> StaticScene:
    """A scene with only those lanes and edges that are near points (S, 2), and those of intents."""
    points = points_m[np.isfinite(points_m).all(axis=1)]
    if not len(points) or not (scene.lane_lines or scene.road_edges or scene.road_areas):
        return scene
    low, high = points.min(axis=0) - _REACH_M, points.max(axis=0) + _REACH_M

    def near(parts: Iterable[FloatArray | None]) -> bool:
        known = [part for part in parts if part is not None and len(part)]
        return any((part.max(axis=0) >= low).all() and (part.min(axis=0) <= high).all() for part in known)

    lanes = (
        line
        for line in scene.lane_lines
        if line.vehicle_id or near((line.points_m, line.left_m, line.right_m))
    )
    edges = (edge for edge in scene.road_edges if near((edge.points_m,)))
    areas = (area for area in scene.road_areas if near((area.points_m,)))
    return replace(scene, lane_lines=tuple(lanes), road_edges=tuple(edges), road_areas=tuple(areas))


def _sound(points_m: FloatArray) -> bool:
    return len(points_m) >= 2 and bool(np.isfinite(points_m).all())


def _longer(points_m: FloatArray) -> FloatArray:
    """A line with a little more at both of its ends."""
    line = points_m.copy()
    for end, inner in ((0, 1), (-1, -2)):
        step = points_m[end] - points_m[inner]
        length = float(np.hypot(*step))
        if length > 0.0:
            line[end] += _SEAM_M / length * step
    return line


def _crossings(line_m: FloatArray, poses: FloatArray, *, closed: bool) -> FloatArray:
    """Where the lines across poses (S, 3) meet a polyline: offsets (S, C) to the left, sorted, NaN after."""
    low, high = line_m.min(axis=0) - _REACH_M, line_m.max(axis=0) + _REACH_M
    rows = np.flatnonzero(((poses[:, :2] >= low) & (poses[:, :2] <= high)).all(axis=1))
    line = np.vstack([line_m, line_m[:1]]) if closed else line_m
    count = max(1, len(rows) * len(line) // _AT_ONCE)
    parts = [_met(line, poses[part]) for part in np.array_split(rows, count)]
    found = np.full((len(poses), max((part.shape[1] for part in parts), default=0)), np.nan)
    for part, met in zip(np.array_split(rows, count), parts, strict=True):
        found[part, : met.shape[1]] = met
    return found


def _met(line: FloatArray, poses: FloatArray) -> FloatArray:
    """Offsets (R, C) of `_crossings` for poses (R, 3) that are near the line."""
    offset = line - poses[:, None, :2]  # (R, N, 2)
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    along, across = c * offset[..., 0] + s * offset[..., 1], c * offset[..., 1] - s * offset[..., 0]
    crosses = (along[:, :-1] <= 0.0) != (along[:, 1:] <= 0.0)
    step = along[:, :-1] - along[:, 1:]
    share = along[:, :-1] / np.where(step == 0.0, 1.0, step)
    met = across[:, :-1] + share * (across[:, 1:] - across[:, :-1])
    met = np.sort(np.where(crosses, met, np.nan), axis=1)
    return np.asarray(met[:, : int(crosses.sum(axis=1).max(initial=0))])


def _between_lanes(crossings: list[FloatArray], count: int) -> FloatArray:
    """Where the lanes that lie side by side about 0 end, to the left and right (S, 2); NaN off all lanes."""
    # A line enters an outline at every other crossing.
    lows = [each[:, 0::2] for each in crossings]
    highs = [each[:, 1::2] for each in crossings]
    low, high = (np.concatenate([np.empty((count, 0)), *each], axis=1) for each in (lows, highs))
    touching = (low <= _GAP_M) & (high >= -_GAP_M)
    within = np.full((count, 2), -np.inf)
    for _ in range(low.shape[1] + 1):
        left = np.max(high, axis=1, where=touching, initial=-np.inf)
        right = np.max(-low, axis=1, where=touching, initial=-np.inf)
        wider = np.maximum(within, np.stack([left, right], axis=-1))
        if (wider == within).all():
            break
        within = wider
        touching = (low <= within[:, :1] + _GAP_M) & (high >= -within[:, 1:] - _GAP_M)
    return np.where(np.isfinite(within), within, np.nan)
