"""SUMO's floating car data and networks as logs, compared with what SUMO says."""

from __future__ import annotations

import gzip
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config
from istc_replay.errors import LogError, UsageError
from istc_replay.ingest.log import read_log
from istc_replay.pipeline.convert import Converted, convert_recording

DATA = Path(__file__).resolve().parents[1] / "data"
Convert = Callable[..., tuple[Converted, pl.DataFrame]]


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
