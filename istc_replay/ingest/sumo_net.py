"""Lanes of SUMO's networks: line and width of each on which cars drive, those of junctions included."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

from istc_replay.datatypes import FloatArray, LaneLine, read_only
from istc_replay.errors import LogError
from istc_replay.ingest.foreign import BadValueError, above_zero, finite
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.ingest.xml_stream import read_xml
from istc_replay.polyline import beside

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
            lane_id = attributes.get("id", "")
            try:
                shape = self._shape(attributes.get("shape", ""))
                width_m = above_zero(attributes.get("width", str(_WIDTH_M)), "width")
                if not lane_id or lane_id in self.lanes:
                    raise BadValueError("it needs an id of its own")
            except BadValueError as error:
                detail = f"line {line}: lane {quoted(lane_id, 40)} is left out: {error}"
                self._problems.lose("bad_value", detail)
                return
            left, right = (read_only(beside(shape, side * width_m / 2.0)) for side in (1.0, -1.0))
            self.lanes[lane_id] = LaneLine(lane_id, shape, None, left, right)

    def end(self, _path: tuple[str, ...], _text: str, _line: int) -> None:
        """Nothing is told by an element's end."""

    def _driven(self, lane: dict[str, str]) -> bool:
        if self._function in _NOT_DRIVEN:
            return False
        allowed = set(lane.get("allow", "all").split())
        return bool(allowed & _CARS) and not set(lane.get("disallow", "").split()) & _CARS

    def _shape(self, text: str) -> FloatArray:
        """Points (P, 2), those that repeat the one before left out."""
        places = [place.split(",") for place in text.split()]
        if any(len(place) < 2 for place in places):
            raise BadValueError(f"shape {quoted(text, 40)} has a point without x or y")
        points = [(finite(place[0], "x"), finite(place[1], "y")) for place in places]
        points = points[:1] + [b for a, b in pairwise(points) if a != b]
        self._points += len(points)
        if len(points) < 2 or self._points > _POINTS_LIMIT:
            rule = (
                "two different points" if len(points) < 2 else f"no more than {_POINTS_LIMIT} points in all"
            )
            raise BadValueError(f"its shape needs {rule}")
        return read_only(points, columns=2)


def read_net(path: Path, problems: Problems) -> tuple[LaneLine, ...]:
    """Read the lanes of a SUMO network, plain or gzip.

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
    return tuple(net.lanes.values())
