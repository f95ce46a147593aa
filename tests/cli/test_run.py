"""`istc-replay run` with a road file beside the log."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from istc_replay.ingest.result import read_result

LOG = Path(__file__).resolve().parents[2] / "sample_logs" / "intersection_turn_first.mcap"
LANE = {
    "type": "Feature",
    "id": "main",
    "properties": {"kind": "lane", "width_m": 3.5},
    "geometry": {"type": "LineString", "coordinates": [[-60, -2.5], [60, -2.5]]},
}


def test_a_road_file_is_of_the_result(call: Callable[..., Any], tmp_path: Path) -> None:
    road, config = tmp_path / "road.geojson", tmp_path / "fast.toml"
    road.write_text(json.dumps({"type": "FeatureCollection", "features": [LANE]}))
    config.write_text('corridors.mode = "fast"\n')
    done = call("run", LOG, "-c", config, "--road", road, "-o", tmp_path / "out")
    assert done.returncode == 0
    result = read_result(tmp_path / "out" / LOG.stem / "result.mcap")
    (line,) = (each for each in result.scene.lane_lines if each.lane_id == "main")
    assert line.left_m is not None
    assert line.left_m[:, 1].tolist() == [-0.75, -0.75]
    assert len(result.scene.lane_lines) == 4
    assert f'road_file = "{road}"' in result.config_toml


def test_a_road_file_that_cannot_be_used_is_one_line(call: Callable[..., Any], tmp_path: Path) -> None:
    road = tmp_path / "road.geojson"
    road.write_text('{"type": "Feature", "geometry": {"type": "Point", "coordinates": [0, 0]}}')
    done = call("run", LOG, "--road", road, "-o", tmp_path / "out")
    assert done.returncode == 3
    assert done.stderr.startswith("istc-replay: ")
    assert "road.geojson: feature 0: its geometry is 'Point'" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list((tmp_path / "out").rglob("*.mcap"))
