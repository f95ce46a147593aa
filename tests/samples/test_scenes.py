"""What the sample scenes record: plausible driving, real collisions, goals that are met."""

from __future__ import annotations

import itertools
import json
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import shapely

from istc_replay.config import GuidanceConfig
from istc_replay.errors import ScenarioError, UsageError
from istc_replay.geometry import box_corners
from istc_replay.samples.drive import RecordedScene
from istc_replay.samples.sceneform import parse_scene
from istc_replay.samples.scenes import SAMPLES, find_sample, packaged_scene, record
from istc_replay.states import STATES_SCHEMA

NAMES = ("intersection_turn_first", "dense_4")


@cache
def recorded(name: str) -> RecordedScene:
    return SAMPLES[name].record()


def tracks(scene: RecordedScene) -> dict[str, pl.DataFrame]:
    return {
        str(vehicle): track for (vehicle,), track in scene.states.group_by("vehicle_id", maintain_order=True)
    }


def boxes(track: pl.DataFrame) -> list[shapely.Polygon]:
    columns = ("x_m", "y_m", "heading_rad", "length_m", "width_m")
    return [shapely.Polygon(corners) for corners in box_corners(*(track[c].to_numpy() for c in columns))]


def overlaps(scene: RecordedScene) -> dict[tuple[str, str], float]:
    """The largest area that two boxes share at the same time, by pair."""
    outlines = {vehicle: boxes(track) for vehicle, track in tracks(scene).items()}
    return {
        (a, b): max(p.intersection(q).area for p, q in zip(outlines[a], outlines[b], strict=True))
        for a, b in itertools.combinations(outlines, 2)
    }


@pytest.mark.parametrize("name", NAMES)
def test_states_are_sampled_at_10_hz_from_a_common_start(name: str) -> None:
    scene = recorded(name)
    assert scene.states.schema == STATES_SCHEMA
    for track in tracks(scene).values():
        assert track["time_ns"][0] == 1_700_000_000_000_000_000
        assert track["time_ns"].diff().drop_nulls().unique().to_list() == [100_000_000]


@pytest.mark.parametrize("name", NAMES)
def test_positions_move_as_a_bicycle_with_the_recorded_speed_and_steering(name: str) -> None:
    for track in tracks(recorded(name)).values():
        x, y, speed, steering = (track[c].to_numpy() for c in ("x_m", "y_m", "speed_mps", "steering_rad"))
        heading = np.unwrap(track["heading_rad"].to_numpy())
        ahead, wheelbase, h = track["rear_axle_to_centre_m"][0], track["wheelbase_m"][0], 0.1
        turning = speed * np.tan(steering) / wheelbase
        vx = speed * np.cos(heading) - ahead * turning * np.sin(heading)
        vy = speed * np.sin(heading) + ahead * turning * np.cos(heading)
        np.testing.assert_allclose(np.diff(heading) / h, (turning[1:] + turning[:-1]) / 2, atol=0.02)
        np.testing.assert_allclose(np.diff(x) / h, (vx[1:] + vx[:-1]) / 2, atol=0.05)
        np.testing.assert_allclose(np.diff(y) / h, (vy[1:] + vy[:-1]) / 2, atol=0.05)
        acceleration = track["acceleration_mps2"].to_numpy()
        braking = (acceleration[1:] != 0) & (acceleration[:-1] != 0)
        np.testing.assert_allclose((np.diff(speed) / h)[braking], acceleration[1:][braking], atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_steering_is_within_what_a_car_can_do(name: str) -> None:
    states = recorded(name).states
    assert states["steering_rad"].abs().max() <= 0.6
    assert states["steering_rate_radps"].abs().max() <= 0.8
    for track in tracks(recorded(name)).values():
        assert track["steering_rad"].diff().abs().max() <= 0.08 + 1e-9


def test_all_three_vehicles_collide_with_one_another_at_the_intersection() -> None:
    areas = overlaps(recorded("intersection_turn_first"))
    assert len(areas) == 3
    assert min(areas.values()) > 0.01


def test_the_intersection_is_driven_at_5_mps_on_lanes_of_the_vehicles_own() -> None:
    scene = recorded("intersection_turn_first")
    lanes = {line.vehicle_id: shapely.LineString(line.points_m) for line in scene.scene.lane_lines}
    for vehicle, track in tracks(scene).items():
        assert track["speed_mps"].unique().to_list() == [5.0]
        assert track.height == 101
        centres = shapely.points(track["x_m"].to_numpy(), track["y_m"].to_numpy())
        assert lanes[vehicle].distance(centres).max() < 2e-3
        assert lanes[vehicle].project(centres[0]) > 30.0
        assert lanes[vehicle].length - lanes[vehicle].project(centres[-1]) > 25.0


def test_the_turning_vehicle_crosses_both_others_lanes_and_leaves_southbound() -> None:
    scene = recorded("intersection_turn_first")
    lanes = {line.vehicle_id: shapely.LineString(line.points_m) for line in scene.scene.lane_lines}
    assert lanes["3"].intersects(lanes["1"])
    assert lanes["3"].intersects(lanes["2"])
    last = tracks(scene)["3"].row(-1, named=True)
    assert last["x_m"] == pytest.approx(-2.5, abs=1e-6)
    assert last["heading_rad"] == pytest.approx(-np.pi / 2, abs=1e-6)
    # Road width 10 m: no box leaves the two roads.
    roads = shapely.union(shapely.box(-70, -5, 70, 5), shapely.box(-5, -70, 5, 70))
    assert all(roads.covers(box) for track in tracks(scene).values() for box in boxes(track))


@pytest.mark.parametrize(
    ("name", "priorities"),
    [
        ("intersection_turn_first", {"1": 0.20, "2": 0.01, "3": 0.50}),
        ("intersection_straight_first", {"1": 0.50, "2": 0.40, "3": 0.01}),
    ],
)
def test_priorities_are_those_of_table_ii(name: str, priorities: dict[str, float]) -> None:
    scene = recorded(name)
    assert {vehicle.vehicle_id: vehicle.priority for vehicle in scene.scene.vehicles} == priorities
    assert scene.states.equals(recorded("intersection_turn_first").states)


def test_the_dense_crossing_starts_and_stands_where_its_scene_says() -> None:
    form, scene = parse_scene(packaged()), recorded("dense_4")
    for vehicle in form.vehicles:
        track = tracks(scene)[vehicle.id]
        for row, pose in (
            (track.row(0, named=True), vehicle.start),
            (track.row(-1, named=True), vehicle.goal),
        ):
            ahead = row["rear_axle_to_centre_m"]
            assert row["x_m"] - ahead * np.cos(row["heading_rad"]) == pytest.approx(pose.x_m, abs=0.01)
            assert row["y_m"] - ahead * np.sin(row["heading_rad"]) == pytest.approx(pose.y_m, abs=0.01)
            assert np.cos(row["heading_rad"] - pose.heading_rad) == pytest.approx(1.0, abs=1e-6)
        # It stands for the last three seconds.
        assert track.tail(31)["speed_mps"].to_list() == [0.0] * 31
    field = shapely.box(0, 0, 50, 38)
    assert all(field.covers(box) for track in tracks(scene).values() for box in boxes(track))


def test_vehicles_of_the_dense_crossing_miss_each_other_by_less_than_a_metre() -> None:
    outlines = [boxes(track) for track in tracks(recorded("dense_4")).values()]
    gaps = [
        min(p.distance(q) for p, q in zip(a, b, strict=True)) for a, b in itertools.combinations(outlines, 2)
    ]
    assert 0.0 < min(gaps) < 1.0


def packaged() -> str:
    return resources.files("istc_replay").joinpath("data/dense_4.json").read_text(encoding="utf-8")


def with_block(*block: float) -> str:
    """Vehicle 1 of the packaged scene alone, and one obstacle."""
    values = json.loads(packaged())
    values["vehicles"] = values["vehicles"][:1]
    values["obstacles"] = [dict(zip(("x_min_m", "x_max_m", "y_min_m", "y_max_m"), block, strict=True))]
    return json.dumps(values)


@pytest.mark.parametrize("block", [(22.0, 28.0, 6.0, 14.0), (25.0, 30.0, 2.0, 12.0), (20.0, 24.0, 9.0, 30.0)])
def test_a_vehicle_drives_around_an_obstacle(block: tuple[float, ...]) -> None:
    scene = record(parse_scene(with_block(*block)))
    obstacle = scene.scene.obstacles[0]
    outline = shapely.box(block[0], block[2], block[1], block[3])
    assert shapely.Polygon(
        box_corners(obstacle.x_m, obstacle.y_m, obstacle.heading_rad, obstacle.length_m, obstacle.width_m)
    ).equals(outline)
    track = tracks(scene)["1"]
    assert min(box.distance(outline) for box in boxes(track)) >= 0.29
    assert track["speed_mps"][-1] == 0.0


@pytest.mark.parametrize("block", [(20.0, 24.0, 0.0, 38.0), (5.0, 9.0, 4.0, 9.0)])
def test_a_vehicle_with_no_way_is_named_with_a_remedy(block: tuple[float, ...]) -> None:
    with pytest.raises(ScenarioError, match=r"dense_4: vehicle 1: no path.*move"):
        record(parse_scene(with_block(*block)))


def test_a_recording_that_would_never_end_is_refused() -> None:
    text = with_block(1.0, 2.0, 36.0, 37.0)
    values = json.loads(text)
    values["speed_mps"] = 0.5
    values["map"]["x_max_m"] = 1500.0
    values["vehicles"][0]["goal"]["x_m"] = 1400.0
    with pytest.raises(ScenarioError, match="at most 900 s"):
        record(parse_scene(json.dumps(values)))


def test_a_short_way_is_driven_slowly_enough_to_stop() -> None:
    values = json.loads(with_block(1.0, 2.0, 36.0, 37.0))
    values["vehicles"][0]["goal"] = {"x_m": 12.5, "y_m": 6.5, "heading_rad": 0.0}
    track = tracks(record(parse_scene(json.dumps(values))))["1"]
    assert track["speed_mps"][0] == pytest.approx(np.sqrt(2 * 2.0 * 4.75), abs=1e-6)
    assert track["x_m"][-1] == pytest.approx(12.5 + 1.35, abs=1e-6)


def test_every_sample_has_a_name_and_a_line() -> None:
    names = {name: sample.description for name, sample in SAMPLES.items()}
    dense = {f"dense_{count}{kind}" for count in (4, 6, 8) for kind in ("", "_obstacles", "_row")}
    assert set(names) == dense | {
        "dense_12",
        "dense_16",
        "dense_24",
        "intersection_turn_first",
        "intersection_straight_first",
        "intersection_osi",
        "intersection_odometry",
    }
    assert all(line and "\n" not in line for line in names.values())


def test_an_unknown_sample_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(UsageError, match="dense_4"):
        find_sample("dense_5")


def shifted(values: dict[str, Any], dx: float, dy: float) -> dict[str, Any]:
    for box in (values["map"], *values["obstacles"]):
        for axis, by in (("x", dx), ("y", dy)):
            box[f"{axis}_min_m"] += by
            box[f"{axis}_max_m"] += by
    for pose in (pose for vehicle in values["vehicles"] for pose in (vehicle["start"], vehicle["goal"])):
        pose["x_m"] += dx
        pose["y_m"] += dy
    return values


def test_a_shifted_scene_is_driven_alike() -> None:
    here = json.loads(with_block(22.0, 28.0, 6.0, 14.0))
    there = shifted(json.loads(json.dumps(here)), 1000.0, -500.0)
    first, second = (record(parse_scene(json.dumps(values))).states for values in (here, there))
    np.testing.assert_allclose(second["x_m"] - 1000.0, first["x_m"], atol=1e-6)
    np.testing.assert_allclose(second["y_m"] + 500.0, first["y_m"], atol=1e-6)


@pytest.mark.parametrize("name", ["dense_6_row", "dense_8", "dense_8_obstacles"])
def test_a_dense_crossing_is_driven_clear_of_its_blocks_and_within_its_map(name: str) -> None:
    scene = recorded(name)
    blocks = [
        shapely.Polygon(box_corners(o.x_m, o.y_m, o.heading_rad, o.length_m, o.width_m))
        for o in scene.scene.obstacles
    ]
    field = shapely.box(-1e-6, -1e-6, 50 + 1e-6, 38 + 1e-6)
    for track in tracks(scene).values():
        assert track["speed_mps"][-1] == 0.0
        assert track["steering_rate_radps"].abs().max() <= 0.8
        for box in boxes(track):
            assert field.covers(box)
            assert all(box.distance(block) >= 0.29 for block in blocks)


@pytest.mark.parametrize("kind", ["", "_obstacles", "_row"])
@pytest.mark.parametrize("vehicles", [4, 6, 8])
def test_packaged_scenes_are_those_of_the_reference_data(
    vehicles: int, kind: str, shared_scenarios: Path
) -> None:
    name = f"dense_{vehicles}{kind}"
    file = shared_scenarios / f"{name}.json"
    assert packaged_scene(name) == parse_scene(file.read_text(encoding="utf-8"))


def test_coordinated_routing_is_a_setting_of_its_own() -> None:
    scene = packaged_scene("dense_6_row")
    alone, coordinated = (record(scene, GuidanceConfig(routing=r)) for r in ("independent", "coordinated"))
    first, same = (tracks(s)["1"].head(120) for s in (alone, coordinated))
    assert first.equals(same), "the first to be routed knows nobody"
    assert not alone.states.equals(coordinated.states)
