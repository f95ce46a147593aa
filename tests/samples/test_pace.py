"""The pace along a path: constant, or braked to stand exactly where it should."""

from __future__ import annotations

import numpy as np
import pytest

from istc_replay.samples.pace import Pace


def test_a_pace_without_a_stop_is_constant() -> None:
    distance, speed, acceleration = Pace(5.0).at([0.0, 2.0, 100.0])
    assert distance.tolist() == [0.0, 10.0, 500.0]
    assert speed.tolist() == [5.0, 5.0, 5.0]
    assert acceleration.tolist() == [0.0, 0.0, 0.0]


def test_a_pace_with_a_stop_brakes_at_its_rate_and_stands_exactly_there() -> None:
    pace = Pace(5.0, stop_m=40.0, deceleration_mps2=2.0)
    times = np.linspace(0.0, pace.arrival_s + 3.0, 5001)
    distance, speed, acceleration = pace.at(times)
    assert distance[-1] == pytest.approx(40.0, abs=1e-12)
    assert speed[-1] == 0.0
    assert speed.min() >= 0.0
    assert set(acceleration.tolist()) == {0.0, -2.0}
    # Speed is the derivative of distance, acceleration that of speed.
    h = times[1] - times[0]
    np.testing.assert_allclose(np.gradient(distance, h), speed, atol=2 * h)
    kinks = np.abs(np.gradient(speed, h) - acceleration) > 1e-6
    assert kinks.sum() <= 4
