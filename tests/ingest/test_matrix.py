"""The matrix of docs/formats.md is what the code reads, row by row."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

from istc_replay.config import FieldTarget, IngestConfig, TopicFormat
from istc_replay.ingest.channels import FORMATS, MAPPABLE, Format, reference_point

FORMATS_MD = (Path(__file__).resolve().parents[2] / "docs/formats.md").read_text(encoding="utf-8")
NOT_STATES = {"istc.v1.Scene"}
#: What a mapping may name to tell a column of the matrix.
TELLS = {
    "time": {"time", "time_ns"},
    "heading": {"heading_rad", "orientation"},
    "speed": {"speed_mps", "velocity.x"},
    "acceleration": {"acceleration_mps2", "acceleration.x"},
    "size": {"length_m"},
}
POINTS = {"box_centre": "box centre", "rear_axle": "`ingest.odometry_reference_point`"}


def row(format_: Format) -> str:
    """A row of the matrix, from the code."""
    fields = format_.mapping.fields
    position = "metres from the first fix" if "latitude" in fields else POINTS[_point(format_)]
    who = "the topic's"
    if "vehicle_frame" in fields:
        who = "the child frame's, else the topic's"
    elif "vehicle_id" in fields:
        who = "in the message"
    elif format_.many:
        who = "the topic's and the place in the list"
    derived = {"time": "log time", "heading": "derived", "speed": "derived", "acceleration": "derived"}
    cells = ["told" if names & set(fields) else derived.get(name, "none") for name, names in TELLS.items()]
    encodings = f"{format_.schema_encoding}, {format_.message_encoding}"
    return f"| `{format_.name}` | {encodings} | {position} | {' | '.join(cells)} | {who} |"


def _point(format_: Format) -> str:
    return reference_point("/any", format_, IngestConfig())


def test_every_format_has_its_row() -> None:
    wanted = [row(format_) for format_ in FORMATS if format_.name not in NOT_STATES]
    listed = [line for line in FORMATS_MD.splitlines() if line.startswith("| `") and line.count("|") == 10]
    assert listed == wanted, "the matrix should be:\n" + "\n".join(wanted)
    assert all(f"`{name}`" in FORMATS_MD for name in NOT_STATES)


def test_every_field_of_a_mapping_and_every_choice_is_explained() -> None:
    for name in (*get_args(FieldTarget), *get_args(TopicFormat)):
        assert f"`{name}`" in FORMATS_MD, name
    for message, schema in MAPPABLE:
        assert message in FORMATS_MD
        assert schema in FORMATS_MD
