"""Lanes of SUMO's networks, line and width of each on which cars drive, and the outlines of junctions."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

from istc_replay.datatypes import FloatArray, LaneLine, RoadArea, StaticScene, read_only
from istc_replay.errors import LogError
from istc_replay.ingest.foreign import BadValueError, above_zero, finite
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.xml_stream import read_xml
from istc_replay.polyline import LINE_POINTS, beside

ROOT = "net"
#: SUMO's width of a lane that tells none [m].
_WIDTH_M = 3.2
_POINTS_LIMIT = 2_000_000
#: Edges of which no lane is for cars.
_NOT_DRIVEN = {"crossing", "walkingarea"}
_CARS = {"passenger", "all"}


class _Net:
    """Takes in the lanes of a network."""

    def __init__(self, problems: Problems) -> None:
        self.lanes: dict[str, LaneLine] = {}
        self.junctions: dict[str, RoadArea] = {}
        self._problems = problems
        self._function = ""
        self._points = 0

    def start(self, path: tuple[str, ...], attributes: dict[str, str], line: int) -> None:
        if len(path) == 1 and path[0] != ROOT:
            raise LogError(
                f"line {line}: its outermost element is {quoted(path[0], 40)}; give a SUMO network"
            )
        if path[-1] == "edge" and len(path) == 2:
            self._function = attributes.get("function", "")
        elif path[-1] == "lane" and len(path) == 3 and self._driven(attributes):
            self._take("lane", attributes, line)
        elif path[-1] == "junction" and len(path) == 2 and " " in attributes.get("shape", ""):
            self._take("junction", attributes, line)

    def _take(self, kind: str, told: dict[str, str], line: int) -> None:
        own = told.get("id", "")
        try:
            known: dict[str, Any] = self.lanes if kind == "lane" else self.junctions
            if not own or own in known:
                raise BadValueError("it needs an id of its own")
            shape = self._shape(told.get("shape", ""), least=2 if kind == "lane" else 1)
            if kind == "lane":
                width_m = above_zero(told.get("width", str(_WIDTH_M)), "width")
                sides = (read_only(beside(shape, side * width_m / 2.0)) for side in (1.0, -1.0))
                known[own] = LaneLine(own, shape, None, *sides)
            elif len(shape) > 2:  # others are where a road ends or goes on
                known[own] = RoadArea(own, shape)
        except BadValueError as error:
            detail = f"line {line}: {kind} {quoted(own, 40)} is left out: {error}"
            self._problems.lose("bad_value", detail)

    def end(self, _path: tuple[str, ...], _text: str, _line: int) -> None:
        """Nothing is told by an element's end."""

    def _driven(self, lane: dict[str, str]) -> bool:
        if self._function in _NOT_DRIVEN:
            return False
        allowed = set(lane.get("allow", "all").split())
        return bool(allowed & _CARS) and not set(lane.get("disallow", "").split()) & _CARS

    def _shape(self, text: str, least: int) -> FloatArray:
        """Points (P, 2), those that repeat the one before left out."""
        places = [place.split(",") for place in text.split()]
        if any(len(place) < 2 for place in places):
            raise BadValueError(f"shape {quoted(text, 40)} has a point without x or y")
        points = [(finite(place[0], "x"), finite(place[1], "y")) for place in places]
        points = points[:1] + [b for a, b in pairwise(points) if a != b]
        self._points += len(points)
        if len(points) < least or self._points > _POINTS_LIMIT:
            few = len(points) < least
            rule = "two different points" if few else f"no more than {_POINTS_LIMIT} points in all"
            raise BadValueError(f"its shape needs {rule}")
        if len(points) > LINE_POINTS:
            raise BadValueError(f"its shape has more than {LINE_POINTS} points")
        return read_only(points, columns=2)


def read_net(path: Path, problems: Problems) -> StaticScene:
    """Read the lanes and junctions of a SUMO network, plain or gzip.

    Raises
    ------
    LogError
        If it is not XML, is above a limit, is cut off, or is no network.
    """
    net = _Net(problems)
    try:
        cut = read_xml(path, net, lambda _done, _total: None)
    except LogError as error:
        raise LogError(str(error) if str(error).startswith(str(path)) else f"{path}: {error}") from None
    if cut:
        raise LogError(f"{path}: {cut}")
    if not net.lanes:
        raise LogError(f"{path}: holds no lane on which cars drive; give what `netconvert -o` wrote")
    return StaticScene(tuple(net.lanes.values()), road_areas=tuple(net.junctions.values()))
