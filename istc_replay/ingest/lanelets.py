"""Lanelets of CommonRoad scenarios: the bounds on either side, in driving order."""

from __future__ import annotations

from istc_replay.datatypes import LaneLine, read_only
from istc_replay.ingest.foreign import BadValueError, finite
from istc_replay.ingest.problems import Problems, quoted
from istc_replay.polyline import LINE_POINTS, middle_line

#: The sides of a lanelet, kinds on which cars do not drive, and the points of all that are held.
_BOUNDS = ("leftBound", "rightBound")
_NOT_DRIVEN = {"sidewalk", "crosswalk", "bicycleLane", "restrictedArea"}
_POINTS_LIMIT = 2_000_000


class Lanelets:
    """Takes in lanelets, one after the other.

    Attributes
    ----------
    lanes : dict
        Those on which cars drive, by their ids.
    skipped : int
        How many others there are.
    """

    def __init__(self, problems: Problems) -> None:
        self.lanes: dict[str, LaneLine] = {}
        self.skipped = 0
        self._problems = problems
        self._id, self._line, self._fault, self._points = "", 0, "", 0
        self._types: set[str] = set()
        self._bounds: dict[str, list[tuple[float, float]]] = {}
        self._point: dict[str, float] = {}

    def start(self, lanelet_id: str, line: int) -> None:
        """Begin a lanelet."""
        self._id, self._line, self._fault = lanelet_id, line, ""
        self._types, self._bounds, self._point = set(), {name: [] for name in _BOUNDS}, {}

    def end(self, path: tuple[str, ...], text: str, line: int) -> None:
        """Take in an element of the lanelet, or the whole of it."""
        name = path[-1]
        try:
            if len(path) == 2:
                self._finish()
            elif name == "laneletType":
                self._types.add(text)
            elif path[2] in _BOUNDS and name in ("x", "y"):
                self._point[name] = finite(text, name)
            elif path[2] in _BOUNDS and name == "point":
                point, self._point = self._point, {}
                if len(point) < 2:
                    raise BadValueError("a point without x or y")
                self._bounds[path[2]].append((point["x"], point["y"]))
                self._points += 1
        except BadValueError as error:
            self._fault = self._fault or f"line {line}: {error}"
            if len(path) == 2:
                self._refuse()

    def _finish(self) -> None:
        if self._fault:
            self._refuse()
            return
        if self._types & _NOT_DRIVEN:
            self.skipped += 1
            return
        if self._points > _POINTS_LIMIT:
            raise BadValueError(f"more than {_POINTS_LIMIT} points of lanelets")
        left, right = (read_only(self._bounds[name], columns=2) for name in _BOUNDS)
        fit = all(2 <= len(side) <= LINE_POINTS for side in (left, right))
        if not fit or self._id in self.lanes:
            rule = f"2 to {LINE_POINTS} points on either side"
            raise BadValueError(f"it needs an id of its own and {rule}")
        middle = read_only(middle_line(left, right))
        self.lanes[self._id] = LaneLine(self._id, middle, None, left, right)

    def _refuse(self) -> None:
        where = "" if self._fault.startswith("line ") else f"line {self._line}: "
        detail = f"{where}{self._fault}; lanelet {quoted(self._id, 40)} is left out"
        self._problems.lose("bad_value", detail)
