"""A result.mcap holds what was recorded and planned, and independent readers read it."""

from __future__ import annotations

import cmath
import dataclasses
import hashlib
import io
import json
import os
import pickle
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from istc_replay.datatypes import Certificate, Log, StaticScene, Verdict, WindowPlan
from istc_replay.errors import ConfigError, ExportError
from istc_replay.export import result_mcap
from istc_replay.export.placing import topic_name
from istc_replay.export.result_mcap import Contents, result_bytes, solve_times
from istc_replay.states import STATES_SCHEMA

Plan = tuple[Log, list[WindowPlan]]


def written(data: bytes) -> dict[str, list[tuple[int, Any]]]:
    """Read a file with the mcap package alone: log time and message by topic."""
    reader = make_reader(io.BytesIO(data), validate_crcs=True, decoder_factories=[DecoderFactory()])
    found: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
        assert message.log_time == message.publish_time
        found[channel.topic].append((message.log_time, decoded))
    return dict(found)


def without_states(log: Log) -> Log:
    return dataclasses.replace(log, states=pl.DataFrame(schema=STATES_SCHEMA), scene=StaticScene())


def test_the_topics_are_those_of_the_contract(synthetic_bytes: bytes) -> None:
    cars = ("car%201", "car%202", "car%203")
    per_car = [f"/istc/{kind}/{car}" for kind in ("recorded", "planned", "guidance", "path") for car in cars]
    shared = ["static", "corridors", "obstacles", "solves", "certificates", "scene", "log"]
    assert set(written(synthetic_bytes)) == {*per_car, *(f"/istc/{name}" for name in shared), "/tf"}


def test_messages_stand_in_order_of_time_then_topic(synthetic_bytes: bytes) -> None:
    reader = make_reader(io.BytesIO(synthetic_bytes))
    order = [(m.log_time, channel.topic) for _, channel, m in reader.iter_messages(log_time_order=False)]
    assert order == sorted(order)


def test_each_schema_stands_once_in_the_file(synthetic_bytes: bytes) -> None:
    summary = make_reader(io.BytesIO(synthetic_bytes)).get_summary()
    assert summary is not None
    names = [schema.name for schema in summary.schemas.values()]
    assert len(names) == len(set(names)) == 11
    assert {schema.encoding for schema in summary.schemas.values()} == {"protobuf"}


def test_every_recorded_state_is_written_as_it_was_read(synthetic_bytes: bytes, synthetic_plan: Plan) -> None:
    messages = written(synthetic_bytes)
    for row in synthetic_plan[0].states.group_by("vehicle_id").len().iter_rows(named=True):
        told = messages[f"/istc/recorded/{topic_name(row['vehicle_id'])}"]
        states = synthetic_plan[0].states.filter(pl.col("vehicle_id") == row["vehicle_id"])
        assert [time for time, _ in told] == states["time_ns"].to_list()
        for name in ("time_ns", "x_m", "y_m", "heading_rad", "speed_mps"):
            assert [getattr(state, name) for _, state in told] == states[name].to_list()
        assert not any(state.HasField("steering_rad") or state.HasField("window") for _, state in told)
        assert all(state.dimensions.length_m == 4.0 for _, state in told)


def test_planned_states_are_the_trajectorys_box_centres_in_the_map(
    synthetic_bytes: bytes, synthetic_plan: Plan
) -> None:
    messages = written(synthetic_bytes)
    plan = synthetic_plan[1][0]
    frame = plan.scenario.window.frame
    for trajectory in plan.trajectories:
        told = messages[f"/istc/planned/{topic_name(trajectory.vehicle_id)}"]
        assert len(told) == len(trajectory.times_s)
        for (time_ns, state), t, (x, y, heading, steering, v, a) in zip(
            told, trajectory.times_s, trajectory.states, strict=True
        ):
            assert time_ns == state.time_ns == plan.scenario.window.start_ns + round(t * 1e9)
            # Plane geometry in complex numbers, apart from the code under test.
            centre = complex(x, y) + 1.35 * cmath.exp(1j * heading)
            in_map = complex(frame.x_m, frame.y_m) + centre * cmath.exp(1j * frame.yaw_rad)
            assert complex(state.x_m, state.y_m) == pytest.approx(in_map, abs=1e-9)
            turn = cmath.exp(1j * (state.heading_rad - heading - frame.yaw_rad))
            assert turn == pytest.approx(1.0, abs=1e-12)
            assert -cmath.pi <= state.heading_rad < cmath.pi
            assert (state.steering_rad, state.speed_mps, state.acceleration_mps2) == (steering, v, a)
            assert state.window == 0
            assert state.dimensions.rear_axle_to_centre_m == 1.35


def test_controls_are_held_from_each_knot_to_the_next_and_end_at_zero(
    synthetic_bytes: bytes, synthetic_plan: Plan
) -> None:
    trajectory = synthetic_plan[1][0].trajectories[0]
    told = written(synthetic_bytes)[f"/istc/planned/{topic_name(trajectory.vehicle_id)}"]
    controls = [(state.steering_rate_radps, state.jerk_mps3) for _, state in told]
    assert controls == [*map(tuple, trajectory.controls.tolist()), (0.0, 0.0)]


def test_absent_obstacles_are_not_written(synthetic_bytes: bytes) -> None:
    ((_, obstacles),) = written(synthetic_bytes)["/istc/obstacles"]
    units = {o.obstacle_id: [box.k for box in o.boxes] for o in obstacles.obstacles}
    assert units == {"block": [0, 1, 2, 3, 4, 5], "walker": [2, 3, 4, 5]}


def test_attachments_and_provenance_come_along(synthetic_bytes: bytes) -> None:
    reader = make_reader(io.BytesIO(synthetic_bytes))
    attachments = {attachment.name: attachment for attachment in reader.iter_attachments()}
    assert attachments["config.toml"].data == b"[window]\nunit_s = 1.0\n"
    assert json.loads(attachments["summary.json"].data)["totals"]["vehicles_certified"] == 3
    (metadata,) = reader.iter_metadata()
    assert (metadata.name, metadata.metadata["input_sha256"]) == ("istc.provenance", "0" * 64)


def test_the_attached_summary_holds_no_wall_clock_time_and_no_folder(
    synthetic_plan: Plan, synthetic_summary: dict[str, Any]
) -> None:
    log, plans = synthetic_plan
    slow = json.loads(json.dumps(synthetic_summary).replace("0.95", "7.5"))
    slow["input"]["path"] = f"/elsewhere/{slow['input']['path']}"
    slow["totals"]["cpu_s"] = 100.0
    slow["solves"] = solve_times(plans[0])
    records = tuple(dataclasses.replace(record, wall_s=9.0) for record in plans[0].records)
    slow_plan = dataclasses.replace(plans[0], records=records, corridors=None)
    same_plan = dataclasses.replace(plans[0], corridors=None)
    assert result_bytes(Contents(log, [slow_plan], [], slow, "", {})) == result_bytes(
        Contents(log, [same_plan], [], synthetic_summary, "", {})
    )


_AGAIN = """
import hashlib, pickle, sys
from istc_replay.export.result_mcap import Contents, result_bytes
print(hashlib.sha256(result_bytes(Contents(*pickle.load(sys.stdin.buffer)))).hexdigest())
"""


def test_another_process_writes_the_same_bytes(
    synthetic_plan: Plan, synthetic_certificates: list[Certificate], synthetic_summary: dict[str, Any]
) -> None:
    arguments = (*synthetic_plan, synthetic_certificates, synthetic_summary, "", {"b": "2", "a": "1"})
    digests = {hashlib.sha256(result_bytes(Contents(*arguments))).hexdigest()}
    for seed in ("1", "2"):
        run = subprocess.run(
            [sys.executable, "-c", _AGAIN],
            input=pickle.dumps(arguments),
            capture_output=True,
            check=True,
            env={**os.environ, "PYTHONHASHSEED": seed},
        )
        digests.add(run.stdout.decode().strip())
    assert len(digests) == 1


def test_the_order_of_provenance_does_not_matter(synthetic_plan: Plan) -> None:
    one = result_bytes(Contents(*synthetic_plan, [], {}, "", {"a": "1", "b": "2"}))
    assert one == result_bytes(Contents(*synthetic_plan, [], {}, "", {"b": "2", "a": "1"}))


NASTY = (
    "../x",
    "..",
    ".",
    "",
    "<script>alert(1)</script>",
    "two\nlines",
    "x" * 10_000,
    "/abs",
    "ü",
    "a%2Fb",
    "a/b",
)


def test_no_vehicle_id_escapes_its_topic_and_the_true_id_is_inside(synthetic_plan: Plan) -> None:
    log, _ = synthetic_plan
    one = log.states.head(1)
    tables = [one.with_columns(vehicle_id=pl.lit(name, dtype=pl.String)) for name in NASTY]
    data = result_bytes(Contents(dataclasses.replace(log, states=pl.concat(tables)), [], [], {}, "", {}))
    topics = {topic: told for topic, told in written(data).items() if topic.startswith("/istc/recorded/")}
    assert len(topics) == len(NASTY)
    for topic, told in topics.items():
        name = topic.removeprefix("/istc/recorded/")
        assert name
        assert len(name) < 150
        assert not name.startswith(".")
        assert set(name) <= set("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_.-%")
        assert len(told) == 1
    assert {told[0][1].vehicle_id for told in topics.values()} == set(NASTY)


@given(st.lists(st.text() | st.text("./%-a", max_size=100), unique=True, max_size=8))
def test_distinct_vehicles_have_distinct_topics(ids: list[str]) -> None:
    assert len({topic_name(vehicle_id) for vehicle_id in ids}) == len(ids)


def test_a_cut_name_is_no_other_vehicles_name() -> None:
    cut = topic_name("x" * 200)
    assert topic_name(cut) != cut


def test_a_log_without_states_makes_a_result(synthetic_plan: Plan) -> None:
    data = result_bytes(Contents(without_states(synthetic_plan[0]), [], [], {}, "", {}))
    assert set(written(data)) == {"/istc/static"}


def test_times_before_the_epoch_are_told_in_the_message(synthetic_plan: Plan) -> None:
    log = synthetic_plan[0]
    states = log.states.head(3).with_columns(time_ns=pl.Series([-5_000_000_000, -1, 7]))
    data = result_bytes(Contents(dataclasses.replace(log, states=states), [], [], {}, "", {}))
    told = written(data)["/istc/recorded/car%201"]
    assert [time for time, _ in told] == [0, 0, 7]
    assert [state.time_ns for _, state in told] == [-5_000_000_000, -1, 7]


def test_a_certificate_of_no_window_is_refused(synthetic_plan: Plan) -> None:
    certificate = Certificate(4, "disjoint", Verdict.PASS, 1.0, "m")
    with pytest.raises(ExportError, match="window 4: there is no plan"):
        result_bytes(Contents(*synthetic_plan, [certificate], {}, "", {}))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), object()])
def test_a_summary_that_is_not_json_is_refused(synthetic_plan: Plan, value: object) -> None:
    with pytest.raises(ExportError, match="cannot be written as JSON"):
        result_bytes(Contents(*synthetic_plan, [], {"value": value}, "", {}))


def test_a_configuration_that_is_none_is_refused(synthetic_plan: Plan) -> None:
    with pytest.raises(ConfigError, match="unknown key"):
        result_bytes(Contents(*synthetic_plan, [], {}, "[nowhere]\n", {}))


def test_more_topics_than_mcap_can_number_are_refused(
    synthetic_plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(result_mcap, "_TOPIC_LIMIT", 5)
    with pytest.raises(
        ExportError, match="more than 5 topics, which is what an MCAP file can have: cut the log"
    ):
        result_bytes(Contents(*synthetic_plan, [], {}, "", {}))


def test_solve_times_stand_in_the_order_of_the_solves(synthetic_bytes: bytes, synthetic_plan: Plan) -> None:
    told = [(s.stage, s.vehicle_id) for _, s in written(synthetic_bytes)["/istc/solves"]]
    times = solve_times(synthetic_plan[1][0])
    assert told == [(time["stage"], time["vehicle_id"] or "") for time in times]
    assert [time["wall_s"] for time in times] == [0.05, 0.9, 0.02, 0.02, 0.02]


def test_rerun_reads_the_planned_states(tmp_path: Path, synthetic_bytes: bytes) -> None:
    chunk = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed")
    (tmp_path / "result.mcap").write_bytes(synthetic_bytes)
    rows: dict[str, int] = defaultdict(int)
    for batch in chunk.McapReader(tmp_path / "result.mcap").stream():
        rows[str(batch.entity_path)] += batch.num_rows
    assert any("planned" in path for path in rows)
