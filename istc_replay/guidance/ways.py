"""Ways round obstacles: taut lines from start to goal past their corners, the shortest first."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np

from istc_replay.datatypes import FloatArray, MapBounds
from istc_replay.geometry import box_corners
from istc_replay.guidance.clearance import Clearance

#: Of more obstacles, those least out of the way are looked at.
_OBSTACLES_MAX = 30
_WAYS_MAX = 8
_EXPANDED_MAX = 500
_TOUCH_M = 1e-6
#: A disc that touches a corner has its centre so near to both sides, as a share of its radius.
_ROUNDED = math.sqrt(0.5)


@dataclass(frozen=True, eq=False)
class Way:
    """A taut line by the corners it bends at, from start to goal.

    `points_m` (C, 2): corners of obstacles; `rooms_m` (C,): how far the line is from their sides;
    `sides` (C,): 1 where it turns left, -1 right; `headings_rad` (C,): the mean of those before and
    after the corner.
    """

    points_m: FloatArray
    rooms_m: FloatArray
    sides: FloatArray
    headings_rad: FloatArray


def ways_round(start_m: FloatArray, goal_m: FloatArray, clearance: Clearance) -> list[Way]:
    """Find the shortest taut lines between two points (2,) that a disc as wide as the car passes.

    Taut lines bend at corners of obstacles and about them, so that no two pass all obstacles on the
    same sides. At most eight are found.
    """
    ends = np.stack([start_m, goal_m])
    boxes, rooms = _inflated(ends, clearance)
    corners = _corners(boxes)
    spread = _ROUNDED * rooms
    nodes = np.vstack([ends, _corners(boxes + np.outer(spread, (0.0, 0.0, 0.0, 1.0, 1.0)))])
    square = np.column_stack([np.zeros((len(boxes), 2)), boxes[:, 2], np.ones((len(boxes), 2))])
    outward = np.vstack([np.zeros((2, 2)), _corners(square)])
    seen = _seen(nodes, boxes, spread, clearance.bounds, clearance.car.width_m / 2.0)
    return [_way(line, nodes, corners, np.repeat(rooms, 4)) for line in _taut_lines(nodes, outward, seen)]


def _inflated(ends: FloatArray, clearance: Clearance) -> tuple[FloatArray, FloatArray]:
    """Boxes (O, 5) as in `Clearance`, and the room (O,) to keep from each: less where an end has less."""
    boxes = clearance.obstacles
    rooms = clearance.car.width_m / 2.0 + clearance.margins_m
    if len(boxes) > _OBSTACLES_MAX:
        detours = sum(np.hypot(boxes[:, 0] - x, boxes[:, 1] - y) for x, y in ends)
        nearest = np.sort(np.argsort(detours, kind="stable")[:_OBSTACLES_MAX])
        boxes, rooms = boxes[nearest], rooms[nearest]
    x, y, heading, p, q = boxes.T
    dx, dy = ends[:, :1] - x, ends[:, 1:] - y
    along = np.abs(dx * np.cos(heading) + dy * np.sin(heading)) - p
    across = np.abs(dy * np.cos(heading) - dx * np.sin(heading)) - q
    return boxes, np.maximum(np.minimum(rooms, np.maximum(along, across).min(axis=0) - _TOUCH_M), 0.0)


def _corners(boxes: FloatArray) -> FloatArray:
    """Corners (4 O, 2) of boxes (O, 5) of half sizes."""
    x, y, heading, p, q = boxes.T
    return box_corners(x, y, heading, 2.0 * p, 2.0 * q).reshape(-1, 2)


def _seen(
    nodes: FloatArray, boxes: FloatArray, rooms: FloatArray, bounds: MapBounds, half_m: float
) -> np.ndarray:
    """Whether the lines between nodes (N, N) miss all boxes, the nodes but the ends being on the map."""
    x, y = nodes.T
    on_map = (x >= bounds.x_min_m + half_m) & (x <= bounds.x_max_m - half_m)
    on_map &= (y >= bounds.y_min_m + half_m) & (y <= bounds.y_max_m - half_m)
    on_map[:2] = True
    first, second = np.triu_indices(len(nodes), 1)
    kept = on_map[first] & on_map[second]
    first, second = first[kept], second[kept]
    here, step = nodes[first], nodes[second] - nodes[first]
    clear = np.ones(len(first), dtype=bool)
    for (x, y, heading, p, q), room in zip(boxes, rooms, strict=True):
        # Where the line, as a share of it, enters and leaves the strip between each two sides.
        enter, leave = np.zeros(len(first)), np.ones(len(first))
        c, s = np.cos(heading), np.sin(heading)
        for axis, half in (((c, s), p), ((-s, c), q)):
            reach, at, along = half + room - _TOUCH_M, (here - (x, y)) @ axis, step @ axis
            along = np.where(np.abs(along) < 1e-12, 1e-12, along)
            one, other = (-reach - at) / along, (reach - at) / along
            enter = np.maximum(enter, np.minimum(one, other))
            leave = np.minimum(leave, np.maximum(one, other))
        clear &= enter >= leave
    seen = np.zeros((len(nodes), len(nodes)), dtype=bool)
    seen[first, second] = seen[second, first] = clear
    return seen


def _taut_lines(nodes: FloatArray, outward: FloatArray, seen: np.ndarray) -> list[list[int]]:
    """The shortest lines from node 0 to node 1 that bend about corners alone (best first search)."""
    lengths = np.where(seen, np.hypot(*(nodes[:, None] - nodes[None, :]).transpose(2, 0, 1)), np.inf)
    left = _distances(lengths, 1).tolist()
    table, xy, out = lengths.tolist(), nodes.tolist(), outward.tolist()
    neighbours = [np.flatnonzero(row).tolist() for row in seen]
    queue: list[tuple[float, float, list[int]]] = [(left[0], 0.0, [0])]
    found: list[list[int]] = []
    expanded = 0
    while queue and len(found) < _WAYS_MAX and expanded < _EXPANDED_MAX:
        _, length, line = heapq.heappop(queue)
        node = line[-1]
        if node == 1:
            found.append(line)
            continue
        expanded += 1
        for other in neighbours[node]:
            longer = length + table[node][other]
            if other in line or longer + left[other] == np.inf:
                continue
            if node == 0 or _is_taut(xy[line[-2]], xy[node], xy[other], out[node]):
                heapq.heappush(queue, (longer + left[other], longer, [*line, other]))
    return found


def _distances(lengths: FloatArray, goal: int) -> FloatArray:
    """Shortest lengths (N,) to a node by edges (N, N) (Dijkstra)."""
    left, open_ = np.full(len(lengths), np.inf), np.zeros(len(lengths))
    left[goal] = 0.0
    for _ in range(len(lengths)):
        node = int(np.argmin(left + open_))
        open_[node] = np.inf
        left = np.minimum(left, left[node] + lengths[node])
    return left


def _is_taut(before: list[float], here: list[float], after: list[float], outward: list[float]) -> bool:
    """Whether a line bends about a corner: its box lies on the inner side of both its pieces."""
    ux, uy, vx, vy = here[0] - before[0], here[1] - before[1], after[0] - here[0], after[1] - here[1]
    turn = ux * vy - uy * vx
    first, then = ux * outward[1] - uy * outward[0], vx * outward[1] - vy * outward[0]
    return abs(turn) > _TOUCH_M and turn * first < 0.0 and turn * then < 0.0


def _way(line: list[int], nodes: FloatArray, corners: FloatArray, rooms: FloatArray) -> Way:
    steps = np.diff(nodes[line], axis=0)
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    bent = np.array(line[1:-1], dtype=np.int64) - 2
    return Way(corners[bent], rooms[bent], np.sign(np.diff(headings)), (headings[1:] + headings[:-1]) / 2.0)
