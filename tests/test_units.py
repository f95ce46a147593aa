"""Times and angles at the edges of their ranges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from istc_replay.units import median_step, wrap_angle


def test_a_gap_does_not_change_the_median_step_and_a_single_time_has_none() -> None:
    assert median_step([0, 100, 200, 300, 9_000]) == 100.0
    assert median_step(np.array([5], dtype=np.int64)) == median_step([]) == 0.0


@given(st.floats(-1e6, 1e6))
def test_a_wrapped_angle_is_the_same_direction_within_half_a_turn(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)
