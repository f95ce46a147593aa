"""Conversions: other tools' files as logs, read back and compared with what those tools say."""

from __future__ import annotations

import gzip
import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config, parse_config
from istc_replay.errors import LogError, UsageError
from istc_replay.ingest.log import read_log
from istc_replay.pipeline.convert import Converted, convert_recording
from istc_replay.pipeline.tables import export_tables
from istc_replay.states import STATES_SCHEMA

DATA = Path(__file__).resolve().parents[1] / "data"
SAMPLES = Path(__file__).resolve().parents[2] / "sample_logs"
Convert = Callable[..., tuple[Converted, pl.DataFrame]]


@pytest.fixture
def convert(tmp_path: Path) -> Convert:
    """Convert a file, or a text under this name, and read the log."""

    def run(
        source: Path | str, text: str | bytes = "", config: str = "", types: tuple[Path, ...] = ()
    ) -> tuple[Converted, pl.DataFrame]:
        path = source if isinstance(source, Path) else tmp_path / source
        if not isinstance(source, Path):
            path.write_bytes(text.encode() if isinstance(text, str) else text)
        out = tmp_path / "out.mcap"
        done = convert_recording(path, out, parse_config(config), types)
        return done, read_log(out).states

    return run


# --- SUMO ----------------------------------------------------------------------------------------

#: What SUMO 1.28 says of the types in sumo_types.rou.xml (libsumo's getLength and getWidth).
SIZES = {
    "car": (3.6, 1.6),
    "lorry.0": (7.1, 2.4),
    "plain": (5.0, 1.8),
    "bike": (1.6, 0.65),
    "walker": (0.215, 0.478),
}


def test_floating_car_data_becomes_box_centres_and_headings(convert: Convert) -> None:
    done, states = convert(DATA / "sumo_fcd.xml", types=(DATA / "sumo_types.rou.xml",))
    assert done.complete
    assert done.problems == ()
    rows = [
        (round(float(step.get("time", "")) * 1e9), road_user.attrib)
        for step in ET.parse(DATA / "sumo_fcd.xml").getroot()  # noqa: S314
        for road_user in step
    ]
    assert states.height == len(rows) > 80
    found = {(row["vehicle_id"], row["time_ns"]): row for row in states.to_dicts()}
    for time_ns, told in rows:
        row = found[(told["id"], time_ns)]
        length, width = SIZES[told["id"]]
        assert (row["length_m"], row["width_m"]) == (length, width)
        # North is +y, and angles go clockwise from it: the front is at (sin, cos).
        angle = math.radians(float(told["angle"]))
        front = row["x_m"] + length / 2 * math.sin(angle), row["y_m"] + length / 2 * math.cos(angle)
        assert front == pytest.approx((float(told["x"]), float(told["y"])), abs=1e-9)
        assert math.cos(row["heading_rad"]) == pytest.approx(math.sin(angle), abs=1e-9)
        assert math.sin(row["heading_rad"]) == pytest.approx(math.cos(angle), abs=1e-9)
        assert row["speed_mps"] == float(told["speed"])
        if "acceleration" in told:
            assert row["acceleration_mps2"] == float(told["acceleration"])
    roles = dict(states.select("vehicle_id", "role").iter_rows())
    assert (roles["car"], roles["bike"], roles["walker"]) == ("vehicle", "bicycle", "pedestrian")


def test_a_type_that_is_not_declared_is_a_car_and_told(convert: Convert) -> None:
    done, states = convert(DATA / "sumo_fcd.xml")
    assert {p.code for p in done.problems} == {"size_assumed"}
    assert "--types" in done.problems[0].detail
    assert states.filter(vehicle_id="lorry.0")["length_m"].unique().to_list() == [5.0]


def test_packed_and_cut_files_are_read_as_far_as_they_go(convert: Convert) -> None:
    data = (DATA / "sumo_fcd.xml").read_bytes()
    whole, states = convert("fcd.xml.gz", gzip.compress(data))
    assert states.equals(convert(DATA / "sumo_fcd.xml")[1])
    cut, part = convert("cut.xml", data[: len(data) // 2])
    assert not cut.complete
    assert 10 < part.height < states.height
    assert "line " in next(p.detail for p in cut.problems if p.code == "truncated")
    packed, part = convert("cut.xml.gz", gzip.compress(data, 1)[:-200])
    assert not packed.complete
    assert whole.complete


def test_positions_in_degrees_become_metres(convert: Convert) -> None:
    text = """<!-- <fcd-output.geo value="true"/> --><fcd-export>
      <timestep time="0"><vehicle id="a" x="11.5" y="48.1" angle="0" speed="1"/></timestep>
      <timestep time="1"><vehicle id="a" x="11.5" y="48.1001" angle="0" speed="1"/></timestep></fcd-export>"""
    done, states = convert("geo.xml", text)
    # A ten-thousandth of a degree of latitude is 11.12 m at 48 degrees.
    assert states["y_m"][1] - states["y_m"][0] == pytest.approx(11.12, abs=0.01)
    assert "local_origin" in {p.code for p in done.problems}


def test_bad_values_are_left_out_by_line(convert: Convert) -> None:
    text = (
        '<fcd-export>\n<timestep time="0">\n'
        '<vehicle id="a" x="1" y="2" angle="90" speed="3"/>\n'
        '<vehicle id="b" x="?" y="2" angle="90"/>\n'
        '<vehicle id="" x="1" y="2" angle="90"/>\n'
        '<vehicle id="c" x="1" y="nan" angle="90"/>\n'
        '</timestep>\n<timestep time="soon">\n<vehicle id="a" x="1" y="2" angle="0"/></timestep></fcd-export>'
    )
    done, states = convert("bad.xml", text)
    assert states["vehicle_id"].to_list() == ["a"]
    assert not done.complete
    lines = [p.detail.split(":")[0] for p in done.problems if p.code == "bad_value"]
    assert lines == ["line 4", "line 5", "line 6", "line 8"]


NET = """<net version="1.20"><edge id=":J_0" function="internal">
<lane id=":J_0_0" index="0" speed="9" length="9" shape="100.00,0.00 105.00,0.00 110.00,4.00"/></edge>
<edge id="E" from="A" to="J">
<lane id="E_0" index="0" disallow="all" speed="9" length="9" shape="0,-6 100,-6"/>
<lane id="E_1" index="1" allow="pedestrian" speed="9" length="9" width="2" shape="0,-3 100,-3"/>
<lane id="E_2" index="2" disallow="tram rail" speed="9" length="9" width="4" shape="0,0,1 50,0,1 50,0 100,0"/>
{more}</edge>
<junction id="J" x="0" y="0" shape="100,-5 120,-5 120,8"/><junction id="dead" x="0" y="0" shape="0,2 0,-2"/>
<edge id=":w" function="walkingarea"><lane id=":w_0" speed="1" length="1" shape="0,0 1,0"/></edge></net>"""


def test_the_lanes_of_a_network_go_into_the_log(convert: Convert, tmp_path: Path) -> None:
    net = tmp_path / "net.xml"
    net.write_text(NET.format(more=""))
    out = tmp_path / "net.mcap"
    done = convert_recording(DATA / "sumo_fcd.xml", out, Config(), [DATA / "sumo_types.rou.xml"], net=net)
    assert (done.lanes, done.complete) == (2, True)
    scene = read_log(out).scene
    (junction,) = scene.road_areas
    assert junction.points_m.tolist() == [[100.0, -5.0], [120.0, -5.0], [120.0, 8.0]]
    lanes = {line.lane_id: line for line in scene.lane_lines}
    assert lanes.keys() == {":J_0_0", "E_2"}
    assert lanes["E_2"].points_m.tolist() == [[0.0, 0.0], [50.0, 0.0], [100.0, 0.0]]
    for side, points in ((2.0, lanes["E_2"].left_m), (-2.0, lanes["E_2"].right_m)):
        np.testing.assert_allclose(points, lanes["E_2"].points_m + [0.0, side])
    assert lanes[":J_0_0"].left_m is not None
    np.testing.assert_allclose(lanes[":J_0_0"].left_m[0], [100.0, 1.6])
    for bad in ("shape='0,0'", "shape='0,0 x,1'", "shape='0,0 1,1' width='0'", "shape='0 1,1'", ""):
        net.write_text(NET.format(more=f'<lane id="bad" {bad}/>'))
        done = convert_recording(DATA / "sumo_fcd.xml", out, Config(), [DATA / "sumo_types.rou.xml"], net=net)
        assert not done.complete
        (told,) = (p.detail for p in done.problems)
        assert told.startswith("line 7: lane 'bad' is left out: ")


def test_a_network_that_does_not_fit_is_refused(convert: Convert, tmp_path: Path) -> None:
    net, out = tmp_path / "net.xml", tmp_path / "net.mcap"
    for text, part in (
        (NET.format(more="")[:300], "net.xml: line 5, column 1: unclosed token"),
        ("<routes/>", "give a SUMO network"),
        ("<net/>", "no lane on which cars drive"),
    ):
        net.write_text(text)
        with pytest.raises(LogError, match=part):
            convert_recording(DATA / "sumo_fcd.xml", out, Config(), net=net)
        assert not out.exists()
    with pytest.raises(UsageError, match="--net goes with SUMO's FCD"):
        convert_recording(DATA / "commonroad_merge.xml", out, Config(), net=net)
    net.write_text(NET.format(more=""))
    geo = tmp_path / "geo.xml"
    geo.write_text('<!-- <fcd-output.geo value="true"/> --><fcd-export/>')
    with pytest.raises(LogError, match="are degrees"):
        convert_recording(geo, out, Config(), net=net)


# --- CommonRoad ----------------------------------------------------------------------------------


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


# --- XML that means harm -------------------------------------------------------------------------

LAUGHS = "<!DOCTYPE x [<!ENTITY a 'ha'><!ENTITY b '&a;&a;&a;&a;&a;&a;&a;&a;'>]>"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (LAUGHS + '<fcd-export><timestep time="0"/></fcd-export>', "entities"),
        ("<!DOCTYPE x SYSTEM 'file:///etc/passwd'><fcd-export>&x;</fcd-export>", "fcd|undefined"),
        ("<fcd-export>" + "<a>" * 200 + "</a>" * 200 + "</fcd-export>", "within each other"),
        ("<fcd-export><timestep time='0'>" + "x" * 3_000_000 + "</timestep></fcd-export>", "characters"),
        ("<fcd-export a='" + "x" * 9_000_000 + "'/>", "tag or comment"),
        ("<fcd-export/>", "no vehicle's state"),
        ("<commonRoad timeStepSize='0'/>", "timeStepSize is '0'"),
        ("<commonRoad timeStepSize='1'/>", "no recorded state"),
        ("<html/>", "'html'"),
        ("no XML", "no XML"),
        ("", "no XML"),
    ],
)
def test_xml_that_cannot_be_meant_is_refused_in_a_line(
    text: str, told: str, convert: Convert, tmp_path: Path
) -> None:
    with pytest.raises(LogError, match=told):
        convert("a.xml", text)
    assert not (tmp_path / "out.mcap").exists()


def test_a_packed_bomb_is_not_inflated(convert: Convert) -> None:
    bomb = gzip.compress(b"<fcd-export>" + (b"<!--" + b" " * 1_000_000 + b"-->") * 60, 9)
    assert len(bomb) < 100_000
    with pytest.raises(LogError, match="inflates to more"):
        convert("bomb.xml.gz", bomb)


# --- tables --------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_an_exported_table_comes_back_as_it_was(kind: str, convert: Convert, tmp_path: Path) -> None:
    source = SAMPLES / "intersection_odometry.mcap"
    export_tables(source, tmp_path, [kind], Config())  # type: ignore[list-item]
    done, states = convert(tmp_path / f"states.{kind}")
    assert done.complete
    known = [
        name for name in STATES_SCHEMA if name.endswith(("_m", "_rad", "_mps", "_mps2")) or name == "time_ns"
    ]
    before = read_log(source).states.sort("vehicle_id", "time_ns")
    assert states.select("vehicle_id", *known).equals(before.select("vehicle_id", *known))


def test_the_state_table_with_all_its_columns_is_read(convert: Convert, tmp_path: Path) -> None:
    before = read_log(SAMPLES / "intersection_osi.mcap").states
    path = tmp_path / "states.parquet"
    before.write_parquet(path)
    _, states = convert(path)
    same = ("vehicle_id", "time_ns", "x_m", "y_m", "heading_rad", "speed_mps", "length_m", "role")
    assert states.select(same).equals(before.select(same))


def test_other_names_units_and_separators_are_understood(convert: Convert) -> None:
    text = (
        "track_id;frame;timestamp_ms;agent_type;x;y;vx;vy;psi_rad;length;width\n"
        "1;1;100;car;1.5;2.5;3;4;0.9272952180016122;4.5;1.8\n"
        "1;2;200;car;1.8;2.9;3;4;0.9272952180016122;4.5;1.8\n"
        "P2;1;100;pedestrian/bicycle;9;9;0;0;;;\n"
    )
    done, states = convert("tracks.csv", "\ufeff" + text)
    assert done.complete
    assert states["time_ns"].to_list() == [100_000_000, 200_000_000, 100_000_000]
    assert states["speed_mps"][0] == pytest.approx(5.0)
    assert states["heading_rad"][2] is None
    assert states.filter(vehicle_id="1")["length_m"].to_list() == [4.5, 4.5]
    assert any("x_m from 'x'" in note for note in done.notes)


def test_columns_can_be_named_in_the_configuration(convert: Convert) -> None:
    text = "who,when,east,north,kurs\nA,1700000000.25,10,20,90\n"
    config = (
        '[ingest.columns]\nvehicle_id = "who"\ntime_s = "when"\n'
        'x_m = "east"\ny_m = "north"\nheading_deg = "kurs"\n'
    )
    _, states = convert("t.csv", text, config)
    assert states["time_ns"].to_list() == [1_700_000_000_250_000_000]
    assert states["heading_rad"][0] == pytest.approx(math.pi / 2)
    with pytest.raises(
        LogError, match="no column tells vehicle_id, x_m, y_m, time_ns or time_s; it has 'who'"
    ):
        convert("t.csv", text)
    with pytest.raises(LogError, match=r"ingest.columns names 'nord'"):
        convert("t.csv", text, config.replace('"north"', '"nord"'))


@pytest.mark.parametrize(
    ("times", "expected_ns"),
    [
        (["0.1", "0.2"], [100_000_000, 200_000_000]),
        (["1700000000.5", "1700000001"], [1_700_000_000_500_000_000, 1_700_000_001_000_000_000]),
        (["1700000000500", "1700000000600"], [1_700_000_000_500_000_000, 1_700_000_000_600_000_000]),
        (
            ["1700000000500000123", "1700000000500000124"],
            [1_700_000_000_500_000_123, 1_700_000_000_500_000_124],
        ),
    ],
)
def test_times_without_a_unit_are_told_by_their_size(
    times: list[str], expected_ns: list[int], convert: Convert
) -> None:
    rows = "".join(f"a,{time},0,0\n" for time in times)
    done, states = convert("t.csv", "id,timestamp,x,y\n" + rows)
    assert states["time_ns"].to_list() == expected_ns
    assert {p.code for p in done.problems} == {"unit_assumed"}


def test_bad_cells_are_left_out_by_line_and_column(convert: Convert) -> None:
    text = (
        "vehicle_id,time_s,x_m,y_m,length_m\n"
        "a,0,0,0,4\n"
        "a,1,zero,0,4\n"  # line 3
        "a,-1,0,0,4\n"
        "a,2,0\n"
        '"a\nb",3,0,inf,4\n'  # lines 6 and 7
        ",4,0,0,4\n"
        "a,6,,0,4\n"
        "a,7,7,7,\n"
    )
    done, states = convert("t.csv", text)
    assert states["x_m"].to_list() == [0.0, 7.0]
    assert not done.complete
    details = sorted(p.detail for p in done.problems if p.code != "bad_row")
    assert details[-1].startswith("line 9: time, x or y is empty")
    assert "line 3, column 'x_m': 'zero' is not a finite number" in details[0]
    assert "line 4, column 'time_s': '-1' is no time" in details[1]
    assert "line 7, column 'y_m': 'inf' is not a finite number" in details[2]
    assert "line 8, column 'vehicle_id'" in details[3]
    assert [p.detail for p in done.problems if p.code == "bad_row"] == [
        "line 5: 3 fields where the header has 5; left out"
    ]


@pytest.mark.parametrize("name", ["t.csv", "t.tsv", "t.parquet"])
@pytest.mark.parametrize(
    "data", [b"", b"\x00" * 100, b"\xff\xfe" * 50, b'"' * 5000, b"PAR1" + b"x" * 40 + b"PAR1"]
)
def test_what_is_no_table_is_refused_in_a_line(name: str, data: bytes, convert: Convert) -> None:
    with pytest.raises(LogError) as error:
        convert(name, data)
    assert "\n" not in str(error.value)


def test_types_go_with_sumo_alone_and_the_source_is_safe(convert: Convert, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--types goes with"):
        convert(DATA / "commonroad_merge.xml", types=(DATA / "sumo_types.rou.xml",))
    path = tmp_path / "t.csv"
    path.write_text("id,time_s,x,y\na,0,1,2\n")
    with pytest.raises(UsageError, match="is the input"):
        convert_recording(path, path, Config())
    with pytest.raises(LogError, match="no such file"):
        convert_recording(tmp_path / "none.csv", tmp_path / "out.mcap", Config())


def test_half_a_million_rows_are_read_in_pieces(convert: Convert) -> None:
    count = 120_000
    table = pl.DataFrame({"id": np.arange(count) % 7, "time_s": np.arange(count) / 100, "x": 1.0, "y": 2.0})
    done, states = convert("t.csv", table.write_csv())
    assert states.height == done.states == count
    assert done.vehicles == 7
