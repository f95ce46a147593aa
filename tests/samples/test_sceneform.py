"""The form of scene files: what is taken and what is refused, in one line."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from istc_replay.errors import ScenarioError
from istc_replay.samples.sceneform import parse_scene, scene_schema

ROOT = Path(__file__).resolve().parents[2]


def packaged() -> dict[str, Any]:
    text = resources.files("istc_replay").joinpath("data/dense_4.json").read_text(encoding="utf-8")
    return dict(json.loads(text))


def test_the_packaged_scene_is_read_as_written() -> None:
    scene = parse_scene(json.dumps(packaged()))
    assert [vehicle.id for vehicle in scene.vehicles] == ["1", "2", "3", "4"]
    assert scene.vehicles[0].goal.x_m == 46.25
    assert scene.vehicle.dimensions.rear_axle_to_centre_m == 1.35


def test_whole_numbers_stand_for_metres_too() -> None:
    values = packaged()
    values["speed_mps"] = 5
    values["map"]["x_min_m"] = 0
    assert parse_scene(json.dumps(values)).speed_mps == 5.0


ABSENT = object()
SWAPPED = {"x_min_m": 5.0, "x_max_m": 4.0, "y_min_m": 0.0, "y_max_m": 1.0}
HERE = {"x_m": 7.75, "y_m": 6.5, "heading_rad": 1.0}


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("colour", "red", "unknown key colour"),
        ("vehicles.0.start.z_m", 0.0, "unknown key vehicles.0.start.z_m"),
        ("map", ABSENT, "missing key map"),
        ("vehicles.0.goal.heading_rad", ABSENT, "missing key vehicles.0.goal.heading_rad"),
        ("speed_mps", "5.0", "speed_mps = '5.0'"),
        ("vehicles.0.start.x_m", True, "vehicles.0.start.x_m = True"),
        ("vehicle.width_m", -2.0, "vehicle.width_m = -2.0"),
        ("vehicles", [], "vehicles"),
        ("vehicles.1.id", "1", "'1' is given twice"),
        ("vehicles.0.id", "../1", "vehicles.0.id"),
        ("obstacles", [SWAPPED], "obstacles.0: .*x_min_m must be below x_max_m"),
        ("vehicle.rear_overhang_m", 2.0, "must be at most length_m"),
        ("vehicles.0.goal", HERE, "at least 1 m apart"),
        ("map.x_max_m", 90_000.0, "at most 2000 m"),
    ],
)
def test_a_scene_that_breaks_the_form_is_refused_in_one_line(key: str, value: Any, told: str) -> None:
    values = packaged()
    *parents, last = (int(part) if part.isdigit() else part for part in key.split("."))
    place: Any = values
    for part in parents:
        place = place[part]
    if value is ABSENT:
        del place[last]
    else:
        place[last] = value
    with pytest.raises(ScenarioError, match=told) as caught:
        parse_scene(json.dumps(values), "my.json")
    assert str(caught.value).startswith("my.json: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999", "1" + "0" * 5000])
def test_numbers_that_are_not_finite_are_refused(number: str) -> None:
    text = json.dumps(packaged()).replace('"speed_mps": 5.0', f'"speed_mps": {number}')
    with pytest.raises(ScenarioError):
        parse_scene(text)


@pytest.mark.parametrize("text", ["", "{", "null", "[]", "[" * 100_000, '{"name": "\\ud800"}'])
def test_text_that_is_no_scene_is_refused(text: str) -> None:
    with pytest.raises(ScenarioError):
        parse_scene(text)


def test_the_json_schema_in_schemas_is_what_the_code_checks() -> None:
    written = json.loads((ROOT / "schemas/scene.schema.json").read_text(encoding="utf-8"))
    assert written == scene_schema(), "schemas/scene.schema.json is stale: run scripts/samples"


def test_all_scenes_of_the_reference_data_have_the_form(shared_scenarios: Path) -> None:
    files = sorted(shared_scenarios.glob("dense_*.json")) + sorted(shared_scenarios.glob("clcbs/*.json"))
    assert len(files) > 9
    for file in files:
        assert parse_scene(file.read_text(encoding="utf-8")).vehicles
