"""Time and angle conversions at their edges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from istc_replay.units import seconds_to_ns, wrap_angle

BELOW = np.nextafter(-np.pi, -10.0)


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [(0.0, 0.0), (np.pi, -np.pi), (-np.pi, -np.pi), (3.0 * np.pi, -np.pi), (4.0, 4.0 - 2.0 * np.pi)],
)
def test_angles_are_wrapped_to_the_half_open_turn(angle: float, wrapped: float) -> None:
    assert float(wrap_angle(angle)) == pytest.approx(wrapped, abs=1e-12)


@settings(deadline=None)
@given(st.floats(-1e6, 1e6) | st.sampled_from([BELOW, -BELOW, BELOW - 4.0 * np.pi]))
def test_a_wrapped_angle_is_never_a_whole_turn_off_whatever_the_rounding(angle: float) -> None:
    wrapped = float(wrap_angle(angle))
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-9)


def test_wrapping_keeps_the_shape_and_what_is_no_number() -> None:
    angles = np.array([[0.0, 7.0], [np.nan, -7.0]])
    wrapped = wrap_angle(angles)
    assert wrapped.shape == (2, 2)
    assert np.isnan(wrapped).tolist() == [[False, False], [True, False]]


@pytest.mark.parametrize(
    ("seconds", "nanoseconds"),
    [(0.0, 0), (0.1, 100_000_000), (1.0000000004, 1_000_000_000), (-0.25, -250_000_000)],
)
def test_seconds_are_rounded_to_whole_nanoseconds(seconds: float, nanoseconds: int) -> None:
    assert seconds_to_ns(seconds) == nanoseconds
