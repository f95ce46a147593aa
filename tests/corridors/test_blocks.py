"""The car-box of eq. (7), against every heading that it must hold."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from istc_replay.corridors.blocks import car_box_m


@settings(max_examples=100, deadline=None)
@given(st.floats(-10.0, 10.0), st.floats(0.0, 0.6), st.floats(1.0, 20.0), st.floats(0.5, 3.0))
def test_the_car_box_holds_the_car_at_every_heading_within_the_slack(
    heading: float, slack: float, length: float, width: float
) -> None:
    box = car_box_m(np.array([heading]), slack, length, width)[0]
    angles = heading + np.linspace(-slack, slack, 2001)
    c, s = np.abs(np.cos(angles)), np.abs(np.sin(angles))
    largest = np.array([(length * c + width * s).max(), (length * s + width * c).max()])
    assert np.all(box >= largest - 1e-9)
    np.testing.assert_allclose(box, largest, rtol=1e-5)
