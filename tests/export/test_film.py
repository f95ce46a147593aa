"""Frames of what was recorded: at every instant what is there, between states and in gaps too."""

from __future__ import annotations

import dataclasses
import io
import math
from typing import Any

import numpy as np
import polars as pl
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from istc_replay.datatypes import (
    LaneLine,
    Log,
    StaticScene,
    read_only,
)
from istc_replay.export import film, foxglove
from istc_replay.export.result_mcap import Contents, result_bytes
from istc_replay.states import STATES_SCHEMA

from ..support.foxglove import Plan, S, made, visible, yaw
from ..support.tracks import track


def recorded(times_s: list[float], vehicle: str = "a", **columns: Any) -> pl.DataFrame:
    """A vehicle of unknown size that drives east at 10 m/s; its heading is unknown where it is not given."""
    table = track(vehicle, times_s, **({"x_m": 10.0 * np.asarray(times_s)} | columns))
    return table if "heading_rad" in columns else table.with_columns(heading_rad=pl.lit(None, pl.Float64))


def log_of(log: Log, *tables: pl.DataFrame) -> Log:
    """The log with other states, and nothing of its scene."""
    return dataclasses.replace(log, states=pl.concat(tables), scene=StaticScene())


def test_a_vehicle_is_not_shown_in_a_gap_of_its_recording(synthetic_plan: Plan) -> None:
    steps = [i / 10 for i in range(11)]
    log = log_of(synthetic_plan[0], recorded(steps + [5.0 + t for t in steps], heading_rad=0.0))
    scenes = made(log, [])["/istc/scene"]
    assert set(visible(scenes, S)) == set(visible(scenes, 5 * S)) == {"recorded/a"}
    assert visible(scenes, 2 * S) == visible(scenes, 7 * S) == {}


def test_between_its_states_a_vehicle_stands_on_the_line_between_them(synthetic_plan: Plan) -> None:
    turning = recorded([0.0, 0.2, 0.4], "a", heading_rad=[3.0, -3.0, -2.8])
    other = recorded([0.1, 0.3], "b", heading_rad=0.0)
    scenes = made(log_of(synthetic_plan[0], turning, other), [])["/istc/scene"]
    pose = visible(scenes, S // 10)["recorded/a"].cubes[0].pose
    assert pose.position.x == pytest.approx(1.0)
    # The short way over the cut at pi.
    assert abs(yaw(pose.orientation)) == pytest.approx(math.pi)


def test_a_vehicle_of_unknown_size_or_heading_is_drawn_all_the_same(synthetic_plan: Plan) -> None:
    scenes = made(log_of(synthetic_plan[0], recorded([0.0])), [])["/istc/scene"]
    entity = visible(scenes, 0)["recorded/a"]
    assert (entity.cubes[0].size.x, entity.cubes[0].size.y) == (4.0, 2.0)
    assert entity.texts[0].text == "a"
    assert visible(scenes, S) == {}


def test_vehicles_at_instants_of_their_own_do_not_swell_the_scene(
    synthetic_plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(film, "_CARS_FLOOR", 0)
    tables = [recorded([i + v / 100 for i in range(10)], f"v{v:02}", heading_rad=0.0) for v in range(60)]
    scenes = made(log_of(synthetic_plan[0], *tables), [])["/istc/scene"]
    assert sum(len(message.entities) for _, message in scenes) <= 4 * 600
    assert len(visible(scenes, 5 * S)) == 60


def test_long_lane_lines_stand_in_the_first_scene_alone(
    synthetic_plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(foxglove, "_LINE_POINTS_LIMIT", 10)
    log, plans = synthetic_plan
    lane = LaneLine("long", read_only(np.zeros((11, 2)), 2))
    scenes = made(dataclasses.replace(log, scene=StaticScene((lane,))), plans)["/istc/scene"]
    drawn = [any(entity.id == "lane/0" for entity in message.entities) for _, message in scenes]
    assert drawn == [True] + [False] * (len(scenes) - 1)


def test_a_log_of_standing_things_alone_is_shown(synthetic_plan: Plan) -> None:
    log = dataclasses.replace(synthetic_plan[0], states=pl.DataFrame(schema=STATES_SCHEMA))
    ((_, scene),) = made(log, [])["/istc/scene"]
    assert {entity.id for entity in scene.entities} == {"lane/0", "lane/1", "standing/block"}


def test_utm_coordinates_keep_their_millimetres(synthetic_plan: Plan) -> None:
    log = log_of(
        synthetic_plan[0], recorded([0.0], x_m=[691_234.1234], y_m=[5_334_567.8901], heading_rad=[0.1])
    )
    data = result_bytes(Contents(log, [], [], {}, "", {}))
    reader = make_reader(io.BytesIO(data), decoder_factories=[DecoderFactory()])
    ((_, _, _, tf),) = reader.iter_decoded_messages(topics=["/tf"])
    assert (tf.transforms[0].translation.x, tf.transforms[0].translation.y) == (691_234.1234, 5_334_567.8901)
