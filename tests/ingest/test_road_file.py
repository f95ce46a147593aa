"""Road files: GeoJSON in metres beside a log, read strictly."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import shapely.geometry

from istc_replay.datatypes import StaticScene
from istc_replay.errors import LogError
from istc_replay.ingest.road_file import read_road
from istc_replay.ingest.scene import SceneParts


def feature(geometry: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    """A feature of a geometry and properties."""
    shape = {"type": geometry, "coordinates": coordinates}
    return {"type": "Feature", "geometry": shape, "properties": properties}


def read(tmp_path: Path, *features: Any, **more: Any) -> StaticScene:
    """Write a collection and read it."""
    path, parts = tmp_path / "road.geojson", SceneParts()
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features)} | more))
    read_road(path, parts)
    return parts.scene()


def test_lanes_edges_and_areas_are_read(tmp_path: Path) -> None:
    line = [[500_000.0, 5_000_000.0], [500_050.0, 5_000_000.0], [500_080.0, 5_000_030.0]]
    outline = [[0, 0], [9, 0], [9, 9], [0, 9], [0, 0]]
    hole = [[1, 1], [2, 1], [2, 2], [1, 1]]
    scene = read(
        tmp_path,
        feature("LineString", line, kind="lane", width_m=3.5, id="a"),
        feature("LineString", [[0, 5, 1.5], [0, 5], [7, 5]], kind="edge"),
        feature("MultiLineString", [[[0, 1], [1, 1]], [[0, 2], [1, 2]]], kind="lane"),
        feature("Polygon", [outline, hole]),
    )
    lane, *others = scene.lane_lines
    assert (lane.lane_id, lane.points_m.tolist(), lane.vehicle_id) == ("a", line, None)
    # What shapely calls the parallels.
    for side, edge in ((1.0, lane.left_m), (-1.0, lane.right_m)):
        assert edge is not None
        parallel = shapely.offset_curve(shapely.LineString(line), side * 1.75, join_style="mitre")
        assert shapely.hausdorff_distance(shapely.LineString(edge), parallel) < 1e-6
    assert [(each.lane_id, each.left_m) for each in others] == [("2/0", None), ("2/1", None)]
    assert {edge.edge_id: len(edge.points_m) for edge in scene.road_edges} == {"1": 2, "3/1": 4}
    assert [(area.area_id, area.points_m.tolist()) for area in scene.road_areas] == [("3/0", outline[:-1])]
    np.testing.assert_array_equal(scene.road_edges[0].points_m, [[0, 5], [7, 5]])


@pytest.mark.parametrize(
    ("given", "part"),
    [
        (feature("Point", [0, 0], kind="lane"), "'Point'; give one of LineString"),
        (feature("LineString", [[0, 0], [1, 1]]), "kind is 'None'; give lane or edge"),
        (feature("Polygon", [[[0, 0], [1, 1], [1, 0], [0, 0]]], kind="lane"), "give road"),
        (feature("Polygon", [[[0, 0], [1, 1], [1, 0]]]), "does not end where it begins"),
        (feature("LineString", [[0, 0], [0, 0]], kind="edge"), "too few different points"),
        (feature("LineString", [[0, 0], ["x", 1]], kind="edge"), "is no position"),
        (feature("LineString", [[0, 0], [10**400, 1]], kind="edge"), "is no position"),
        (feature("LineString", [[0, 0], [float("nan"), 1]], kind="edge"), "is no position"),
        (feature("LineString", [[0, 0], [1e9, 1]], kind="edge"), "farther than"),
        (feature("LineString", [[0, 0], True], kind="edge"), "is no position"),
        (feature("LineString", 3, kind="edge"), "no lists of positions"),
        (feature("LineString", [], kind="edge"), "no lists of positions"),
        (feature("LineString", [[0, 0], [1, 1]], kind="lane", width_m=-1), "width_m is '-1'"),
        (feature("LineString", [[0, 0], [1, 1]], kind="lane", width_m=True), "width_m is 'True'"),
        ({"type": "Feature", "geometry": None}, "give one of LineString"),
        ("text", "give one of LineString"),
    ],
)
def test_a_fault_is_one_line_that_names_the_feature(tmp_path: Path, given: Any, part: str) -> None:
    good = feature("LineString", [[0, 0], [1, 1]], kind="edge")
    with pytest.raises(LogError) as caught:
        read(tmp_path, good, given)
    assert part in str(caught.value)
    assert "road.geojson: feature 1: " in str(caught.value)
    assert "\n" not in str(caught.value)


def test_degrees_twins_and_what_is_no_geojson_are_refused(tmp_path: Path) -> None:
    line = feature("LineString", [[0, 0], [1, 1]], kind="edge", id="a")
    with pytest.raises(LogError, match="its id 'a' is taken"):
        read(tmp_path, line, line)
    with pytest.raises(LogError, match="positions are in degrees"):
        read(tmp_path, line, crs={"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}})
    path = tmp_path / "road.geojson"
    for text, part in (
        ("[" * 100_000, "not JSON"),
        ("{", "not JSON"),
        ("[]", "the type is 'None'"),
        ('{"type": "FeatureCollection"}', "no list of features"),
    ):
        path.write_text(text)
        with pytest.raises(LogError, match=part):
            read_road(path, SceneParts())
    path.write_bytes(b"\xff\xfe\xff")
    with pytest.raises(LogError, match="not JSON"):
        read_road(path, SceneParts())
    for nothing in (tmp_path / "none.geojson", tmp_path):
        with pytest.raises(LogError, match="no such file"):
            read_road(nothing, SceneParts())
    with path.open("wb") as stream:
        stream.truncate(2**25 + 1)
    with pytest.raises(LogError, match="larger than"):
        read_road(path, SceneParts())


def test_a_line_of_very_many_points_is_refused(tmp_path: Path) -> None:
    long = feature("LineString", [[x, 0] for x in range(20_001)], kind="edge")
    with pytest.raises(LogError, match="feature 0: it has more than 20000 points; cut it into several"):
        read(tmp_path, long)
