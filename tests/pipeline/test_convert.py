"""Conversions of what means harm or does not belong together."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import polars as pl
import pytest

from istc_replay.config import Config
from istc_replay.errors import LogError, UsageError
from istc_replay.pipeline.convert import Converted, convert_recording

DATA = Path(__file__).resolve().parents[1] / "data"
Convert = Callable[..., tuple[Converted, pl.DataFrame]]


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


def test_types_go_with_sumo_alone_and_the_source_is_safe(convert: Convert, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--types goes with"):
        convert(DATA / "commonroad_merge.xml", types=(DATA / "sumo_types.rou.xml",))
    path = tmp_path / "t.csv"
    path.write_text("id,time_s,x,y\na,0,1,2\n")
    with pytest.raises(UsageError, match="is the input"):
        convert_recording(path, path, Config())
    with pytest.raises(LogError, match="no such file"):
        convert_recording(tmp_path / "none.csv", tmp_path / "out.mcap", Config())
