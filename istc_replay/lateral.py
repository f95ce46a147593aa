"""How far a vehicle of recorded traffic may go sideways: to the road's edge, or from its recorded path.

Where lanes or edges tell of the road beside the recorded path, the box stays on it. Where nothing
does, its centre stays within a distance of the path. Where the recording itself is at the edge or
beyond it, its centre stays near the path.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray, Lateral, LateralBound, read_only
from istc_replay.geometry import rotate, to_frame

if TYPE_CHECKING:
    from istc_replay.datatypes import Frame
    from istc_replay.road import Road

#: Points of a path are this far apart, and it goes straight on beyond its ends for the second [m].
_STEP_M, _BEYOND_M = 1.0, 1e3
#: A recording this near to the edge, or beyond it, is at the edge; the centre of its plan then stays this
#: near to its path [m].
AT_EDGE_M, BESIDE_M = 0.1, 0.5
ROAD, PATH, RECORDING = "road", "path", "recording"
_KINDS = (ROAD, PATH, RECORDING)
#: Points of a box that stay on the road, in parts of its length and width: corners, and middles of its sides.
_OUTLINE = np.array([[x, y] for x in (0.5, 0.0, -0.5) for y in (0.5, -0.5)])
_SIDES = (1.0, -1.0)


def lateral_bound(
    poses: FloatArray,
    size_m: tuple[float, float],
    road: Road | None,
    lateral_m: float,
    at_edge_m: float = AT_EDGE_M,
) -> LateralBound:
    """Find what bounds a vehicle sideways.

    Parameters
    ----------
    poses : (S, 3) array
        Its recorded box centres and headings, map frame.
    size_m : tuple
        Length and width of its box.
    road : Road or None
        What is told of the road.
    lateral_m : float
        Bound where nothing is told.
    at_edge_m : float
        A recording this near to the edge is at the edge.
    """
    path = _thinned(poses)
    edge, offset = np.full((len(path), 2), np.nan), np.full((len(path), 2), lateral_m)
    off_road = 0.0
    if road is not None:
        steps = np.gradient(path, axis=0)
        edge = road.free_m(np.column_stack([path, np.arctan2(steps[:, 1], steps[:, 0])]))
        offset = np.where(np.isnan(edge), lateral_m, np.nan)
        points = _outline(poses, size_m)  # (S, 6, 2)
        place, away = _beside(path, points)
        for side, sign in enumerate(_SIDES):
            margin = _at(edge[:, side], place) - sign * away  # (S, 6)
            out = np.nanmin(np.where(np.isnan(margin), np.inf, margin), axis=1)
            off_road = max(off_road, -float(out.min()))
            for row in np.flatnonzero(out < at_edge_m):
                first, last = int(place[row].min()), int(np.ceil(place[row].max()))
                edge[first : last + 1, side] = np.nan
                near = offset[first : last + 1, side]
                offset[first : last + 1, side] = np.where(np.isnan(near), min(BESIDE_M, lateral_m), near)
    return LateralBound(read_only(path), read_only(edge), read_only(offset), lateral_m, off_road)


def in_frame(bound: LateralBound, frame: Frame) -> LateralBound:
    """The bound in a corridor frame."""
    return replace(bound, path_m=read_only(to_frame(bound.path_m, frame)))


def kinds(bound: LateralBound) -> tuple[str, ...]:
    """What bounds the vehicle somewhere along its path: road, path, recording."""
    on_road = np.isfinite(bound.edge_m)
    by_path = bound.offset_m >= bound.lateral_m
    found = (on_road.any(), (by_path & ~on_road).any(), (~by_path & ~on_road).any())
    return tuple(kind for kind, there in zip(_KINDS, found, strict=True) if there)


def centre_reach_m(bound: LateralBound, width_m: float) -> FloatArray:
    """How far (P, 2) a centre may be to the left and right of the path, while it heads along it."""
    return np.where(np.isfinite(bound.edge_m), bound.edge_m - width_m / 2.0, bound.offset_m)


def lateral(vehicle_id: str, bound: LateralBound, poses: FloatArray, size_m: tuple[float, float]) -> Lateral:
    """How a motion keeps its bound, at poses (T, 3) of its box centre in the bound's frame."""
    margin, kind, away = margins(bound, poses, size_m)
    least = int(np.argmin(margin))
    return Lateral(
        vehicle_id,
        kinds(bound),
        float(np.abs(away).max()),
        float(margin[least]),
        _KINDS[int(kind[least])],
        bound.off_road_m,
        least,
    )


def margins(
    bound: LateralBound, poses: FloatArray, size_m: tuple[float, float]
) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Margins (T,) of a box at poses (T, 3), what bounds it there (T,), and its centre's offset (T,) [m]."""
    told = bool(np.isfinite(bound.edge_m).any())
    place, away = _beside(bound.path_m, _outline(poses, size_m) if told else np.empty((len(poses), 0, 2)))
    middle, centre = _beside(bound.path_m, poses[:, None, :2])
    to_edge, to_path = np.full(len(poses), np.inf), np.full(len(poses), np.inf)
    tight = np.zeros(len(poses), dtype=bool)
    for side, sign in enumerate(_SIDES):
        apart = _at(bound.edge_m[:, side], place) - sign * away
        to_edge = np.fmin(to_edge, np.min(apart, axis=1, where=np.isfinite(apart), initial=np.inf))
        reach = _at(bound.offset_m[:, side], middle)[:, 0]
        own = np.where(np.isnan(reach), np.inf, reach - sign * centre[:, 0])
        tight = np.where(own < to_path, reach < bound.lateral_m, tight)
        to_path = np.minimum(to_path, own)
    kind = np.where(to_edge <= to_path, 0, np.where(tight, 2, 1))
    return np.minimum(to_edge, to_path), kind.astype(np.int64), centre[:, 0]


def _thinned(poses: FloatArray) -> FloatArray:
    """The path (P, 2) through poses (S, 3), in steps of no less than `_STEP_M`; two points at least."""
    kept = [poses[0, :2]]
    for point in poses[1:, :2]:
        if np.hypot(*(point - kept[-1])) >= _STEP_M:
            kept.append(point)
    if len(kept) == 1:
        ahead = rotate(np.array([_STEP_M / 2.0, 0.0]), float(poses[0, 2]))
        kept = [kept[0] - ahead, kept[0] + ahead]
    return np.array(kept)


def _outline(poses: FloatArray, size_m: tuple[float, float]) -> FloatArray:
    """Points (T, 6, 2) of the box's outline."""
    along, across = (_OUTLINE * size_m).T
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    return np.stack([poses[:, :1] + c * along - s * across, poses[:, 1:2] + s * along + c * across], axis=-1)


def _beside(path_m: FloatArray, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places of points (T, n, 2) on a path (P, 2), in fractional numbers, and offsets to its left.

    The n points of a box are looked for about the place of their middle.
    """
    ends = np.array([path_m[0] - path_m[1], path_m[-1] - path_m[-2]])
    ends *= _BEYOND_M / np.hypot(*ends.T)[:, None]
    line = np.vstack([path_m[0] + ends[0], path_m, path_m[-1] + ends[1]])
    count, reach = len(line) - 1, 0
    if points_m.shape[1] > 1:
        spread = np.hypot(*np.moveaxis(points_m - points_m.mean(axis=1, keepdims=True), -1, 0))
        reach = int(np.ceil(2.0 * spread.max() / _STEP_M)) + 1
    if points_m.shape[1] <= 1 or count <= 2 * reach + 1:
        near = np.broadcast_to(np.arange(count), (len(points_m), count))
    else:
        about = _nearest(line, points_m.mean(axis=1, keepdims=True), np.arange(count)[None])[0]
        near = np.clip(about - reach, 0, count - 1 - 2 * reach) + np.arange(2 * reach + 1)
    segment, share, away = _nearest(line, points_m, near)
    way = line[segment + 1] - line[segment]
    left = np.sign(way[..., 0] * away[..., 1] - way[..., 1] * away[..., 0])
    place = np.clip(segment - 1 + share, 0.0, len(path_m) - 1.0)
    return place, left * np.hypot(away[..., 0], away[..., 1])


def _nearest(
    line_m: FloatArray, points_m: FloatArray, near: NDArray[np.int64]
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Of segments (T, k) of a line, the nearest to points (T, n, 2), the share of it, the way off it."""
    start = line_m[near][:, None]  # (T, 1, k, 2)
    step = line_m[near + 1][:, None] - start
    offset = points_m[:, :, None] - start  # (T, n, k, 2)
    dot = offset[..., 0] * step[..., 0] + offset[..., 1] * step[..., 1]
    share = np.clip(dot / (step[..., 0] ** 2 + step[..., 1] ** 2), 0.0, 1.0)
    apart = offset - share[..., None] * step
    best = np.argmin(apart[..., 0] ** 2 + apart[..., 1] ** 2, axis=-1)[..., None]  # (T, n, 1)
    segment = np.take_along_axis(np.broadcast_to(near[:, None], share.shape), best, axis=-1)[..., 0]
    share = np.take_along_axis(share, best, axis=-1)[..., 0]
    return segment, share, np.take_along_axis(apart, best[..., None], axis=2)[:, :, 0]


def _at(values: FloatArray, place: FloatArray) -> FloatArray:
    """Values (P,) at fractional places (...), linear between two that are known, NaN beside none."""
    before = np.floor(place).astype(np.int64)
    after, share = np.minimum(before + 1, len(values) - 1), place - before
    low, high = values[before], values[after]
    between = low + share * (high - low)
    known = np.where(np.isnan(low), high, low)
    return np.asarray(np.where(np.isnan(between), known, between))
