"""What was recorded between samples, and the least recorded gap."""

from __future__ import annotations

from typing import Any

import numpy as np
import polars as pl
import pytest
import shapely

from istc_replay.geometry import box_corners
from istc_replay.safety.recorded import RecordedGap, least_recorded_gap, recorded_tracks
from istc_replay.states import RESULT_STATES_SCHEMA, conform

NS = 1_000_000_000


def table(*rows: dict[str, Any]) -> pl.DataFrame:
    """A result's states from rows of columns (arrays broadcast to the times)."""
    parts = []
    for row in rows:
        values = {"source": "recorded", "heading_rad": 0.0, "y_m": 0.0, "length_m": 4.0, "width_m": 2.0} | row
        times = np.atleast_1d(values.pop("time_s"))
        columns = {name: np.broadcast_to(np.asarray(value), times.shape) for name, value in values.items()}
        parts.append(pl.DataFrame({"time_ns": np.round(times * NS).astype(np.int64), **columns}))
    return conform(pl.concat(parts, how="diagonal_relaxed"), RESULT_STATES_SCHEMA)


def test_the_least_gap_is_found_with_its_pair_and_time() -> None:
    t = np.arange(0, 8.01, 0.1)
    states = table(
        {"vehicle_id": "east", "time_s": t, "x_m": -20 + 5 * t},
        {"vehicle_id": "west", "time_s": t, "x_m": 21 - 5 * t, "y_m": 2.5, "heading_rad": np.pi},
        {"vehicle_id": "parked", "time_s": t, "x_m": 0.0, "y_m": 9.0},
    )
    found = least_recorded_gap(states, 0, 8 * NS)
    assert found is not None
    assert found.min_separation_m == pytest.approx(0.5)
    assert found.pair == ("east", "west")
    assert 3.7 * NS <= found.time_ns <= 4.5 * NS


def test_only_the_span_is_looked_at() -> None:
    t = np.arange(0, 8.01, 0.1)
    states = table(
        {"vehicle_id": "a", "time_s": t, "x_m": 5 * t}, {"vehicle_id": "b", "time_s": t, "x_m": 50.0}
    )
    found = least_recorded_gap(states, NS, 2 * NS)
    assert found == RecordedGap(pytest.approx(36.0), ("a", "b"), 2 * NS)


def test_overlap_is_negative() -> None:
    states = table(
        {"vehicle_id": "a", "time_s": [0.0, 1.0], "x_m": 0.0},
        {"vehicle_id": "b", "time_s": [0.0, 1.0], "x_m": 3.5},
    )
    assert least_recorded_gap(states, 0, NS) == RecordedGap(pytest.approx(-0.5), ("a", "b"), 0)


def test_samples_at_different_times_are_interpolated() -> None:
    a, b = np.arange(0, 2.01, 0.1), np.arange(0.03, 2.01, 0.07)
    states = table(
        {"vehicle_id": "a", "time_s": a, "x_m": 10 * a},
        {"vehicle_id": "b", "time_s": b, "x_m": 10 * b + 7.0},
    )
    found = least_recorded_gap(states, 0, 2 * NS)
    assert found is not None
    assert found.min_separation_m == pytest.approx(3.0)


def test_headings_turn_the_short_way_between_samples() -> None:
    track = recorded_tracks(
        table({"vehicle_id": "a", "time_s": [0.0, 1.0], "x_m": 0.0, "heading_rad": [3.1, -3.1]})
    )["a"]
    heading = track.at(np.array([NS // 2]))[0, 2]
    assert abs(np.cos(heading) + 1.0) < 1e-9


def test_gaps_in_the_recording_are_not_bridged() -> None:
    t = np.concatenate([np.arange(0, 1.01, 0.1), np.arange(3, 4.01, 0.1)])
    inside = np.arange(0, 4.01, 0.1)
    # Interpolated over the pause, a would drive through b.
    states = table(
        {"vehicle_id": "a", "time_s": t, "x_m": np.where(t < 2, -10.0, 10.0)},
        {"vehicle_id": "b", "time_s": inside, "x_m": 0.0},
    )
    found = least_recorded_gap(states, 0, 4 * NS)
    assert found is not None
    assert found.min_separation_m == pytest.approx(6.0)
    track = recorded_tracks(states)["a"]
    assert np.isnan(track.at(np.array([2 * NS]))).all()
    assert track.at(np.array([3 * NS]))[0, 0] == 10.0
    assert np.isnan(track.at(np.array([-1, 5 * NS]))).all()


@pytest.mark.parametrize(
    "rows",
    [
        [{"vehicle_id": "a", "time_s": [0.0, 1.0], "x_m": 0.0}],
        [
            {"vehicle_id": "a", "time_s": [0.0, 1.0], "x_m": 0.0},
            {"vehicle_id": "b", "time_s": [0.0, 1.0], "x_m": 9.0, "length_m": np.nan},
        ],
        [
            {"vehicle_id": "a", "time_s": [0.0, 1.0], "x_m": 0.0},
            {"vehicle_id": "b", "time_s": [0.0, 1.0], "x_m": np.nan},
        ],
        [
            {"vehicle_id": "a", "time_s": [0.0, 1.0], "x_m": 0.0},
            {"vehicle_id": "b", "time_s": [5.0, 6.0], "x_m": 0.0},
        ],
        [
            {"vehicle_id": "a", "time_s": [0.0, 1.0], "x_m": 0.0},
            {"vehicle_id": "b", "time_s": [0.0, 1.0], "x_m": 1.0, "source": "planned"},
        ],
    ],
    ids=["one vehicle", "no size", "no position", "never at once", "only planned"],
)
def test_there_is_no_gap_where_no_two_known_vehicles_meet(rows: list[dict[str, Any]]) -> None:
    assert least_recorded_gap(table(*rows), 0, 10 * NS) is None


def test_pedestrians_are_no_vehicles() -> None:
    states = table(
        {"vehicle_id": "a", "time_s": [0.0, 1.0], "x_m": 0.0},
        {"vehicle_id": "b", "time_s": [0.0, 1.0], "x_m": 9.0},
        {"vehicle_id": "walker", "time_s": [0.0, 1.0], "x_m": 3.0},
    )
    role = pl.when(pl.col("vehicle_id") == "walker").then(pl.lit("pedestrian")).otherwise(pl.lit("vehicle"))
    found = least_recorded_gap(states.with_columns(role=role), 0, NS)
    assert found is not None
    assert found.pair == ("a", "b")


def test_the_least_gap_of_random_traffic_equals_shapelys() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(0, 3.01, 0.1)
    rows, boxes = [], []
    for k in range(12):
        x = rng.uniform(-40, 40) + rng.uniform(-8, 8) * t
        y, heading = rng.uniform(-40, 40) + rng.uniform(-8, 8) * t, rng.uniform(-3, 3) + 0.1 * t
        rows.append({"vehicle_id": f"v{k:02}", "time_s": t, "x_m": x, "y_m": y, "heading_rad": heading})
        boxes.append(shapely.polygons(box_corners(x, y, heading, 4.0, 2.0)))
    truth = min(
        float(shapely.distance(boxes[i], boxes[j]).min()) for i in range(12) for j in range(i + 1, 12)
    )
    found = least_recorded_gap(table(*rows), 0, 3 * NS)
    assert found is not None
    assert max(found.min_separation_m, 0.0) == pytest.approx(truth, abs=1e-9)
