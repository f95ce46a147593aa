"""A result is read back as it was written."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import polars as pl
from hypothesis import given, settings
from hypothesis import strategies as st
from polars.testing import assert_frame_equal

from istc_replay.datatypes import (
    Certificate,
    Corridor,
    Corridors,
    Frame,
    LaneLine,
    Log,
    MapBounds,
    Obstacle,
    Result,
    RoadArea,
    RoadEdge,
    Scenario,
    SceneObstacle,
    SolveStatus,
    StaticScene,
    VehicleInfo,
    Window,
    WindowPlan,
    WindowStatus,
    read_only,
)
from istc_replay.export.result_mcap import Contents, result_bytes
from istc_replay.ingest.result import read_result, repeatable_summary
from istc_replay.states import (
    CERTIFICATES_SCHEMA,
    CORRIDORS_SCHEMA,
    FINDINGS_SCHEMA,
    OBSTACLES_SCHEMA,
    RESULT_STATES_SCHEMA,
    SOLVES_SCHEMA,
    STATES_SCHEMA,
)

Plan = tuple[Log, list[WindowPlan]]
S = 1_000_000_000
#: Columns of a state that say where its message stands in the file.
PLACES = ("topic", "message_index")


def write(log: Log, plans: list[WindowPlan] | None = None, **changes: Any) -> bytes:
    arguments: dict[str, Any] = {
        "certificates": [],
        "summary": {},
        "config_toml": "",
        "provenance": {},
        **changes,
    }
    return result_bytes(Contents(log, plans or [], **arguments))


def recorded_of(states: pl.DataFrame) -> pl.DataFrame:
    """The states table that a log of these states should come back as, but for the windows."""
    # Where a message stands is told of the result, not of the log.
    known = [n for n in RESULT_STATES_SCHEMA.names() if n in states.columns and n not in PLACES]
    return states.sort("vehicle_id", "time_ns", maintain_order=True).select(known)


def test_the_tables_have_their_schemas(synthetic_result: Result) -> None:
    result = synthetic_result
    assert result.states.schema == RESULT_STATES_SCHEMA
    assert result.corridors.schema == CORRIDORS_SCHEMA
    assert result.obstacles.schema == OBSTACLES_SCHEMA
    assert result.solves.schema == SOLVES_SCHEMA
    assert result.certificates.schema == CERTIFICATES_SCHEMA


def test_a_result_of_nothing_has_empty_tables_of_the_same_schemas(synthetic_plan: Plan) -> None:
    log = dataclasses.replace(synthetic_plan[0], states=pl.DataFrame(schema=STATES_SCHEMA))
    result = read_result(write(log))
    assert_frame_equal(result.states, pl.DataFrame(schema=RESULT_STATES_SCHEMA))
    assert_frame_equal(result.corridors, pl.DataFrame(schema=CORRIDORS_SCHEMA))
    assert_frame_equal(result.certificates, pl.DataFrame(schema=CERTIFICATES_SCHEMA))


_MAYBE = st.none() | st.floats(-1e6, 1e6)
_SIZES = st.tuples(st.floats(0.1, 30.0), st.floats(0.1, 5.0), _MAYBE, _MAYBE) | st.just((None,) * 4)

_ROLES, _BITS = st.sampled_from(["vehicle", "pedestrian"]), st.integers(0, 7)


@st.composite
def state_rows(draw: st.DrawFn) -> tuple[Any, ...]:
    vehicle = draw(st.sampled_from(["a", "b", "../x", "", "ü"]))
    time_ns = draw(st.integers(-(2**63), 2**63 - 1) | st.integers(0, 10))
    place = draw(st.tuples(st.floats(-1e7, 1e7), st.floats(-1e7, 1e7)))
    kinematics = draw(st.tuples(*[_MAYBE] * 6))
    return (vehicle, time_ns, 0, 0, *place, *kinematics, *draw(_SIZES), draw(_ROLES), "/t", 0, draw(_BITS))


@settings(max_examples=60, deadline=None)
@given(st.lists(state_rows(), max_size=12))
def test_recorded_states_come_back_exactly(rows: list[tuple[Any, ...]]) -> None:
    states = pl.DataFrame(rows, schema=STATES_SCHEMA, orient="row")
    log = Log("x", "0", True, 0, 0, 0, 0, None, None, (), states, StaticScene(), ())
    read = read_result(write(log)).states
    expected = recorded_of(states)
    assert_frame_equal(read.select(expected.columns), expected, check_exact=True)
    assert read["source"].to_list() == ["recorded"] * len(rows)
    assert read["window"].null_count() == len(rows)
    for _, own in read.group_by("topic"):
        assert sorted(own["message_index"]) == list(range(own.height))


_COORDINATE = st.floats(-1e6, 1e6)


@st.composite
def corridors(draw: st.DrawFn) -> WindowPlan:
    units = draw(st.integers(1, 4))
    unit_s = draw(st.sampled_from([0.25, 0.5, 1.0, 1.0 / 3.0]))
    start_ns = draw(st.integers(0, 2**61))
    frame = Frame(draw(_COORDINATE), draw(_COORDINATE), draw(st.floats(-3.2, 3.2)))
    window = Window(
        draw(st.integers(0, 2**31 - 1)), start_ns, start_ns + round(units * unit_s * S), unit_s, units, frame
    )
    found = []
    for name in draw(st.lists(st.text(max_size=5), unique=True, max_size=3)):
        first = draw(st.integers(0, units - 1))
        count = units - first
        cubes = draw(st.lists(st.tuples(*[_COORDINATE] * 4), min_size=count, max_size=count))
        points = draw(st.lists(st.tuples(*[_COORDINATE] * 4), min_size=count + 1, max_size=count + 1))
        ends = np.array(points)
        found.append(
            Corridor(name, first, read_only(cubes, 4), read_only(ends[:, :2], 2), read_only(ends[:, 2:], 2))
        )
    absent = st.just((np.nan,) * 4)
    boxes = st.lists(st.tuples(*[_COORDINATE] * 4) | absent, min_size=units, max_size=units)
    obstacles = [
        Obstacle(name, read_only(draw(boxes), 4))
        for name in draw(st.lists(st.text(max_size=5), unique=True, max_size=3))
    ]
    scenario = Scenario(window, (), tuple(obstacles), None)
    return WindowPlan(
        scenario, WindowStatus.NOT_DRIVABLE, corridors=Corridors(SolveStatus.FEASIBLE, tuple(found))
    )


@settings(max_examples=60, deadline=None)
@given(corridors())
def test_corridors_and_obstacles_come_back_exactly(plan: WindowPlan) -> None:
    empty = pl.DataFrame(schema=STATES_SCHEMA)
    log = Log("x", "0", True, 0, 0, 0, 0, None, None, (), empty, StaticScene(), ())
    assert plan.corridors is not None
    # Corridors are of vehicles that the log holds.
    names = [corridor.vehicle_id for corridor in plan.corridors.corridors]
    log = dataclasses.replace(log, states=_standing(names))
    result = read_result(write(log, [plan]))
    window = plan.scenario.window
    frame = (window.frame.yaw_rad, window.frame.x_m, window.frame.y_m)

    def span(k: int) -> tuple[int, int]:
        return tuple(window.start_ns + round(i * window.unit_s * S) for i in (k, k + 1))  # type: ignore[return-value]

    expected = [
        (window.index, c.vehicle_id, c.first_unit + i, *span(c.first_unit + i), *cube, *c.pivots_m[i],
         *c.pivots_m[i + 1], *c.references_m[i], *c.references_m[i + 1], *frame)
        for c in plan.corridors.corridors for i, cube in enumerate(c.cubes_m)
    ]  # fmt: skip
    assert result.corridors.rows() == expected
    assert result.obstacles.rows() == [
        (window.index, obstacle.obstacle_id, k, *span(k), *box, *frame)
        for obstacle in plan.scenario.obstacles
        for k, box in enumerate(obstacle.boxes_m)
        if not np.isnan(box).any()
    ]


def _standing(names: list[str]) -> pl.DataFrame:
    rows = [(name, 0, 0, 0, 0.0, 0.0, *[None] * 10, "vehicle", "/t", 0, 0) for name in names]
    return pl.DataFrame(rows, schema=STATES_SCHEMA, orient="row")


def test_certificates_come_back(synthetic_result: Result, synthetic_certificates: list[Certificate]) -> None:
    start_ns = synthetic_result.corridors["start_ns"].min()
    assert isinstance(start_ns, int)
    expected = [
        (
            c.window,
            c.check,
            c.verdict.value,
            c.margin,
            c.unit,
            None if c.time_s is None else start_ns + round(c.time_s * S),
            list(c.vehicles),
            c.detail,
        )
        for c in synthetic_certificates
    ]
    assert synthetic_result.certificates.rows() == expected


def test_solves_come_back_without_their_times(synthetic_result: Result, synthetic_plan: Plan) -> None:
    names = ["objective", "bound", "gap", "wall_s", "iterations", "nodes", "binaries"]
    assert synthetic_result.solves.select("vehicle_id", "stage", *names).rows() == [
        (r.vehicle_id, r.stage, *(None if name == "wall_s" else getattr(r, name) for name in names))
        for r in synthetic_plan[1][0].records
    ]


def test_the_scene_comes_back(synthetic_plan: Plan) -> None:
    log = synthetic_plan[0]
    left, middle, right = (read_only([[0.0, y], [9.0, y], [20.0, y + 1.0]]) for y in (2.0, 0.0, -2.0))
    scene = StaticScene(
        (
            *log.scene.lane_lines,
            LaneLine("empty", read_only([], 2)),
            LaneLine("a", middle, None, left, right),
        ),
        (SceneObstacle("o", 1.0, 2.0, 0.5, 3.0, 4.0),),
        MapBounds(-1.0, 1.0, -2.0, 2.0),
        (*log.scene.vehicles, VehicleInfo("silent")),
        (RoadEdge("kerb", right),),
        (RoadArea("junction", left),),
    )
    read = read_result(write(dataclasses.replace(log, scene=scene))).scene
    assert (read.obstacles, read.bounds, read.vehicles) == (scene.obstacles, scene.bounds, scene.vehicles)
    for one, two in zip(read.lane_lines, scene.lane_lines, strict=True):
        assert (one.lane_id, one.vehicle_id, one.points_m.tolist()) == (
            two.lane_id,
            two.vehicle_id,
            two.points_m.tolist(),
        )
    outline = np.vstack([left, left[:1]])
    assert [edge.tolist() for edge in read.edges_m] == [e.tolist() for e in (left, right, right, outline)]
    assert read.road_edges[0].edge_id == "kerb"


def test_guidance_comes_back_in_the_map_frame(synthetic_result: Result) -> None:
    # The fixture's guidance is its recording.
    columns = ["vehicle_id", "time_ns", "x_m", "y_m", "heading_rad"]
    states = synthetic_result.states
    guidance = states.filter(pl.col("source") == "guidance").select(columns)
    recorded = states.filter(pl.col("source") == "recorded").select(columns)
    assert_frame_equal(guidance, recorded, abs_tol=1e-9)


def test_config_and_summary_come_back(synthetic_result: Result, synthetic_summary: dict[str, Any]) -> None:
    assert synthetic_result.config_toml == "[window]\nunit_s = 1.0\n"
    assert synthetic_result.summary == repeatable_summary(synthetic_summary)
    assert "stages" not in synthetic_result.summary
    assert "seconds" not in synthetic_result.summary["windows"][0]["corridors"]


def test_states_are_sorted_by_source_window_vehicle_and_time(synthetic_result: Result) -> None:
    order = {"recorded": 0, "planned": 1, "guidance": 2}
    keys = [
        (order[source], vehicle, time)
        for source, vehicle, time in synthetic_result.states.select("source", "vehicle_id", "time_ns").rows()
    ]
    assert keys == sorted(keys)


def test_findings_come_back_exactly(synthetic_plan: Plan) -> None:
    pair, nan, inf = ["a", "b"], float("nan"), float("inf")
    rows = [
        (
            "f1",
            "ttc",
            "fail",
            "serious",
            pair,
            1,
            2,
            3,
            0.5,
            nan,
            1.4,
            "s",
            1.5,
            "SSAM",
            "/t",
            7,
            "e1",
            "why",
        ),
        ("f2", "drac", "fail", "critical", pair, 1, 2, 3, 0.5, 2.0, inf, "m/s^2", 6.0, "", "/t", 0, "e1", ""),
        (
            "f3",
            "data_gap",
            "inconclusive",
            None,
            ["ü"],
            5,
            5,
            9,
            -1.0,
            2.0,
            4.0,
            "s",
            0.3,
            "ours",
            "",
            0,
            None,
            "",
        ),
    ]
    findings = pl.DataFrame(rows, schema=FINDINGS_SCHEMA, orient="row")
    read = read_result(write(synthetic_plan[0], findings=findings)).findings
    assert_frame_equal(read.sort("finding_id"), findings, check_exact=True)


def window_plan(index: int, start_s: int, end_s: int) -> WindowPlan:
    window = Window(index, start_s * S, end_s * S, 1.0, end_s - start_s, Frame())
    return WindowPlan(Scenario(window, (), (), None), WindowStatus.NOTHING_TO_PLAN)


def test_a_recorded_state_belongs_to_the_latest_window_around_it() -> None:
    rows = [("a", t * S, 0, 0, 0.0, 0.0, *[None] * 10, "vehicle", "/t", 0, 0) for t in range(10)]
    states = pl.DataFrame(rows, schema=STATES_SCHEMA, orient="row")
    log = Log("x", "0", True, 0, 0, 0, 0, None, None, (), states, StaticScene(), ())
    # Two windows meet at 3 s; after 5 s there is none until 7 s.
    plans = [window_plan(0, 1, 3), window_plan(1, 3, 5), window_plan(2, 7, 8)]
    assert read_result(write(log, plans)).states["window"].to_list() == [
        None, 0, 0, 1, 1, 1, None, 2, 2, None,
    ]  # fmt: skip
