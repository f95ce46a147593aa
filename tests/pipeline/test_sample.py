"""Sample logs of scene files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from istc_replay.errors import LogError, ScenarioError
from istc_replay.ingest.log import read_log
from istc_replay.pipeline.sample import write_sample


def test_a_scene_file_is_driven_from_its_starts(shared_scenarios: Path, tmp_path: Path) -> None:
    scene, out = shared_scenarios / "dense_4.json", tmp_path / "log.mcap"
    write_sample(str(scene), out)
    write_sample("dense_4", tmp_path / "packaged.mcap")
    assert out.read_bytes() == (tmp_path / "packaged.mcap").read_bytes()
    assert read_log(out).states["vehicle_id"].n_unique() == 4


@pytest.mark.parametrize(
    ("data", "error", "told"),
    [
        (b"\xff\xfe", LogError, "cannot be read"),
        (b" " * (16 * 2**20 + 1), LogError, "larger than 16777216 bytes"),
        (json.dumps({"vehicles": []}).encode(), ScenarioError, "scene.json"),
        (b"{", ScenarioError, "scene.json"),
    ],
)
def test_a_scene_file_that_cannot_be_used_is_told_and_writes_nothing(
    data: bytes, error: type[Exception], told: str, tmp_path: Path
) -> None:
    path = tmp_path / "scene.json"
    path.write_bytes(data)
    with pytest.raises(error, match=told) as caught:
        write_sample(str(path), tmp_path / "log.mcap")
    assert "\n" not in str(caught.value)
    assert [file.name for file in tmp_path.iterdir()] == ["scene.json"]


def test_a_missing_scene_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot be read"):
        write_sample(str(tmp_path / "none.json"), tmp_path / "log.mcap")
