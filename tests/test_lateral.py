"""How far plans of recorded traffic go sideways: to the road's edge, else from the recorded path."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest
import shapely

from istc_replay.config import parse_config
from istc_replay.datatypes import LaneLine, Log, RoadEdge, StaticScene, Verdict, read_only
from istc_replay.geometry import box_corners
from istc_replay.lateral import PATH, RECORDING, ROAD, kinds, lateral, lateral_bound
from istc_replay.pipeline.assembly import Replay
from istc_replay.pipeline.replay import replay_read
from istc_replay.polyline import beside
from istc_replay.road import Road
from istc_replay.safety.certificate import certify

from .support.planning import FAST, map_motion, planned, replayed
from .support.tracks import driver, log_of

BOX = (4.5, 1.8)


def straight(name: str, left_m: float, right_m: float, last_m: float = 200.0) -> LaneLine:
    """A lane to the east between two lines."""
    line = np.array([[-50.0, 0.0], [60.0, 0.0], [last_m, 0.0]])
    sides = (read_only(beside(line, left_m)), read_only(beside(line, right_m)))
    return LaneLine(name, read_only(beside(line, (left_m + right_m) / 2.0)), None, *sides)


def road_log(tracks: Iterable[pl.DataFrame], *lanes: LaneLine, edges: tuple[RoadEdge, ...] = ()) -> Log:
    """A log of field data on a road."""
    return log_of(*tracks, scene=StaticScene(lanes, road_edges=edges))


#: A fast car that catches up with a slow one, which is 0.9 m to its right.
PRESSED = (driver("1", 0.0, 0.0, 13.0), driver("2", -0.9, 9.0, 10.0))


def boxes_of(done: Replay) -> dict[str, list[shapely.Polygon]]:
    """Planned boxes in the map frame, from the written states."""
    planned = done.result.states.filter(pl.col("source") == "planned")
    found = {}
    for (name,), rows in planned.partition_by("vehicle_id", as_dict=True).items():
        poses = rows.select("x_m", "y_m", "heading_rad").to_numpy()
        found[str(name)] = [shapely.Polygon(c) for c in box_corners(*poses.T, *BOX)]
    return found


def told(window: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What the summary tells of each vehicle's bound."""
    return {vehicle["id"]: vehicle["lateral"] for vehicle in window["vehicles"]}


def check_of(window: dict[str, Any]) -> dict[str, Any]:
    """The certificate's check of the bound."""
    found: dict[str, Any] = next(c for c in window["certificate"]["checks"] if c["check"] == "lateral")
    return found


def test_a_plan_pressed_against_the_edge_stays_on_the_road() -> None:
    # Without a road the fast car swerves farther than the road would let it.
    free, window = replayed(road_log(PRESSED))
    most = max(box.bounds[3] for box in boxes_of(free)["1"])
    assert window["status"] == "certified"
    assert told(window)["1"]["bounds"] == [PATH]
    edge = most - 0.25
    done, window = replayed(road_log(PRESSED, straight("1", edge, -4.0)))
    assert window["status"] == "certified"
    road = shapely.box(-60.0, -4.0, 210.0, edge)
    boxes = boxes_of(done)
    assert max(box.bounds[3] for box in boxes["1"]) > 0.9 + 0.05  # it does give way
    assert all(road.contains(box) for name in boxes for box in boxes[name])
    kept, check = told(window)["1"], check_of(window)
    assert (kept["bounds"], kept["bound"], kept["recorded_off_road_m"]) == ([ROAD], ROAD, 0.0)
    assert 0.0 <= kept["margin_m"] < 0.4
    assert check["verdict"] == "pass"
    assert check["margin"] == pytest.approx(
        min(each["margin_m"] for each in told(window).values()), abs=0.005
    )
    assert "on the road's side of its edge" in check["detail"]


def test_in_a_lane_without_room_beside_cars_give_way_by_speed_alone() -> None:
    done, window = replayed(road_log(PRESSED, straight("1", 1.05, -1.95)))
    assert window["status"] == "certified"
    assert max(kept["excursion_m"] for kept in told(window).values()) < 0.01
    road = shapely.box(-60.0, -1.95, 210.0, 1.05)
    assert all(road.contains(box) for boxes in boxes_of(done).values() for box in boxes)


def test_a_plan_too_near_to_the_edge_is_made_again_with_more_room() -> None:
    log = road_log(PRESSED, straight("1", 1.05, -3.0))
    _, window = replayed(log)
    assert (window["status"], window["rounds"]) == ("certified", 2)
    assert 0.0 < told(window)["1"]["margin_m"] < 0.1
    # With neither another round nor finer time units, who would leave the road stays as recorded, by name.
    never = parse_config('corridors.mode = "fast"\nwindow.unit_s = 0.25\ntrajectories.feedback_rounds = 0')
    _, window = replayed(log, never)
    frozen = {each["vehicle_id"]: each for each in window["frozen"]}
    assert frozen["1"]["reason"] == "off_the_road"
    assert "of the road's edge" in frozen["1"]["detail"]


def test_a_recording_off_the_road_has_a_named_fallback() -> None:
    # It cuts 0.6 m across the kerb between 10 and 30 m.
    times = np.arange(41) / 10.0
    swerve = 1.6 * np.exp(-(((12.0 * times - 24.0) / 10.0) ** 2))
    heading = np.arctan2(np.gradient(swerve, times), 12.0)
    swerving = driver("1", y_m=swerve, heading_rad=heading)
    _, window = replayed(road_log((swerving, driver("2", -4.0, 3.0)), straight("a", 1.9, -6.0)))
    assert window["status"] == "certified"
    one, two = told(window)["1"], told(window)["2"]
    assert (one["bounds"], two["bounds"]) == ([ROAD, RECORDING], [ROAD])
    assert one["recorded_off_road_m"] == pytest.approx(0.6, abs=0.1)
    assert two["recorded_off_road_m"] == 0.0
    assert window["vehicles_certified"] == 2


def test_where_the_road_is_not_told_the_path_bounds() -> None:
    _, window = replayed(road_log((driver("1"), driver("2", 3.5, 4.0)), straight("a", 2.0, -2.0, 61.0)))
    assert told(window)["1"]["bounds"] == [ROAD]
    assert told(window)["2"]["bounds"] == [PATH]
    _, window = replayed(road_log((driver("1", seconds=6.0),), straight("a", 2.0, -2.0, 61.0)))
    assert told(window)["1"]["bounds"] == [ROAD, PATH]


def test_an_edge_alone_bounds_its_own_side() -> None:
    kerb = RoadEdge("kerb", read_only([[-50.0, 1.3], [200.0, 1.3]]))
    path = np.column_stack([np.arange(20.0), np.zeros((20, 2))])
    road = Road.of(StaticScene(road_edges=(kerb,)))
    bound = lateral_bound(path, BOX, road, 1.5)
    assert kinds(bound) == (ROAD, PATH)

    def margin(y: float) -> tuple[float, str]:
        kept = lateral("1", bound, path + [0.0, y, 0.0], BOX)
        return kept.margin_m, kept.bound

    assert margin(0.1) == (pytest.approx(0.3), ROAD)
    assert margin(-1.4) == (pytest.approx(0.1), PATH)
    assert margin(1.0) == (pytest.approx(-0.6), ROAD)
    turned = lateral("1", bound, path + [0.0, 0.0, 0.2], BOX)  # its corner is nearer than its side
    corner = 0.9 * np.cos(0.2) + 2.25 * np.sin(0.2)
    assert turned.margin_m == pytest.approx(1.3 - corner)


@pytest.mark.parametrize(("angle_deg", "shift_m"), [(37.0, (4e3, -9e3)), (-121.0, (1e6, 5e6))])
def test_a_turned_and_shifted_log_with_its_lanes_has_the_same_plan(
    angle_deg: float, shift_m: tuple[float, float]
) -> None:
    kerb = RoadEdge("kerb", read_only([[-50.0, -2.6], [200.0, -2.6]]))
    log = road_log(PRESSED, straight("a", 1.75, -4.0), edges=(kerb,))
    angle, shift = np.radians(angle_deg), np.array(shift_m)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])

    def moved(points: np.ndarray | None) -> Any:
        return None if points is None else read_only(points @ turn.T + shift)

    x, y = pl.col("x_m"), pl.col("y_m")
    states = log.states.with_columns(
        x_m=c * x - s * y + shift[0], y_m=s * x + c * y + shift[1], heading_rad=pl.col("heading_rad") + angle
    )
    lanes = tuple(
        replace(each, points_m=moved(each.points_m), left_m=moved(each.left_m), right_m=moved(each.right_m))
        for each in log.scene.lane_lines
    )
    edges = tuple(replace(edge, points_m=moved(edge.points_m)) for edge in log.scene.road_edges)
    other = replace(log, states=states, scene=StaticScene(lanes, road_edges=edges))
    plans = [planned(each) for each in (log, other)]
    motions = [map_motion(plan) for plan in plans]
    assert motions[0].keys() == motions[1].keys() == {"1", "2"}
    for name, motion in motions[0].items():
        np.testing.assert_allclose(motions[1][name], motion @ turn.T + shift, atol=0.02)
    for one, two in zip(plans[0].lateral, plans[1].lateral, strict=True):
        assert (one.bounds, one.bound) == (two.bounds, two.bound)
        assert one.margin_m == pytest.approx(two.margin_m, abs=0.01)


def test_the_certificate_refuses_a_plan_across_the_edge() -> None:
    done, window = replayed(road_log((driver("1"), driver("2", 8.0)), straight("a", 1.2, -6.0)))
    assert check_of(window)["verdict"] == "pass"
    assert check_of(window)["margin"] == pytest.approx(0.3, abs=0.03)
    planned = pl.col("source") == "planned"
    states = done.result.states.with_columns(
        y_m=pl.when(planned & (pl.col("vehicle_id") == "1"))
        .then(pl.col("y_m") + 0.4)
        .otherwise(pl.col("y_m"))
    )
    judged = certify(replace(done.result, states=states), FAST)
    (check,) = (each for each in judged if each.check == "lateral")
    assert (check.verdict, check.vehicles) == (Verdict.FAIL, ("1",))
    assert check.margin == pytest.approx(-0.1, abs=0.03)
    # Off the road altogether, and where nobody was recorded.
    for column, value, verdict in (("y_m", 30.0, Verdict.FAIL), ("vehicle_id", None, Verdict.INCONCLUSIVE)):
        rows = planned if column == "y_m" else ~planned
        lost = done.result.states.with_columns(
            pl.when(rows & (pl.col("vehicle_id") == "1"))
            .then(pl.lit(value))
            .otherwise(pl.col(column))
            .alias(column)
        )
        judged = certify(replace(done.result, states=lost), FAST)
        assert next(each for each in judged if each.check == "lateral").verdict is verdict


def test_a_handed_over_plan_is_measured_from_the_recorded_path() -> None:
    # The faster car swerves in the first window, and starts beside its recorded path in the second.
    config = parse_config(
        'corridors.mode = "fast"\n'
        'window = { horizon_s = 3.0, stride_s = 3.0, unit_s = 0.5, start = "handed_over" }'
    )
    pair = driver("1", seconds=6.0), driver("2", -1.7, 11.0, 10.6, 5.9)
    done = replay_read(road_log(pair, straight("a", 3.0, -4.0)), config)
    first, second = done.summary["windows"]
    assert second["vehicles"][0]["start"] == "handed_over"
    planned = done.result.states.filter((pl.col("source") == "planned") & (pl.col("vehicle_id") == "1"))
    for window in (first, second):
        own = planned.filter(pl.col("window") == window["index"])
        away = float(own["y_m"].abs().max())  # type: ignore[arg-type]
        assert told(window)["1"]["excursion_m"] == pytest.approx(away, abs=0.03)
        assert check_of(window)["verdict"] == "pass"
    start = float(planned.filter(pl.col("window") == 1).sort("time_ns")["y_m"][0])
    assert start > 0.2
    assert told(second)["1"]["excursion_m"] >= start - 0.03


def test_the_path_bounds_all_along_a_box_that_was_recorded_at_the_edge_and_no_farther() -> None:
    # A kerb that comes near at x = 20 m alone: a box 4.5 m long is beside it from 17.75 to 22.25 m.
    kerb = RoadEdge("kerb", read_only([[-90.0, 3.0], [19.0, 3.0], [20.0, 0.95], [21.0, 3.0], [190.0, 3.0]]))
    poses = np.column_stack([np.arange(41.0), np.zeros((41, 2))])
    bound = lateral_bound(poses, BOX, Road.of(StaticScene(road_edges=(kerb,))), 1.5)
    by_path = np.flatnonzero(np.isnan(bound.edge_m[:, 0]))
    assert by_path.tolist() == list(range(17, 24))
    assert bound.offset_m[by_path, 0].tolist() == [0.5] * 7
    assert np.isnan(np.delete(bound.offset_m[:, 0], by_path)).all()
    assert bound.edge_m[25:30, 0].tolist() == [3.0] * 5
    assert np.isnan(bound.edge_m[:, 1]).all()  # nothing is told of the other side
    assert bound.off_road_m == 0.0
