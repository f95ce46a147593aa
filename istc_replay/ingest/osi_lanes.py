"""Lanes and road edges of ASAM OSI: physical lanes with their boundaries, else logical ones.

A lane's sides are those of its own direction, which need not be that of driving. Boundaries are
told apart from the lanes that name them, and often once in a log: they are joined at the end.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf import message_factory
from google.protobuf.message import DecodeError

from istc_replay.datatypes import FloatArray, LaneLine, RoadArea, RoadEdge, read_only
from istc_replay.ingest.batches import Bytes
from istc_replay.ingest.osi import FOREIGN, enum_name
from istc_replay.ingest.problems import Problems
from istc_replay.ingest.scan import Spans
from istc_replay.ingest.scene import SceneParts
from istc_replay.polyline import LINE_POINTS, middle_line

#: Different lanes and boundaries that are read, and their points in all.
_ITEMS_LIMIT, _POINTS_LIMIT = 50_000, 2_000_000
#: Boundaries that no car drives across.
_EDGES = {
    "TYPE_ROAD_EDGE",
    "TYPE_SNOW_EDGE",
    "TYPE_GRASS_EDGE",
    "TYPE_GRAVEL_EDGE",
    "TYPE_SOIL_EDGE",
    "TYPE_GUARD_RAIL",
    "TYPE_CURB",
    "TYPE_STRUCTURE",
    "TYPE_BARRIER",
    "TYPE_SOUND_BARRIER",
}
#: Lanes on which cars drive, physical and logical.
_DRIVEN = {"TYPE_DRIVING", "TYPE_INTERSECTION"}
_DRIVEN_LOGICAL = {
    "TYPE_NORMAL",
    "TYPE_EXIT",
    "TYPE_ENTRY",
    "TYPE_ONRAMP",
    "TYPE_OFFRAMP",
    "TYPE_CONNECTINGRAMP",
    "TYPE_STOP",
    "TYPE_PARKING",
    "TYPE_MEDIAN",
}


@dataclass(frozen=True, slots=True, eq=False)
class _Lane:
    """A lane as OSI tells it: its line (P, 2) and the boundaries to either side, in its own direction."""

    lane_id: str
    line_m: FloatArray
    left: tuple[int, ...]
    right: tuple[int, ...]
    backward: bool  # driven against its own direction
    free: tuple[int, ...] = ()  # boundaries of an intersection, to no side


class Lanes:
    """Takes the lanes and boundaries of OSI messages into the scene, each as it is first told."""

    def __init__(self, type_: Any, parts: SceneParts, problems: Problems) -> None:
        descriptor = type_.DESCRIPTOR
        if "global_ground_truth" in descriptor.fields_by_name:
            descriptor = descriptor.fields_by_name["global_ground_truth"].message_type
        self._descriptor = descriptor
        self._parts, self._problems = parts, problems
        self._met: set[bytes] = set()
        self._points = 0
        self._boundaries: dict[bool, dict[int, FloatArray]] = {False: {}, True: {}}
        self._lanes: dict[bool, dict[str, _Lane]] = {False: {}, True: {}}
        parts.last.append(self._join)

    def watched(self) -> dict[str, Callable[[Bytes, Spans], None]]:
        """What takes in the spans of each field of the ground truth."""
        takers: dict[str, Callable[[Any], None]] = {
            "lane_boundary": lambda told: self._boundary(told, logical=False),
            "logical_lane_boundary": lambda told: self._boundary(told, logical=True),
            "lane": self._physical,
            "logical_lane": self._logical,
        }
        readers = {}
        for name, take in takers.items():
            field = self._descriptor.fields_by_name.get(name)
            if field is not None and field.message_type is not None:
                readers[name] = self._reader(name, message_factory.GetMessageClass(field.message_type), take)
        return readers

    def _reader(self, name: str, type_: Any, take: Callable[[Any], None]) -> Callable[[Bytes, Spans], None]:
        def read(data: Bytes, spans: Spans) -> None:
            for start, end in zip(spans.starts.tolist(), spans.ends.tolist(), strict=True):
                raw = data[start:end].tobytes()
                # They may be told again in every message.
                digest = hashlib.blake2b(name.encode() + raw, digest_size=16).digest()
                if digest in self._met:
                    continue
                if len(self._met) >= _ITEMS_LIMIT or self._points >= _POINTS_LIMIT:
                    detail = f"more than {_ITEMS_LIMIT} lanes and boundaries, or {_POINTS_LIMIT} points"
                    self._problems.add("lanes", f"{detail}: the rest is left out")
                    return
                self._met.add(digest)
                try:
                    take(type_.FromString(raw))
                except (DecodeError, *FOREIGN) as error:
                    reason = " ".join(str(error).split())[:200]
                    self._problems.add("lanes", f"a {name} is left out: {reason}")

        return read

    def _line(self, places: Iterable[Any]) -> FloatArray:
        """Points (P, 2) of a polyline, those that repeat the one before left out."""
        points = np.array([(place.x, place.y) for place in places], dtype=np.float64).reshape(-1, 2)
        self._points += len(points)
        if not np.isfinite(points).all():
            raise ValueError("a point of it is not finite")
        if len(points) > LINE_POINTS:
            raise ValueError(f"it has more than {LINE_POINTS} points")
        moved = np.hypot(*np.diff(points, axis=0).T) > 0.0
        return read_only(points[np.concatenate([[True], moved])] if len(points) else points)

    def _boundary(self, told: Any, *, logical: bool) -> None:
        number = int(told.id.value)
        if number in self._boundaries[logical]:
            return
        line = self._line(point.position for point in told.boundary_line)
        if len(line) < 2:
            raise ValueError(f"boundary {number} needs two different points at least")
        self._boundaries[logical][number] = line
        if not logical and enum_name(told.classification, "type") in _EDGES:
            self._parts.road_edges.setdefault(str(number), RoadEdge(str(number), line))

    def _physical(self, told: Any) -> None:
        kind = told.classification
        if enum_name(kind, "type") not in _DRIVEN:
            return
        lane = _Lane(
            str(told.id.value),
            self._line(kind.centerline),
            tuple(each.value for each in kind.left_lane_boundary_id),
            tuple(each.value for each in kind.right_lane_boundary_id),
            not kind.centerline_is_driving_direction,  # writers leave False out
            tuple(each.value for each in kind.free_lane_boundary_id),
        )
        self._lanes[False].setdefault(lane.lane_id, lane)

    def _logical(self, told: Any) -> None:
        if enum_name(told, "type") not in _DRIVEN_LOGICAL:
            return
        lane = _Lane(
            str(told.id.value),
            read_only([], columns=2),
            tuple(each.value for each in told.left_boundary_id),
            tuple(each.value for each in told.right_boundary_id),
            enum_name(told, "move_direction") == "MOVE_DIRECTION_DECREASING_S",
        )
        self._lanes[True].setdefault(lane.lane_id, lane)

    def _join(self) -> None:
        """Give each lane its edges."""
        logical = not self._lanes[False]
        for lane in self._lanes[logical].values():
            if self._area(lane):
                continue
            left, right = (self._side(ids, lane.line_m, logical) for ids in (lane.left, lane.right))
            if left is None or right is None:
                if len(lane.line_m) < 2:
                    detail = f"lane {lane.lane_id} is left out: it needs two edges or a line of two points"
                    self._problems.add("lanes", detail)
                    continue
                if lane.left or lane.right:
                    detail = f"lane {lane.lane_id} names a boundary that is not told: its edges are left out"
                    self._problems.add("lanes", detail)
                left = right = None
            line = lane.line_m
            if left is not None and right is not None:
                if (left[-1] - left[0]) @ (right[-1] - right[0]) < 0.0:
                    right = right[::-1]
                line = line if len(line) > 1 else middle_line(left, right)
            if lane.backward:
                line = line[::-1]
                left, right = (None, None) if left is None or right is None else (right[::-1], left[::-1])
            known = LaneLine(
                lane.lane_id,
                read_only(line),
                None,
                None if left is None else read_only(left),
                None if right is None else read_only(right),
            )
            self._parts.lane_lines.setdefault(lane.lane_id, known)

    def _area(self, lane: _Lane) -> bool:
        """Whether a lane is an intersection, told by its free boundaries alone: an area of the road."""
        pieces = [self._boundaries[False].get(number) for number in lane.free]
        known = [piece for piece in pieces if piece is not None]
        if lane.left or lane.right or len(lane.line_m) > 1 or len(known) < max(2, len(pieces)):
            return False
        self._parts.road_areas.setdefault(lane.lane_id, RoadArea(lane.lane_id, read_only(outline(known))))
        return True

    def _side(self, ids: tuple[int, ...], along_m: FloatArray, logical: bool) -> FloatArray | None:
        """One line (P, 2) of the boundaries of a side, in the lane's direction; None if one is unknown."""
        pieces = [self._boundaries[logical].get(number) for number in ids]
        known = [piece for piece in pieces if piece is not None]
        if not known or len(known) < len(pieces):
            return None
        return joined(known, along_m)


def joined(pieces: list[FloatArray], along_m: FloatArray) -> FloatArray:
    """Pieces (P, 2) one after the other, each turned so that they follow on along a line (L, 2)."""
    first = pieces[0]
    if len(along_m) > 1:
        turned = (first[-1] - first[0]) @ (along_m[-1] - along_m[0]) < 0.0
    elif len(pieces) > 1:
        ends = pieces[1][[0, -1]]
        turned = min(math.dist(first[0], e) for e in ends) < min(math.dist(first[-1], e) for e in ends)
    else:
        turned = False
    line = first[::-1] if turned else first
    for piece in pieces[1:]:
        turned = math.dist(line[-1], piece[-1]) < math.dist(line[-1], piece[0])
        line = np.vstack([line, piece[::-1] if turned else piece])
    return line


def outline(pieces: list[FloatArray]) -> FloatArray:
    """Pieces (P, 2) of an outline as they follow on; where roads join it, it is straight."""
    line, rest = pieces[0], list(pieces[1:])
    while rest:
        gaps = [
            (math.dist(line[-1], piece[end]), row, end) for row, piece in enumerate(rest) for end in (0, -1)
        ]
        _, row, end = min(gaps)
        piece = rest.pop(row)
        line = np.vstack([line, piece if end == 0 else piece[::-1]])
    return line
