"""Whole logs of all formats: they tell the same truth, and nothing wrong passes in silence."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from istc_replay.config import Config
from istc_replay.errors import LogError
from istc_replay.ingest.log import read_log
from istc_replay.ingest.walk import open_log
from istc_replay.states import STATES_SCHEMA

from ..support.logs import T0_NS, Topic, write_log


def codes(log: Any) -> set[str]:
    return {problem.code for problem in log.problems}


def test_odometry_and_osi_tell_the_same_truth_as_json(shared_logs: Path, json_truth: pl.DataFrame) -> None:
    odometry = read_log(shared_logs / "formats/ros2_odom.mcap")
    osi = read_log(shared_logs / "formats/osi_gt.mcap")
    assert odometry.problems == osi.problems == ()
    assert odometry.complete
    assert osi.complete
    x = json_truth["x"] + 1.35 * json_truth["yaw"].cos()
    y = json_truth["y"] + 1.35 * json_truth["yaw"].sin()
    for states, prefix in ((odometry.states, "vehicle_"), (osi.states, "10")):
        assert states["vehicle_id"].to_list() == [prefix + vehicle for vehicle in json_truth["id"]]
        assert states["time_ns"].to_list() == json_truth["time_ns"].to_list()
        assert (states["x_m"] - x).abs().max() < 1e-9
        assert (states["y_m"] - y).abs().max() < 1e-9
        assert (states["speed_mps"] - json_truth["v"]).abs().max() < 1e-9
        turn = states["heading_rad"] - json_truth["yaw"]
        assert (turn.sin().abs() + 1 - turn.cos()).max() < 1e-9
        assert states["heading_rad"].is_between(-math.pi, math.pi, closed="left").all()
    assert (osi.states["acceleration_mps2"] - json_truth["a"]).abs().max() < 1e-9
    assert osi.states["length_m"].to_list() == json_truth["length"].to_list()
    assert osi.states["rear_axle_to_centre_m"].unique().to_list() == pytest.approx([1.35])


THIRD_PARTY = (
    "USA_Lanker-1_1_T-1",
    "USA_Peach-4_8_T-1",
    "USA_US101-3_3_T-1",
    "USA_US101-4_1_T-1",
    "sumo_rbl_fcd",
    "acc-test",
    "alks_cut-in",
    "pedestrian",
)


def by_the_reference_decoder(path: Path) -> list[tuple[str, int, float, float, float, bool]]:
    """What the reference libraries read: id, time, x, y, length, whether a pedestrian."""
    rows = []
    with path.open("rb") as stream:
        for decoded in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            truth = decoded.decoded_message
            time_ns = truth.timestamp.seconds * 10**9 + truth.timestamp.nanos
            for moving in truth.moving_object:
                place, size = moving.base.position, moving.base.dimension
                rows.append((str(moving.id.value), time_ns, place.x, place.y, size.length, moving.type == 3))
    return sorted(rows)


@pytest.mark.parametrize("name", THIRD_PARTY)
def test_logs_from_elsewhere_load_with_sensible_states(shared_logs: Path, name: str) -> None:
    path = shared_logs / f"third_party/{name}.mcap"
    log = read_log(path)
    states = log.states
    assert states.schema == STATES_SCHEMA
    assert log.problems == ()
    told = states.select("vehicle_id", "time_ns", "x_m", "y_m", "length_m", pl.col("role") == "pedestrian")
    assert told.rows() == by_the_reference_decoder(path)
    assert states.select("heading_rad", "speed_mps", "width_m").null_count().row(0) == (0, 0, 0)
    assert states.equals(states.sort("vehicle_id", "time_ns", maintain_order=True))
    assert states["length_m"].is_between(0.3, 25.0).all()
    # The displacement over a step agrees with the recorded speed.
    steps = states.with_columns(
        along=pl.col("x_m").diff() * pl.col("heading_rad").cos()
        + pl.col("y_m").diff() * pl.col("heading_rad").sin(),
        step_s=pl.col("time_ns").diff() / 1e9,
        same=pl.col("vehicle_id") == pl.col("vehicle_id").shift(1),
    ).filter("same")
    assert (steps["along"] / steps["step_s"] - steps["speed_mps"]).abs().median() < 0.5


def test_every_bad_file_is_a_log_or_a_one_line_error(shared_logs: Path) -> None:
    for path in sorted((shared_logs / "bad").glob("*.mcap")):
        try:
            log = read_log(path)
        except LogError as error:
            assert "\n" not in str(error)  # noqa: PT017
            continue
        assert log.states.schema == STATES_SCHEMA
        assert all("\n" not in problem.detail for problem in log.problems)
        assert log.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_undecodable_schemas_and_payloads_are_problems(shared_logs: Path) -> None:
    schema = read_log(shared_logs / "bad/37_bad_protobuf_schema.mcap")
    assert (codes(schema), schema.channels[0].understood_as) == ({"schema"}, None)
    payload = read_log(shared_logs / "bad/39_cdr_truncated_payload.mcap")
    assert (codes(payload), payload.channels[0].understood_as) == ({"payload"}, "nav_msgs/msg/Odometry")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(payload=st.binary(max_size=80))
def test_no_payload_raises(payload: bytes, save: Any, shared_logs: Path) -> None:
    schemas = {}
    for name in ("osi_gt", "ros2_odom"):
        found = next(open_log(shared_logs / f"formats/{name}.mcap").messages())
        assert found.channel.schema is not None
        schemas[name] = found.channel.schema
    log = read_log(
        save(
            write_log(
                Topic("/state", [(T0_NS, payload)]),
                Topic("/scene", [(T0_NS, payload)], "istc.v1.Scene"),
                Topic("/osi", [(T0_NS, payload)], "osi3.GroundTruth", "protobuf", schemas["osi_gt"].data),
                Topic(
                    "/odom",
                    [(T0_NS, b"\0\1\0\0" + payload)],
                    "nav_msgs/msg/Odometry",
                    "ros2msg",
                    schemas["ros2_odom"].data,
                    "cdr",
                ),
            )
        ),
        Config(),
    )
    assert log.states.schema == STATES_SCHEMA
