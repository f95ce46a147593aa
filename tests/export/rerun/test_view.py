"""The Rerun view, read back from its file and compared with the result that it shows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest
from shapely import affinity
from shapely.geometry import Point, Polygon, box

from istc_replay.config import Config
from istc_replay.datatypes import Frame, Result
from istc_replay.export.rerun.chunks import entity
from istc_replay.export.rerun.plots import precedences
from istc_replay.geometry import to_map
from istc_replay.states import CORRIDORS_SCHEMA, conform

CARS = ("car 1", "car 2", "car 3")
S = 1_000_000_000

Rows = list[dict[str, Any]]
View = Callable[[Result], dict[str, Rows]]


def holding(rows: Rows, component: str) -> Rows:
    """The rows, in time, that carry a component."""
    return sorted((r for r in rows if r.get(component) is not None), key=lambda r: r.get("time", 0))


def states_of(result: Result, source: str, vehicle: str) -> pl.DataFrame:
    return result.states.filter(pl.col("source") == source, pl.col("vehicle_id") == vehicle).sort("time_ns")


def start_ns(result: Result) -> int:
    return int(result.summary["windows"][0]["start_ns"])


def local(result: Result, table: pl.DataFrame) -> np.ndarray:
    frame = result.summary["windows"][0]["frame"]
    return table.select("x_m", "y_m").to_numpy() - (frame["x_m"], frame["y_m"])


# --- everything is there ---------------------------------------------------------------------


@pytest.mark.parametrize("source", ["recorded", "planned"])
@pytest.mark.parametrize("vehicle", CARS)
def test_every_state_is_a_box_at_its_time_and_place(
    synthetic_result: Result, entities: dict[str, Rows], source: str, vehicle: str
) -> None:
    states = states_of(synthetic_result, source, vehicle)
    rows = holding(entities[entity("now", source, "box", vehicle)], "Boxes3D:centers")
    assert [row["time"] for row in rows] == states["time_ns"].to_list()
    centres = np.array([row["Boxes3D:centers"][0] for row in rows])
    np.testing.assert_allclose(centres[:, :2], local(synthetic_result, states), atol=1e-4)
    x, y, z, w = np.array([row["Boxes3D:quaternions"][0] for row in rows]).T
    turns = 2.0 * np.arctan2(z, w) - states["heading_rad"].to_numpy()
    np.testing.assert_allclose(np.cos(turns), 1.0, atol=1e-6)
    assert not x.any()
    assert not y.any()
    (style,) = holding(entities[entity("now", source, "box", vehicle)], "Boxes3D:half_sizes")
    np.testing.assert_allclose(style["Boxes3D:half_sizes"][0][:2], [2.0, 1.0])


def test_the_three_timelines_agree(synthetic_result: Result, entities: dict[str, Rows]) -> None:
    start = start_ns(synthetic_result)
    for row in holding(entities["/plots/speed/planned/car\\ 1"], "Scalars:scalars"):
        assert row["scenario_time"] == row["time"] - start
        assert row["time_unit"] == row["scenario_time"] // S


@pytest.mark.parametrize("vehicle", CARS)
def test_every_cube_stands_at_its_height_and_holds_the_plan(
    synthetic_result: Result, entities: dict[str, Rows], vehicle: str
) -> None:
    corridor = synthetic_result.corridors.filter(pl.col("vehicle_id") == vehicle).sort("k")
    (overview,) = holding(entities[entity("space_time", "planned", "corridors", vehicle)], "Boxes3D:centers")
    present = holding(entities[entity("space_time", "planned", "present", vehicle)], "Boxes3D:centers")
    assert len(overview["Boxes3D:centers"]) == corridor.height
    assert [row["time"] for row in present] == corridor["start_ns"].to_list()
    planned = states_of(synthetic_result, "planned", vehicle)
    seconds = ((planned["time_ns"] - start_ns(synthetic_result)) / S).to_numpy()
    points = local(synthetic_result, planned)
    for i, cube in enumerate(corridor.iter_rows(named=True)):
        centre, half = overview["Boxes3D:centers"][i], overview["Boxes3D:half_sizes"][i]
        assert present[i]["Boxes3D:centers"][0] == centre
        assert centre[2] - half[2] == pytest.approx(2.0 * cube["k"], abs=1e-5)
        assert centre[2] + half[2] == pytest.approx(2.0 * (cube["k"] + 1), abs=1e-5)
        _, _, z, w = overview["Boxes3D:quaternions"][i]
        ground = affinity.rotate(
            box(-half[0], -half[1], half[0], half[1]), 2.0 * math.atan2(z, w), (0, 0), use_radians=True
        )
        ground = affinity.translate(ground, centre[0], centre[1])
        inside = (seconds >= cube["k"]) & (seconds <= cube["k"] + 1)
        assert inside.any()
        assert all(ground.covers(Point(point)) for point in points[inside])


def test_the_planned_line_rises_with_time(synthetic_result: Result, entities: dict[str, Rows]) -> None:
    (row,) = holding(entities["/space_time/planned/trajectory/car\\ 2"], "LineStrips3D:strips")
    states = states_of(synthetic_result, "planned", "car 2")
    heights = 2.0 * (states["time_ns"].to_numpy() - start_ns(synthetic_result)) / S
    expected = np.column_stack([local(synthetic_result, states), heights])
    np.testing.assert_allclose(row["LineStrips3D:strips"][0], expected, atol=1e-4)


def test_the_present_plane_rises_with_time(synthetic_result: Result, entities: dict[str, Rows]) -> None:
    rows = holding(entities["/now"], "Transform3D:translation")
    seconds = np.array([row["scenario_time"] for row in rows]) / S
    heights = np.array([row["Transform3D:translation"][0][2] for row in rows])
    np.testing.assert_allclose(heights, 2.0 * seconds, atol=1e-5)
    assert (seconds[0], seconds[-1]) == (0.0, 6.0)


def test_pivotal_points_map_and_obstacles_are_drawn(
    synthetic_result: Result, entities: dict[str, Rows]
) -> None:
    (pivots,) = holding(entities["/space_time/planned/pivots/car\\ 3"], "Points3D:positions")
    assert len(pivots["Points3D:positions"]) == 6  # five cubes
    (lanes,) = holding(entities["/now/shared/map/0"], "LineStrips3D:strips")
    assert [len(line) for line in lanes["LineStrips3D:strips"]] == [2, 3]
    standing = holding(entities["/now/shared/obstacles"], "Boxes3D:labels")
    labels = [row["Boxes3D:labels"] for row in standing]
    assert labels == [["block"]] * 2 + [["block", "walker"]] * 4
    (towers,) = holding(entities["/space_time/shared/obstacles"], "Boxes3D:half_sizes")
    heights = sorted(round(half[2]) for half in towers["Boxes3D:half_sizes"])
    assert heights == [1, 1, 1, 1, 6]  # the walker's four units, the block's whole window


def test_limits_are_those_of_the_configuration(entities: dict[str, Rows]) -> None:
    limits = Config().trajectories
    expected = {
        "speed": (0.0, limits.speed_max_mps),
        "acceleration": (-limits.deceleration_max_mps2, limits.acceleration_max_mps2),
        "steering": (-limits.steering_max_rad, limits.steering_max_rad),
        "jerk": (-limits.jerk_max_mps3, limits.jerk_max_mps3),
    }
    for signal, pair in expected.items():
        rows = holding(entities[f"/plots/{signal}/limit"], "Scalars:scalars")
        assert len(rows) == 2
        assert all(tuple(row["Scalars:scalars"]) == pair for row in rows)


def test_the_speed_limit_is_raised_for_faster_traffic(synthetic_result: Result, view_of: View) -> None:
    faster = synthetic_result.states.with_columns(pl.col("speed_mps") * 4.0)
    rows = view_of(replace(synthetic_result, states=faster))["/plots/speed/limit"]
    fastest = synthetic_result.states.filter(pl.col("source") == "recorded")["speed_mps"].max()
    for row in holding(rows, "Scalars:scalars"):
        assert row["Scalars:scalars"][1] == pytest.approx(1.15 * 4.0 * float(fastest) + 1.0)  # type: ignore[arg-type]


def test_clearances_are_distances_of_the_boxes(synthetic_result: Result, entities: dict[str, Rows]) -> None:
    path = entity("plots", "clearance", "planned", "car 1 / car 2")
    for row in holding(entities[path], "Scalars:scalars"):
        gap = row["Scalars:scalars"][0]
        if math.isnan(gap) or row["time"] % (S // 5):
            continue  # between the plan's knots there is nothing to compare with
        boxes = [_footprint(synthetic_result, name, row["time"]) for name in ("car 1", "car 2")]
        assert gap == pytest.approx(boxes[0].distance(boxes[1]), abs=1e-6)


def _footprint(result: Result, vehicle: str, time_ns: int) -> Polygon:
    state = states_of(result, "planned", vehicle).filter(pl.col("time_ns") == time_ns).row(0, named=True)
    half_m = state["length_m"] / 2.0, state["width_m"] / 2.0
    outline = affinity.rotate(
        box(-half_m[0], -half_m[1], half_m[0], half_m[1]), state["heading_rad"], (0, 0), use_radians=True
    )
    return affinity.translate(outline, state["x_m"], state["y_m"])


def test_the_report_tells_vehicles_certificate_and_origin(entities: dict[str, Rows]) -> None:
    (row,) = entities["/report"]
    text = row["TextDocument:text"][0]
    assert row["TextDocument:media_type"] == ["text/markdown"]
    for word in ("car 1", "car 2", "car 3", "dynamics", "**fail**", "x = 120.000 m, y = -40.000 m", "daqp"):
        assert word in text


# --- time ------------------------------------------------------------------------------------


def test_a_vehicle_is_absent_before_its_first_and_after_its_last_state(
    synthetic_result: Result, entities: dict[str, Rows]
) -> None:
    states = states_of(synthetic_result, "planned", "car 3")
    last = states["time_ns"][-1]
    for path in ("box", "trail"):
        rows = entities[entity("now", "planned", path, "car 3")]
        timed = [row for row in rows if "time" in row]
        assert min(row["time"] for row in timed) >= states["time_ns"][0]
        (cleared,) = holding(rows, "Clear:is_recursive")
        assert last < cleared["time"] <= last + S // 2
        assert cleared["time_unit"] > max(row["time_unit"] for row in timed if row is not cleared) - 1
    (cleared,) = holding(entities[entity("now", "planned", "cube", "car 3")], "Clear:is_recursive")
    assert cleared["time"] == last


def test_an_interrupted_recording_is_cleared_and_its_plot_has_a_gap(
    synthetic_result: Result, view_of: View
) -> None:
    start = start_ns(synthetic_result)
    gap = pl.col("time_ns").is_between(start + 2 * S, start + 4 * S) & (pl.col("source") == "recorded")
    entities = view_of(replace(synthetic_result, states=synthetic_result.states.filter(~gap)))
    rows = entities[entity("now", "recorded", "box", "car 1")]
    cleared = [row["scenario_time"] for row in holding(rows, "Clear:is_recursive")]
    assert cleared == [2 * S, 6_100_000_000]
    speeds = holding(entities[entity("plots", "speed", "recorded", "car 1")], "Scalars:scalars")
    broken = [row["scenario_time"] for row in speeds if math.isnan(row["Scalars:scalars"][0])]
    assert broken == [2 * S]


def _later(result: Result, delay_ns: int) -> Result:
    """The result with its window a second time, `delay_ns` later."""
    states = result.states.with_columns(pl.col("time_ns") + delay_ns, pl.lit(1, pl.Int32).alias("window"))
    corridors = result.corridors.with_columns(
        pl.col("start_ns", "end_ns") + delay_ns, pl.lit(1, pl.Int32).alias("window")
    )
    first = result.summary["windows"][0]
    second = {
        **first,
        "index": 1,
        "start_ns": first["start_ns"] + delay_ns,
        "end_ns": first["end_ns"] + delay_ns,
    }
    return replace(
        result,
        states=pl.concat([result.states, states]),
        corridors=pl.concat([result.corridors, corridors]),
        summary={**result.summary, "windows": [first, second]},
    )


def test_each_window_shows_its_own_corridors(synthetic_result: Result, view_of: View) -> None:
    entities = view_of(_later(synthetic_result, 8 * S))
    rows = entities[entity("space_time", "planned", "corridors", "car 2")]
    windows = holding(rows, "Boxes3D:centers")
    assert [row["scenario_time"] for row in windows] == [0, 8 * S]
    assert windows[0]["Boxes3D:centers"] == windows[1]["Boxes3D:centers"]  # both stand on the ground
    (cleared,) = holding(rows, "Clear:is_recursive")  # the last window's stay in sight
    assert cleared["scenario_time"] == 6 * S
    assert [row["scenario_time"] for row in entities["/report"]] == [0, 8 * S]
    units = [row["time_unit"] for row in holding(entities["/now"], "Transform3D:translation")]
    assert units == sorted(units)
    assert max(units) == 12


def test_where_windows_overlap_the_later_plan_is_shown(synthetic_result: Result, view_of: View) -> None:
    entities = view_of(_later(synthetic_result, 4 * S))
    rows = holding(entities[entity("now", "planned", "box", "car 1")], "Boxes3D:centers")
    times = [row["scenario_time"] for row in rows]
    assert times == sorted(set(times))
    start_of_second = rows[0]["Boxes3D:centers"]
    assert rows[times.index(4 * S)]["Boxes3D:centers"] == start_of_second
    cubes = holding(entities[entity("now", "planned", "cube", "car 1")], "Boxes3D:centers")
    assert [row["scenario_time"] for row in cubes] == [k * S for k in range(10)]


def test_manoeuvres_follow_their_rule(synthetic_result: Result, view_of: View) -> None:
    start = start_ns(synthetic_result)
    seconds = (pl.col("time_ns") - start) / S
    mine = (pl.col("vehicle_id") == "car 2") & (pl.col("source") == "planned")
    slow = pl.when(mine & seconds.is_between(1.0, 1.9)).then(2.0).when(mine & seconds.is_between(2.0, 2.9))
    slowed = slow.then(0.1).otherwise(pl.col("speed_mps")).alias("speed_mps")
    swing = pl.when(mine & (seconds >= 4.0)).then(pl.col("heading_rad") + 0.3 * (seconds - 4.0))
    turned = swing.otherwise(pl.col("heading_rad")).alias("heading_rad")
    states = synthetic_result.states.with_columns(slowed, turned)
    rows = view_of(replace(synthetic_result, states=states))[entity("states", "car 2")]
    changes = holding(rows, "StateChange:state")
    told = [(round(row["scenario_time"] / S, 1), *row["StateChange:state"]) for row in changes]
    expected = [(0.0, "cruise"), (1.0, "yield"), (2.0, "stop"), (3.0, "cruise"), (4.0, "turn"), (6.2,)]
    assert [word[1:] for word in told] == [word[1:] for word in expected]
    np.testing.assert_allclose([word[0] for word in told], [word[0] for word in expected], atol=0.2)


def test_who_is_on_common_ground_earlier_goes_first() -> None:
    cubes = [("b", 0, 0.0), ("b", 1, 10.0), ("a", 0, 20.0), ("a", 1, 0.0), ("c", 0, 50.0)]
    rows = [
        {"vehicle_id": v, "k": k, "x_min_m": x, "x_max_m": x + 5.0, "y_min_m": 0.0, "y_max_m": 5.0}
        for v, k, x in cubes
    ]
    table = conform(pl.DataFrame(rows), CORRIDORS_SCHEMA)
    assert precedences(table) == [("b", "a")]
    assert precedences(table.with_columns(pl.col("vehicle_id").replace({"a": "b", "b": "a"}))) == [("a", "b")]


# --- places ----------------------------------------------------------------------------------


def test_coordinates_of_a_map_grid_lose_nothing(synthetic_result: Result, view_of: View) -> None:
    moved = _moved(synthetic_result, 448_000.0, 5_412_000.0)
    here, there = view_of(synthetic_result), view_of(moved)
    assert here.keys() == there.keys()
    for path in ("/now/planned/box/car\\ 1", "/space_time/planned/corridors/car\\ 3"):
        ours, theirs = (holding(rows[path], "Boxes3D:centers") for rows in (here, there))
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(a["Boxes3D:centers"], b["Boxes3D:centers"], atol=1e-5)
    (report,) = there["/report"]
    assert "x = 448120.000 m, y = 5411960.000 m" in report["TextDocument:text"][0]


def _moved(result: Result, x_m: float, y_m: float) -> Result:
    (window,) = result.summary["windows"]
    frame = {**window["frame"], "x_m": window["frame"]["x_m"] + x_m, "y_m": window["frame"]["y_m"] + y_m}
    frame_columns = (pl.col("frame_x_m") + x_m, pl.col("frame_y_m") + y_m)
    scene = result.scene
    return replace(
        result,
        states=result.states.with_columns(pl.col("x_m") + x_m, pl.col("y_m") + y_m),
        corridors=result.corridors.with_columns(*frame_columns),
        obstacles=result.obstacles.with_columns(*frame_columns),
        scene=replace(
            scene,
            lane_lines=tuple(replace(a, points_m=a.points_m + (x_m, y_m)) for a in scene.lane_lines),
            obstacles=tuple(replace(o, x_m=o.x_m + x_m, y_m=o.y_m + y_m) for o in scene.obstacles),
        ),
        summary={**result.summary, "windows": [{**window, "frame": frame}]},
    )


def test_cubes_of_a_turned_frame_are_turned(synthetic_result: Result, entities: dict[str, Rows]) -> None:
    corridor = synthetic_result.corridors.filter(pl.col("vehicle_id") == "car 1").row(0, named=True)
    frame = Frame(corridor["frame_x_m"], corridor["frame_y_m"], corridor["frame_yaw_rad"])
    assert frame.yaw_rad != 0.0
    middle = [(corridor[f"{axis}_min_m"] + corridor[f"{axis}_max_m"]) / 2.0 for axis in "xy"]
    row = holding(entities["/now/planned/cube/car\\ 1"], "Boxes3D:centers")[0]
    expected = to_map(middle, frame) - (frame.x_m, frame.y_m)
    np.testing.assert_allclose(row["Boxes3D:centers"][0][:2], expected, atol=1e-5)
    _, _, z, w = row["Boxes3D:quaternions"][0]
    assert 2.0 * math.atan2(z, w) == pytest.approx(frame.yaw_rad, abs=1e-6)
