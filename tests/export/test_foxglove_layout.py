"""The layout for Foxglove and Lichtblick: every topic and every field in it is in a real result."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from istc_replay.config import parse_config
from istc_replay.datatypes import Result
from istc_replay.export.foxglove_layout import foxglove_layout
from istc_replay.pipeline.assembly import Replay
from istc_replay.pipeline.replay import replay_log

ROOT = Path(__file__).resolve().parents[2]
PATH = re.compile(r'("[^"]+"|[A-Za-z0-9_/]+)\.(\w+)')
#: What draws each schema in the panels used.
PANELS = {"3D": {"foxglove.SceneUpdate", "foxglove.PosesInFrame"}, "RosOut": {"foxglove.Log"}}


@pytest.fixture(scope="module")
def replayed() -> Replay:
    """The replay that the layout in docs was made for, without the proof."""
    log = ROOT / "sample_logs" / "intersection_turn_first.mcap"
    return replay_log(log, parse_config('[corridors]\nmode = "fast"\n'))


@pytest.fixture(scope="module")
def topics(replayed: Replay) -> dict[str, Any]:
    """One decoded message by topic, and its schema's name."""
    reader = make_reader(BytesIO(replayed.mcap), decoder_factories=[DecoderFactory()])
    return {
        channel.topic: (schema.name, message)
        for schema, channel, _, message in reader.iter_decoded_messages()
    }


@pytest.fixture(scope="module")
def documented() -> dict[str, Any]:
    """The layout in docs."""
    layout: dict[str, Any] = json.loads((ROOT / "docs" / "foxglove-layout.json").read_text())
    return layout


def panels(layout: dict[str, Any]) -> Iterator[str]:
    """Panels that the layout places, those in tabs too."""

    def placed(part: Any) -> Iterator[str]:
        if isinstance(part, str):
            yield part
            for tab in layout["configById"][part].get("tabs", ()):
                yield from placed(tab["layout"])
        else:
            yield from placed(part["first"])
            yield from placed(part["second"])

    yield from placed(layout["layout"])


def test_every_topic_and_field_of_the_layout_is_in_the_result(
    documented: dict[str, Any], topics: dict[str, Any]
) -> None:
    config = documented["configById"]
    drawn = [config["3D!scene"]["topics"], {config["RosOut!log"]["topicToRender"]: None}]
    for kind, shown in zip(("3D", "RosOut"), drawn, strict=True):
        assert {topics[topic][0] for topic in shown} == PANELS[kind]
    assert config["RawMessages!solves"]["topicPath"] in topics
    series = [
        path["value"] for name, panel in config.items() if name.startswith("Plot!") for path in panel["paths"]
    ]
    assert len(series) == 3 * 3 * 2
    for value in series:
        match = PATH.fullmatch(value)
        assert match, value
        schema, message = topics[match[1].strip('"')]
        assert schema == "istc.v1.VehicleState"
        assert message.DESCRIPTOR.fields_by_name[match[2]].cpp_type == 5  # a double


def test_every_panel_is_placed_once(documented: dict[str, Any]) -> None:
    assert sorted(panels(documented)) == sorted(documented["configById"])


def test_the_layout_in_docs_is_what_the_command_writes(documented: dict[str, Any], replayed: Replay) -> None:
    made = foxglove_layout([replayed.result.states])
    for layout in (made, documented):  # the plan of the fast mode lies a little elsewhere
        del layout["configById"]["3D!scene"]["cameraState"]["distance"]
        for part in (
            layout["configById"]["3D!scene"]["cameraState"],
            *layout["configById"]["3D!scene"]["layers"].values(),
        ):
            part.pop("targetOffset", None)
            part.pop("position", None)
            part.pop("size", None)
            part.pop("divisions", None)
    assert made == documented


def test_hostile_names_are_quoted_topics(hostile_result: Result) -> None:
    layout = json.loads(json.dumps(foxglove_layout([hostile_result.states])))
    for path in layout["configById"]["Plot!speed"]["paths"]:
        match = PATH.fullmatch(path["value"])
        assert match
        assert "<" not in match[1]
    assert sorted(panels(layout)) == sorted(layout["configById"])
