"""Road files: lanes and road edges as GeoJSON, in the metric frame of a log's states.

| geometry | property `kind` | becomes |
|---|---|---|
| LineString, MultiLineString | `lane` | a lane line in driving order; with `width_m`, its edges as well |
| LineString, MultiLineString | `edge` | a road edge |
| Polygon, MultiPolygon | `road`, or none | a road area, and the outlines of its holes road edges |
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

from istc_replay.datatypes import FloatArray, LaneLine, RoadArea, RoadEdge, read_only
from istc_replay.errors import LogError
from istc_replay.ingest.problems import quoted
from istc_replay.ingest.scene import SceneParts
from istc_replay.polyline import LINE_POINTS, beside

_SIZE_LIMIT, _POINTS_LIMIT = 32 * 2**20, 500_000
#: No place on the ground is farther from the origin, and no lane wider [m].
_FARTHEST_M, _WIDEST_M = 1e8, 50.0
#: Numbers are below this; NaN is not.
_NUMBER = 1e300
_LINES = {"LineString": 0, "MultiLineString": 1, "Polygon": 1, "MultiPolygon": 2}


class _FaultError(ValueError):
    """What a feature breaks; the message names the value and the rule."""


def road_bytes(path: Path) -> bytes:
    """The bytes of a road file.

    Raises
    ------
    LogError
        If it cannot be read, or is larger than 32 MiB.
    """
    try:
        if not path.is_file():  # pipes and devices may never end
            raise LogError(f"{path}: no such file; give a road file (GeoJSON)")
        if path.stat().st_size > _SIZE_LIMIT:
            raise LogError(f"{path}: larger than {_SIZE_LIMIT} bytes; cut the road to the log's place")
        return path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}; give a road file (GeoJSON)") from None


def road_sha256(path: Path) -> str:
    """Hash of a road file; errors as of `road_bytes`."""
    return hashlib.sha256(road_bytes(path)).hexdigest()


def read_road(path: Path, parts: SceneParts) -> str:
    """Read a road file into the parts of a scene; returns its hash.

    Raises
    ------
    LogError
        If it cannot be read, is above a limit, or is not GeoJSON of this form; the feature is named.
    """
    data = road_bytes(path)
    try:
        told = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise LogError(f"{path}: not JSON: {' '.join(str(error).split())[:200]}") from None
    number, points = 0, 0
    try:
        for number, feature in enumerate(_features(told)):
            for line_id, kind, line, width_m in _lines_of(feature, number):
                points += len(line)
                if points > _POINTS_LIMIT:
                    raise _FaultError(f"more than {_POINTS_LIMIT} points up to here")
                _take(parts, line_id, kind, line, width_m)
    except _FaultError as error:
        raise LogError(f"{path}: feature {number}: {error}") from None
    return hashlib.sha256(data).hexdigest()


def _take(parts: SceneParts, line_id: str, kind: str, line: FloatArray, width_m: float | None) -> None:
    places: dict[str, Any] = {"lane": parts.lane_lines, "edge": parts.road_edges, "road": parts.road_areas}
    known = places[kind]
    if line_id in known:
        raise _FaultError(f"its id {quoted(line_id, 40)} is taken; give each its own")
    if kind == "road":
        known[line_id] = RoadArea(line_id, read_only(line[:-1]))
    elif kind == "edge":
        known[line_id] = RoadEdge(line_id, line)
    elif width_m is None:
        known[line_id] = LaneLine(line_id, line)
    else:
        sides = (read_only(beside(line, side * width_m / 2.0)) for side in (1.0, -1.0))
        known[line_id] = LaneLine(line_id, line, None, *sides)


def _features(told: Any) -> list[Any]:
    kind = told.get("type") if isinstance(told, dict) else None
    if kind not in ("FeatureCollection", "Feature"):
        raise _FaultError(f"the type is {quoted(str(kind), 40)}; give a FeatureCollection or a Feature")
    crs = told.get("crs")
    if crs is not None and any(degrees in json.dumps(crs) for degrees in ("CRS84", "4326")):
        raise _FaultError("positions are in degrees; give metres of the frame of the log's states")
    features = told.get("features") if kind == "FeatureCollection" else [told]
    if not isinstance(features, list):
        raise _FaultError("the collection has no list of features")
    return features


def _lines_of(feature: Any, number: int) -> Iterator[tuple[str, str, FloatArray, float | None]]:
    """Id, kind (lane, edge or road), points (P, 2) and width of each line of a feature."""
    shape = feature.get("geometry") if isinstance(feature, dict) else None
    told = (feature.get("properties") or {}) if isinstance(feature, dict) else {}
    geometry = shape.get("type") if isinstance(shape, dict) else None
    if not isinstance(shape, dict) or geometry not in _LINES or not isinstance(told, dict):
        raise _FaultError(f"its geometry is {quoted(str(geometry), 40)}; give one of {', '.join(_LINES)}")
    area = geometry.endswith("Polygon")
    kind = told.get("kind", "road" if area else None)
    kinds = ("road",) if area else ("lane", "edge")
    if kind not in kinds:
        raise _FaultError(f"its property kind is {quoted(str(kind), 40)}; give {' or '.join(kinds)}")
    own = feature.get("id", told.get("id", number))
    width_m = _width(told.get("width_m")) if kind == "lane" else None
    if area:
        polygons = list(_nested(shape.get("coordinates"), _LINES[geometry] - 1))
        lines = [
            (ring, "edge" if hole else "road")
            for each in polygons
            for hole, ring in enumerate(_nested(each, 1))
        ]
    else:
        lines = [(line, str(kind)) for line in _nested(shape.get("coordinates"), _LINES[geometry])]
    for index, (line, part) in enumerate(lines):
        line_id = str(own) if len(lines) == 1 else f"{own}/{index}"
        yield line_id, part, _points(line, closed=area), width_m


def _width(told: Any) -> float | None:
    if told is None:
        return None
    if not _number(told) or not 0.0 < told <= _WIDEST_M:
        raise _FaultError(f"width_m is {quoted(str(told), 40)}; give a number above 0, up to {_WIDEST_M:g}")
    return float(told)


def _nested(told: Any, depth: int) -> Iterator[Any]:
    """The lists of positions, which lie `depth` lists deep."""
    if not isinstance(told, list) or not told:
        raise _FaultError("its coordinates are no lists of positions, or empty")
    if depth == 0:
        yield told
        return
    for inner in told:
        yield from _nested(inner, depth - 1)


def _points(line: Any, *, closed: bool) -> FloatArray:
    found: list[tuple[float, float]] = []
    for place in line:
        if not isinstance(place, list) or len(place) < 2 or not all(_number(each) for each in place[:2]):
            raise _FaultError(f"{quoted(json.dumps(place), 40)} is no position: give [x, y] in m")
        x, y = float(place[0]), float(place[1])
        if max(abs(x), abs(y)) > _FARTHEST_M:
            raise _FaultError(f"{quoted(json.dumps(place), 40)} is farther than {_FARTHEST_M:g} m away")
        found.append((x, y))
    if closed and found[0] != found[-1]:
        raise _FaultError("the outline of its area does not end where it begins")
    if any(a == b for a, b in pairwise(found)):
        found = [found[0], *(b for a, b in pairwise(found) if a != b)]
    if len(found) < (4 if closed else 2):
        raise _FaultError("it has too few different points: a line needs 2, an area 3")
    if len(found) > LINE_POINTS:
        raise _FaultError(f"it has more than {LINE_POINTS} points; cut it into several")
    return read_only(found, columns=2)


def _number(told: Any) -> bool:
    return isinstance(told, int | float) and not isinstance(told, bool) and abs(told) < _NUMBER
