"""What Foxglove shows is where the result says it is, when it says so, and goes when it ends."""

from __future__ import annotations

import dataclasses
import io
import math
from collections import defaultdict
from itertools import pairwise

import numpy as np
import polars as pl
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from istc_replay.datatypes import (
    LaneLine,
    MapBounds,
    Result,
    RoadEdge,
    WindowPlan,
    read_only,
)

from ..support.foxglove import Messages, Plan, S, by_topic, corners, made, ns, visible, yaw


@pytest.fixture(scope="module")
def shown(synthetic_bytes: bytes) -> Messages:
    """The messages as an independent reader gives them."""
    reader = make_reader(io.BytesIO(synthetic_bytes), decoder_factories=[DecoderFactory()])
    return by_topic(
        (m.log_time, channel.topic, decoded) for _, channel, m, decoded in reader.iter_decoded_messages()
    )


# --- places ----------------------------------------------------------------------------------


@pytest.mark.parametrize("source", ["planned", "recorded"])
def test_a_vehicles_cube_stands_where_its_state_does(
    shown: Messages, synthetic_result: Result, source: str
) -> None:
    scenes = dict(shown["/istc/scene"])
    states = synthetic_result.states.filter(pl.col("source") == source)
    for state in states.iter_rows(named=True):
        name = f"{source}/{state['vehicle_id'].replace(' ', '%20')}"
        (entity,) = [e for e in scenes[state["time_ns"]].entities if e.id == name]
        (cube,) = entity.cubes
        assert (entity.frame_id, ns(entity.timestamp)) == ("map", state["time_ns"])
        assert cube.pose.position.x == pytest.approx(state["x_m"], abs=1e-9)
        assert cube.pose.position.y == pytest.approx(state["y_m"], abs=1e-9)
        turn = yaw(cube.pose.orientation) - state["heading_rad"]
        assert math.remainder(turn, math.tau) == pytest.approx(0.0, abs=1e-9)
        assert (cube.size.x, cube.size.y) == (state["length_m"], state["width_m"])
        assert cube.pose.position.z == cube.size.z / 2.0


def test_transforms_lead_to_every_recorded_and_planned_state(
    shown: Messages, synthetic_result: Result
) -> None:
    found = {}
    for time_ns, message in shown["/tf"]:
        for transform in message.transforms:
            assert (transform.parent_frame_id, ns(transform.timestamp)) == ("map", time_ns)
            at = transform.translation
            found[transform.child_frame_id, time_ns] = (at.x, at.y, yaw(transform.rotation))
    children = {"recorded": "recorded", "planned": "vehicle"}
    states = synthetic_result.states.filter(pl.col("source") != "guidance")
    for state in states.iter_rows(named=True):
        child = f"{children[state['source']]}/{state['vehicle_id'].replace(' ', '%20')}"
        x, y, turn = found.pop((child, state["time_ns"]))
        assert (x, y) == (state["x_m"], state["y_m"])
        assert math.remainder(turn - state["heading_rad"], math.tau) == pytest.approx(0.0, abs=1e-12)
    assert found == {
        ("corridor/0", synthetic_result.corridors["start_ns"].min()): (120.0, -40.0, pytest.approx(0.3))
    }


def test_a_corridor_cube_is_the_turned_box_of_its_unit(shown: Messages, synthetic_result: Result) -> None:
    scenes = dict(shown["/istc/scene"])
    for row in synthetic_result.corridors.iter_rows(named=True):
        name = f"corridor/{row['vehicle_id'].replace(' ', '%20')}"
        (entity,) = [e for e in scenes[row["start_ns"]].entities if e.id == name]
        assert ns(entity.timestamp) == row["start_ns"]
        assert ns(entity.lifetime) == row["end_ns"] - row["start_ns"] == S
        c, s = math.cos(0.3), math.sin(0.3)
        expected = [
            (120.0 + c * x - s * y, -40.0 + s * x + c * y)
            for x in (row["x_min_m"], row["x_max_m"])
            for y in (row["y_min_m"], row["y_max_m"])
        ]
        assert corners(entity.cubes[0]) == pytest.approx(np.array(sorted(expected)), abs=1e-8)


def test_paths_are_the_planned_poses(shown: Messages, synthetic_result: Result) -> None:
    planned = synthetic_result.states.filter(pl.col("source") == "planned")
    for (vehicle_id,), states in planned.group_by("vehicle_id"):
        ((time_ns, path),) = shown[f"/istc/path/{str(vehicle_id).replace(' ', '%20')}"]
        assert (time_ns, ns(path.timestamp), path.frame_id) == (states["time_ns"].min(), time_ns, "map")
        assert [(pose.position.x, pose.position.y) for pose in path.poses] == states.select(
            "x_m", "y_m"
        ).rows()


def test_lane_lines_obstacles_and_bounds_are_drawn(synthetic_plan: Plan) -> None:
    log, plans = synthetic_plan
    left, middle, right = (read_only([[0.0, y], [9.0, y]]) for y in (2.0, 0.0, -2.0))
    edged, kerb = (
        LaneLine("edged", middle, None, left, right),
        RoadEdge("kerb", read_only([[0.0, 3.0], [5.0, 3.0]])),
    )
    bounds = MapBounds(-1.0, 2.0, -3.0, 4.0)
    lanes = (*log.scene.lane_lines, edged)
    scene = dataclasses.replace(log.scene, bounds=bounds, lane_lines=lanes, road_edges=(kerb,))
    (_, first), *_ = made(dataclasses.replace(log, scene=scene), plans)["/istc/scene"]
    entities = {entity.id: entity for entity in first.entities}
    for index, lane in enumerate(log.scene.lane_lines):
        points = entities[f"lane/{index}"].lines[0].points
        assert [(p.x, p.y) for p in points] == list(map(tuple, lane.points_m.tolist()))
    assert len(entities["bounds"].lines[0].points) == 4
    edges = [[[p.x, p.y] for p in line.points] for line in entities["road"].lines]
    assert edges == [each.tolist() for each in (left, right, kerb.points_m)]
    assert yaw(entities["standing/block"].cubes[0].pose.orientation) == pytest.approx(0.3)
    assert (entities["standing/block"].cubes[0].size.x, entities["standing/block"].cubes[0].size.y) == (
        6.0,
        3.0,
    )


def test_a_vehicle_keeps_its_colour(shown: Messages) -> None:
    colours = defaultdict(set)
    for _, message in shown["/istc/scene"]:
        for entity in message.entities:
            for cube in entity.cubes:
                colours[entity.id].add((cube.color.r, cube.color.g, cube.color.b))
    assert all(len(found) == 1 for found in colours.values())
    for car in ("car%201", "car%202", "car%203"):
        assert colours[f"planned/{car}"] == colours[f"corridor/{car}"]
        assert colours[f"planned/{car}"] != colours[f"recorded/{car}"]
    assert len({next(iter(colours[f"planned/car%20{i}"])) for i in (1, 2, 3)}) == 3


# --- times -----------------------------------------------------------------------------------


def expected_at(result: Result, time_ns: int) -> set[str]:
    """Names of the moving entities that a player should show at an instant, from the tables alone."""
    names = set()
    for (source, vehicle), states in result.states.group_by("source", "vehicle_id"):
        step = 200_000_000 if source == "planned" else 100_000_000
        if source != "guidance" and states["time_ns"].min() <= time_ns < states["time_ns"].max() + step:
            names.add(f"{source}/{vehicle}")
    for table, column, kind in (
        (result.corridors, "vehicle_id", "corridor"),
        (result.obstacles, "obstacle_id", "obstacle"),
    ):
        now = table.filter((pl.col("start_ns") <= time_ns) & (time_ns < pl.col("end_ns")))
        names |= {f"{kind}/{name}" for name in now[column]}
    return {name.replace(" ", "%20") for name in names}


@pytest.mark.parametrize("after_seek", [False, True])
def test_at_every_instant_just_what_is_there_is_shown(
    shown: Messages, synthetic_result: Result, after_seek: bool
) -> None:
    start_ns = synthetic_result.corridors["start_ns"].min()
    assert isinstance(start_ns, int)
    for time_ns in range(start_ns, start_ns + 6 * S, 47_000_000):
        names = set(visible(shown["/istc/scene"], time_ns, after_seek))
        still = {"lane/0", "lane/1", "standing/block"}
        assert names - still == expected_at(synthetic_result, time_ns)
        assert still <= names


def test_no_vehicle_outlives_its_frame(shown: Messages) -> None:
    frames = shown["/istc/scene"]
    for (time_ns, scene), (next_ns, _) in pairwise(frames):
        cars = [e for e in scene.entities if e.id.startswith(("recorded/", "planned/"))]
        assert cars
        assert all(time_ns < ns(e.timestamp) + ns(e.lifetime) <= next_ns for e in cars)


def test_every_knot_has_its_frame_among_crowded_recorded_instants(synthetic_plan: Plan) -> None:
    log, (plan,) = synthetic_plan
    window = dataclasses.replace(plan.scenario.window, start_ns=plan.scenario.window.start_ns + 20_000_000)
    plan = dataclasses.replace(plan, scenario=dataclasses.replace(plan.scenario, window=window))
    crowded = log.states.with_columns(pl.col("time_ns") + 19_000_000)
    frames = {time_ns for time_ns, _ in made(dataclasses.replace(log, states=crowded), [plan])["/istc/scene"]}
    assert {window.start_ns + i * S // 5 for i in range(31)} <= frames
    assert len(frames) < 100


def test_nothing_that_moved_lingers_after_the_end(shown: Messages) -> None:
    end_ns = max(time_ns for time_ns, _ in shown["/istc/scene"]) + S
    assert set(visible(shown["/istc/scene"], end_ns)) == {"lane/0", "lane/1", "standing/block"}


# --- windows ---------------------------------------------------------------------------------


def later(plan: WindowPlan, seconds: float) -> WindowPlan:
    window = plan.scenario.window
    shift_ns = round(seconds * S)
    moved = dataclasses.replace(
        window,
        index=window.index + 1,
        start_ns=window.start_ns + shift_ns,
        end_ns=window.end_ns + shift_ns,
        frame=dataclasses.replace(window.frame, x_m=window.frame.x_m + 500.0),
    )
    return dataclasses.replace(plan, scenario=dataclasses.replace(plan.scenario, window=moved))


@pytest.mark.parametrize("seconds", [6.0, 4.0, 3.5])
def test_where_windows_meet_or_overlap_each_thing_is_shown_once(synthetic_plan: Plan, seconds: float) -> None:
    log, (plan,) = synthetic_plan
    messages = made(log, [plan, later(plan, seconds)])
    begins_ns = plan.scenario.window.start_ns + round(seconds * S)
    for time_ns, scene in messages["/istc/scene"]:
        names = [entity.id for entity in scene.entities]
        assert len(names) == len(set(names))
        for entity in scene.entities:
            if entity.id.startswith(("planned/car%201", "corridor/car%201")):
                assert (entity.cubes[0].pose.position.x > 400.0) == (time_ns >= begins_ns)
    for time_ns, message in messages["/tf"]:
        children = [transform.child_frame_id for transform in message.transforms]
        assert len(children) == len(set(children)), time_ns


def test_a_path_goes_when_its_plan_ends_and_another_vehicles_goes_on(synthetic_plan: Plan) -> None:
    log, (plan,) = synthetic_plan
    second = later(plan, 6.0)
    second = dataclasses.replace(second, trajectories=second.trajectories[:1])
    messages = made(log, [plan, second])
    lengths = {car: [len(p.poses) for _, p in messages[f"/istc/path/car%20{car}"]] for car in (1, 2, 3)}
    assert lengths == {1: [31, 31], 2: [31, 0], 3: [26, 0]}
