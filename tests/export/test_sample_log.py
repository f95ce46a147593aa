"""Sample logs, read back by the readers of others."""

from __future__ import annotations

import io
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from mcap.reader import McapReader, make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_ros2.decoder import DecoderFactory as Ros2Factory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from istc_replay.datatypes import MapBounds, SceneObstacle, StaticScene
from istc_replay.errors import UsageError
from istc_replay.export.sample_log import sample_bytes
from istc_replay.samples.drive import RecordedScene
from istc_replay.samples.scenes import SAMPLES

LOGS = Path(__file__).resolve().parents[2] / "sample_logs"


@cache
def recorded(name: str = "intersection_turn_first") -> RecordedScene:
    return SAMPLES[name].record()


def reader(data: bytes) -> McapReader:
    return make_reader(
        io.BytesIO(data), validate_crcs=True, decoder_factories=[ProtobufFactory(), Ros2Factory()]
    )


def track(vehicle: str) -> list[dict[str, Any]]:
    return recorded().states.filter(pl.col("vehicle_id") == vehicle).to_dicts()


@pytest.mark.parametrize("name", [name for name, sample in SAMPLES.items() if sample.has_log])
def test_the_log_in_the_repository_is_what_the_code_writes(name: str) -> None:
    sample = SAMPLES[name]
    data = sample_bytes(sample.record(), sample.format)
    assert len(data) < 300_000
    assert (LOGS / f"{name}.mcap").read_bytes() == data, f"{name} is stale: run scripts/samples"


def test_nothing_else_lies_among_the_sample_logs() -> None:
    with_logs = {name for name, sample in SAMPLES.items() if sample.has_log}
    assert {path.stem for path in LOGS.glob("*.mcap")} == with_logs


def test_an_unknown_format_is_refused_with_those_there_are() -> None:
    with pytest.raises(UsageError, match="istc, osi, odometry"):
        sample_bytes(recorded(), "csv")


def test_istc_states_equal_those_recorded() -> None:
    messages = list(reader(sample_bytes(recorded())).iter_decoded_messages(topics=["/vehicles/3/state"]))
    assert len(messages) == 101
    for (_, _, message, state), row in zip(messages, track("3"), strict=True):
        assert state.time_ns == message.log_time == message.publish_time == row["time_ns"]
        assert state.vehicle_id == "3"
        for name in ("x_m", "y_m", "heading_rad", "speed_mps", "acceleration_mps2", "steering_rad"):
            assert getattr(state, name) == row[name]
        assert state.HasField("steering_rad")
        for name in ("length_m", "width_m", "wheelbase_m", "rear_axle_to_centre_m"):
            assert getattr(state.dimensions, name) == row[name]


def test_the_istc_scene_comes_first_and_holds_lanes_priorities_and_dimensions() -> None:
    _, channel, message, scene = next(iter(reader(sample_bytes(recorded())).iter_decoded_messages()))
    assert channel.topic == "/scene"
    assert message.log_time == recorded().states["time_ns"].min()
    assert [line.vehicle_id for line in scene.lane_lines] == ["1", "2", "3"]
    for line, lane in zip(scene.lane_lines, recorded().scene.lane_lines, strict=True):
        assert np.array_equal([(p.x_m, p.y_m) for p in line.points], lane.points_m)
    assert [vehicle.priority for vehicle in scene.vehicles] == [0.20, 0.01, 0.50]
    assert all(vehicle.dimensions.wheelbase_m == 2.7 for vehicle in scene.vehicles)
    assert not scene.HasField("bounds")


def test_the_dense_scene_holds_its_bounds_and_no_priorities() -> None:
    data = sample_bytes(recorded("dense_4"))
    _, _, _, scene = next(iter(reader(data).iter_decoded_messages(topics=["/scene"])))
    bounds = scene.bounds
    assert (bounds.x_min_m, bounds.x_max_m, bounds.y_min_m, bounds.y_max_m) == (0.0, 50.0, 0.0, 38.0)
    assert not any(vehicle.HasField("priority") for vehicle in scene.vehicles)


def with_obstacle() -> RecordedScene:
    scene = StaticScene(
        obstacles=(SceneObstacle("block", 30.0, -20.0, 0.5, 6.0, 3.0),), bounds=MapBounds(-60, 60, -60, 60)
    )
    return RecordedScene("block", scene, recorded().states)


def test_obstacles_are_part_of_istc_and_osi_logs() -> None:
    _, _, _, scene = next(iter(reader(sample_bytes(with_obstacle())).iter_decoded_messages()))
    block = scene.obstacles[0]
    assert (block.obstacle_id, block.x_m, block.heading_rad, block.width_m) == ("block", 30.0, 0.5, 3.0)
    _, _, _, truth = next(iter(reader(sample_bytes(with_obstacle(), "osi")).iter_decoded_messages()))
    standing = truth.stationary_object[0]
    assert standing.id.value not in {moving.id.value for moving in truth.moving_object}
    assert (standing.base.position.x, standing.base.position.y) == (30.0, -20.0)
    assert (standing.base.dimension.length, standing.base.orientation.yaw) == (6.0, 0.5)


def test_osi_ground_truth_equals_what_was_recorded() -> None:
    messages = list(reader(sample_bytes(recorded(), "osi")).iter_decoded_messages())
    assert len(messages) == 101
    for (schema, _, message, truth), row in zip(messages, track("3"), strict=True):
        assert schema.name == "osi3.GroundTruth"
        assert truth.timestamp.seconds * 10**9 + truth.timestamp.nanos == message.log_time == row["time_ns"]
        moving = {found.id.value: found for found in truth.moving_object}[3]
        base, heading = moving.base, row["heading_rad"]
        assert (base.position.x, base.position.y, base.orientation.yaw) == (row["x_m"], row["y_m"], heading)
        assert (base.dimension.length, base.dimension.width) == (4.0, 2.0)
        along = base.velocity.x * math.cos(heading) + base.velocity.y * math.sin(heading)
        assert along == pytest.approx(row["speed_mps"], abs=1e-7)
        assert moving.vehicle_attributes.bbcenter_to_rear.x == -1.35
        assert moving.vehicle_attributes.bbcenter_to_front.x == pytest.approx(1.35)


def slopes(values: np.ndarray) -> np.ndarray:
    return np.diff(values, axis=0) / 0.1


def means(values: np.ndarray) -> np.ndarray:
    return (values[1:] + values[:-1]) / 2.0


@pytest.mark.parametrize("name", ["intersection_osi", "dense_4"])
def test_osi_velocity_and_acceleration_are_derivatives_of_the_positions(name: str) -> None:
    truths = [truth for *_, truth in reader(sample_bytes(recorded(name), "osi")).iter_decoded_messages()]
    bases = [[moving.base for moving in truth.moving_object] for truth in truths]
    positions, velocities, accelerations = (
        np.array([[(getattr(b, field).x, getattr(b, field).y) for b in row] for row in bases])
        for field in ("position", "velocity", "acceleration")
    )
    rates = np.array([[b.orientation_rate.yaw for b in row] for row in bases])
    yaws = np.unwrap([[b.orientation.yaw for b in row] for row in bases], axis=0)
    np.testing.assert_allclose(slopes(positions), means(velocities), atol=0.06)
    np.testing.assert_allclose(slopes(yaws), means(rates), atol=0.02)
    # Steering rate and braking jump within a step now and then; elsewhere the derivative is met closely.
    error = np.abs(slopes(velocities) - means(accelerations)).max(axis=2)
    assert np.quantile(error, 0.9) < 0.1
    assert error.max() < 1.7


def test_the_osi_log_follows_the_rules_of_osi_trace_files() -> None:
    log = reader(sample_bytes(recorded(), "osi"))
    summary = log.get_summary()
    assert summary is not None
    assert summary.chunk_indexes
    (trace,) = log.iter_metadata()
    assert trace.name == "net.asam.osi.trace"
    versions = {f"{end}_{what}_version" for end in ("min", "max") for what in ("osi", "protobuf")}
    assert {"version"} | versions <= set(trace.metadata)
    (channel,) = summary.channels.values()
    assert set(channel.metadata) == {
        "net.asam.osi.trace.channel.osi_version",
        "net.asam.osi.trace.channel.protobuf_version",
    }


def test_vehicles_whose_ids_are_no_numbers_are_numbered_in_osi() -> None:
    states = recorded().states.with_columns(vehicle_id="car " + pl.col("vehicle_id"))
    data = sample_bytes(RecordedScene("named", StaticScene(), states), "osi")
    *_, truth = next(iter(reader(data).iter_decoded_messages()))
    assert [moving.id.value for moving in truth.moving_object] == [1, 2, 3]


def test_odometry_decodes_to_the_rear_axles_in_two_readers() -> None:
    typestore = get_typestore(Stores.ROS2_HUMBLE)
    log = reader(sample_bytes(recorded(), "odometry"))
    messages = list(log.iter_decoded_messages(topics=["/vehicle_3/odom"]))
    assert len(messages) == 101
    for (_, channel, message, odometry), row in zip(messages, track("3"), strict=True):
        assert channel.message_encoding == "cdr"
        other = typestore.deserialize_cdr(message.data, "nav_msgs/msg/Odometry")
        for found in (odometry, other):
            stamp = found.header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == message.log_time == row["time_ns"]
            assert (found.header.frame_id, found.child_frame_id) == ("map", "vehicle_3/base_link")
            pose, twist = found.pose.pose, found.twist.twist
            heading = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
            assert math.remainder(heading - row["heading_rad"], 2 * math.pi) == pytest.approx(0.0, abs=1e-8)
            assert pose.position.x + 1.35 * math.cos(heading) == pytest.approx(row["x_m"], abs=1e-7)
            assert pose.position.y + 1.35 * math.sin(heading) == pytest.approx(row["y_m"], abs=1e-7)
            assert (twist.linear.x, twist.linear.y) == (row["speed_mps"], 0.0)
            turning = row["speed_mps"] * math.tan(row["steering_rad"]) / 2.7
            assert twist.angular.z == pytest.approx(turning, abs=1e-8)


def test_the_odometry_definition_is_the_one_that_rosbags_knows() -> None:
    typestore = get_typestore(Stores.ROS2_HUMBLE)
    summary = reader(sample_bytes(recorded(), "odometry")).get_summary()
    assert summary is not None
    (schema,) = summary.schemas.values()
    for name, (_, fields) in get_types_from_msg(schema.data.decode(), schema.name).items():
        assert fields == typestore.fielddefs[name][1]
