"""CommonRoad scenarios as logs, compared with what its own reader says."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from istc_replay.errors import LogError
from istc_replay.ingest.log import read_log
from istc_replay.pipeline.convert import Converted

DATA = Path(__file__).resolve().parents[1] / "data"
Convert = Callable[..., tuple[Converted, pl.DataFrame]]


def test_a_scenario_is_read_as_commonroad_io_reads_it(convert: Convert, tmp_path: Path) -> None:
    done, states = convert(DATA / "commonroad_merge.xml")
    truth = json.loads((DATA / "commonroad_merge.json").read_text())
    assert states.height == len(truth) == 35
    found = {(row["vehicle_id"], row["time_ns"]): row for row in states.to_dicts()}
    for vehicle, step, x, y, heading, speed in truth:
        row = found[(vehicle, step * 100_000_000)]
        told = (row["x_m"], row["y_m"], row["heading_rad"], row["speed_mps"])
        assert told == pytest.approx((x, y, heading, speed), abs=1e-9)
    sizes = dict(states.select("vehicle_id", pl.concat_list("length_m", "width_m")).iter_rows())
    assert sizes == {"101": [4.5, 1.8], "102": [9.0, 2.5], "103": [0.6, 0.6], "104": [2.0, 0.6]}
    roles = dict(states.select("vehicle_id", "role").iter_rows())
    assert roles == {"101": "vehicle", "102": "vehicle", "103": "pedestrian", "104": "bicycle"}
    (standing,) = read_log(tmp_path / "out.mcap").scene.obstacles
    assert (standing.obstacle_id, standing.x_m, standing.y_m, standing.heading_rad) == ("201", 20.0, 6.0, 0.3)
    assert done.complete
    assert done.lanes == 1
    assert any("1 planningProblem" in note for note in done.notes)


def test_lanelets_become_lanes_with_their_edges(convert: Convert, tmp_path: Path) -> None:
    # The two roads of another reader: Python's own XML tree.
    def lanelet(
        number: int, left: list[tuple[float, float]], right: list[tuple[float, float]], kind: str
    ) -> str:
        sides = "".join(
            f"<{name}>{''.join(f'<point><x>{x}</x><y>{y}</y></point>' for x, y in side)}</{name}>"
            for name, side in (("leftBound", left), ("rightBound", right))
        )
        stop = "<stopLine><point><x>1</x><y>1</y></point></stopLine>"
        return f'<lanelet id="{number}">{sides}{stop}<laneletType>{kind}</laneletType></lanelet>'

    bend = [(4.0 * np.cos(a) + 500000.25, 4.0 * np.sin(a) - 7e6) for a in np.linspace(0.0, 1.0, 6)]
    wide = [(7.5 * np.cos(a) + 500000.25, 7.5 * np.sin(a) - 7e6) for a in np.linspace(0.0, 1.0, 6)]
    lanes = [
        lanelet(11, bend, wide, "urban"),
        lanelet(12, [(0.0, 3.0), (50.0, 3.0)], [(0.0, 0.0), (20.0, 0.0), (50.0, 1.0)], "highway"),
        lanelet(13, [(0.0, 9.0), (50.0, 9.0)], [(0.0, 8.0), (50.0, 8.0)], "sidewalk"),
        lanelet(14, [(0.0, 9.0)], [(0.0, 8.0), (50.0, 8.0)], "urban"),
        lanelet(15, [(0.0, float("nan")), (1.0, 0.0)], [(0.0, 8.0), (50.0, 8.0)], "urban"),
    ]
    text = (DATA / "commonroad_merge.xml").read_text()
    text = text.replace("<staticObstacle", "\n".join(lanes) + "<staticObstacle", 1)
    done, _ = convert("roads.xml", text)
    found = {line.lane_id: line for line in read_log(tmp_path / "out.mcap").scene.lane_lines}
    told = {each.get("id"): each for each in ET.fromstring(text).iter("lanelet")}  # noqa: S314
    assert found.keys() == {"1", "11", "12"} < told.keys()
    for name, line in found.items():
        for side, points in (("leftBound", line.left_m), ("rightBound", line.right_m)):
            places = told[name].findall(f"{side}/point")
            raw = [(float(p.findtext("x", "")), float(p.findtext("y", ""))) for p in places]
            np.testing.assert_array_equal(points, raw)
    middle = (np.array(bend) + np.array(wide)) / 2.0
    np.testing.assert_allclose(found["11"].points_m, middle, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found["12"].points_m[[0, -1]], [[0.0, 1.5], [50.0, 2.0]], atol=1e-9)
    assert any("1 lanelets on which no car drives" in note for note in done.notes)
    damaged = [p.detail for p in done.problems if p.code == "bad_value"]
    assert [name in detail for name, detail in zip(("'14'", "'15'"), damaged, strict=True)] == [True, True]
    assert not done.complete


OBSTACLE = """<commonRoad timeStepSize="0.5">{head}<{kind} id="7">{role}<type>car</type>
<shape><rectangle><length>{length}</length><width>2</width>{center}</rectangle></shape>
<initialState><time><exact>0</exact></time><position><point><x>1</x><y>2</y></point></position>
<orientation><intervalStart>1.5</intervalStart><intervalEnd>1.6415926535897931</intervalEnd></orientation>
<velocity><exact>3</exact></velocity></initialState>
<trajectory><state><position><point><x>1</x><y>{y}</y></point></position>
<time><exact>1</exact></time></state></trajectory></{kind}></commonRoad>"""


def scenario(**values: str) -> str:
    plain = {"head": "", "kind": "dynamicObstacle", "role": "", "length": "4", "center": "", "y": "3.5"}
    return OBSTACLE.format(**{**plain, **values})


def test_old_scenarios_and_intervals_are_read(convert: Convert) -> None:
    _, states = convert("a.xml", scenario(kind="obstacle", role="<role>dynamic</role>"))
    assert states["time_ns"].to_list() == [0, 500_000_000]
    assert states["heading_rad"][0] == pytest.approx(math.pi / 2)
    center = "<orientation>0</orientation><center><x>1</x><y>0</y></center>"
    # Turned to the left: a metre before the point is a metre further in y. The other state has no heading.
    done, states = convert("b.xml", scenario(center=center))
    assert (states["x_m"][0], states["y_m"][0]) == pytest.approx((1.0, 3.0), abs=1e-9)
    assert states.height == 1
    assert "no orientation" in done.problems[-1].detail


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"length": "-4"}, r"line 2: length is '-4'; it must be above 0"),
        ({"length": "long"}, "line 2: length is 'long', not a number"),
    ],
)
def test_a_bad_obstacle_is_named_by_its_line(values: dict[str, str], told: str, convert: Convert) -> None:
    with pytest.raises(LogError, match=told):
        convert("a.xml", scenario(**values))


def test_a_bad_state_leaves_the_others(convert: Convert) -> None:
    done, states = convert("a.xml", scenario(y="far"))
    assert states.height == 1
    assert not done.complete
    assert "line 6: y is 'far', not a number" in done.problems[-1].detail
