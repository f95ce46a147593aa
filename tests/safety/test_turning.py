"""Contacts with the yaw rates held, against small steps; and what they do to straight-line findings."""

from __future__ import annotations

from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

from istc_replay.config import Config
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.log_audit import Audit, audit_log
from istc_replay.safety.turning import turning_contact

from ..support.encounters import recorded
from ..support.tracks import log_of

Array = NDArray[np.float64]
T = np.arange(0.0, 8.01, 0.1)


def stepped(boxes: Array, speeds: Array, yaw_rates: Array, ahead: Array, longest_s: float) -> Array:
    """First instant with the boxes within a centimetre, by steps of 0.5 ms of the rear axles."""
    step, moved = 5e-4, boxes.copy()
    rear = boxes[..., :2] - ahead[..., None] * np.stack([np.cos(boxes[..., 2]), np.sin(boxes[..., 2])], -1)
    heading, found = boxes[..., 2].copy(), np.full(boxes.shape[1], np.inf)
    for k in range(round(longest_s / step) + 1):
        nose = np.stack([np.cos(heading), np.sin(heading)], -1)
        moved[..., :2], moved[..., 2] = rear + ahead[..., None] * nose, heading
        near = box_gap(moved[0], moved[1]) <= 0.01
        found = np.where(near & np.isinf(found), k * step, found)
        middle = heading + yaw_rates * step / 2
        rear = rear + speeds[..., None] * step * np.stack([np.cos(middle), np.sin(middle)], -1)
        heading = heading + yaw_rates * step
    return found


def test_contacts_are_those_of_small_steps() -> None:
    rng = np.random.default_rng(3)
    count = 400
    boxes = np.stack(
        [
            np.column_stack(
                [rng.uniform(-12, 12, (count, 2)), rng.uniform(-np.pi, np.pi, count), np.full(count, 4.5),
                 np.full(count, 1.9)]
            )
            for _ in range(2)
        ]
    )  # fmt: skip
    boxes[:, 0, 3:] = 0.6  # a walker
    speeds, rates = rng.uniform(-3, 12, (2, count)), rng.uniform(-0.8, 0.8, (2, count))
    rates[:, :50] = 0.0
    ahead = rng.uniform(0.0, 1.5, (2, count))
    found, expected = (
        turning_contact(boxes, speeds, rates, ahead, 3.0),
        stepped(boxes, speeds, rates, ahead, 3.0),
    )
    clear = (np.isinf(found) == np.isinf(expected)) | (np.fmin(found, expected) > 2.99)
    assert clear.mean() > 0.99  # those that graze by less than the steps may differ
    both = np.isfinite(found) & np.isfinite(expected)
    assert both.sum() > 40
    assert np.abs(found[both] - expected[both]).max() < 0.01


@pytest.mark.parametrize("ahead_m", [-3.0, 0.0, 3.0, 6.0])
def test_a_box_that_swings_about_its_rear_axle_is_there_no_later_than_its_far_corner(ahead_m: float) -> None:
    # It hardly moves but for the swing: the far corner is fastest, and comes straight at the other box.
    far = abs(ahead_m) + 2.25
    way = np.sign(ahead_m) or 1.0
    boxes = np.zeros((2, 1, 5))
    boxes[0, 0] = [ahead_m, 0.0, 0.0, 4.5, 1.9]
    boxes[1, 0] = [way * far * 0.8, way * (1.0 + far * 0.5), 0.0, 0.5, 0.5]
    speeds, rates = np.array([[0.05], [0.0]]), np.array([[1.0], [0.0]])
    ahead = np.array([[ahead_m], [0.0]])
    found = turning_contact(boxes, speeds, rates, ahead, 3.0)
    expected = stepped(boxes, speeds, rates, ahead, 3.0)
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(found, expected, atol=2e-3)


def bend(name: str, **changes: Any) -> pl.DataFrame:
    """North at 6 m/s, then a right turn of 8 m, and on to the east."""
    radius, speed = 8.0, 6.0
    s = speed * T - 15.0
    angle = np.clip(s / radius, 0.0, np.pi / 2)
    rest = np.maximum(s - radius * np.pi / 2, 0.0)
    x = radius * (1 - np.cos(angle)) + rest
    y = np.where(s < 0.0, s, radius * np.sin(angle))
    heading = np.pi / 2 - angle
    columns = {"x_m": x, "y_m": y, "heading_rad": heading, "speed_mps": speed, "rear_axle_to_centre_m": 0.0}
    return recorded(name, T, **columns | changes)


def of(audit: Audit, rule: str) -> list[dict[str, Any]]:
    return audit.findings.filter(pl.col("rule") == rule).to_dicts()


def test_a_turning_car_that_points_at_a_waiting_one_is_a_minor_finding_that_says_why() -> None:
    # It waits beyond the bend, in the oncoming lane: pointed at for a moment, never driven at.
    waiting = recorded("w", T, x_m=7.0, y_m=13.5, heading_rad=-np.pi / 2, speed_mps=0.0)
    found = of(audit_log(log_of(bend("turns"), waiting), Config()), "ttc")
    assert [row["severity"] for row in found] == ["minor"]
    assert found[0]["value"] < 1.5
    assert "with the yaw rates held there is no contact" in found[0]["detail"]


def test_a_car_that_goes_straight_at_a_waiting_one_is_as_severe_as_ever() -> None:
    ahead = recorded("w", T, x_m=0.0, y_m=18.0, heading_rad=-np.pi / 2, speed_mps=0.0)
    straight = bend("straight", x_m=0.0, y_m=6.0 * T - 15.0, heading_rad=np.pi / 2)
    found = of(audit_log(log_of(straight, ahead), Config()), "ttc")
    assert [row["severity"] for row in found] == ["critical"]


def test_a_car_that_turns_into_another_one_is_as_severe_as_ever() -> None:
    # It waits where the bend leads.
    waiting = recorded("w", T, x_m=14.5, y_m=8.0, heading_rad=0.0, speed_mps=0.0)
    found = of(audit_log(log_of(bend("turns"), waiting), Config()), "ttc")
    assert "critical" in [row["severity"] for row in found]


@pytest.mark.parametrize("rule", ["drac", "required_deceleration"])
def test_the_yaw_rate_threshold_is_configurable(rule: str) -> None:
    waiting = recorded("w", T, x_m=7.0, y_m=12.5, heading_rad=-np.pi / 2, speed_mps=0.0)
    log = log_of(bend("turns"), waiting)
    straight = Config.model_validate({"audit": {"turning_radps": 100.0}})
    severe = {row["severity"] for row in of(audit_log(log, straight), rule)}
    assert severe & {"serious", "critical"}
    assert {row["severity"] for row in of(audit_log(log, Config()), rule)} == {"minor"}
