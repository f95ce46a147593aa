"""The car-box of eq. (7), against every heading that it must hold."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from istc_replay.corridors.blocks import car_box_m, make_block


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


def test_the_start_box_is_the_cars_own_and_those_after_it_hold_the_slack(
    crossing: Callable[..., Any],
) -> None:
    case = crossing(1, vehicles=1, units=3)
    (participant,), (guide,) = case.scenario.participants, case.guidance
    half = make_block(participant, guide, 0.2, 0).half_gamma_m
    heading, size = participant.start.heading_rad, participant.dimensions
    c, s = abs(np.cos(heading)), abs(np.sin(heading))
    own = [size.length_m * c + size.width_m * s, size.length_m * s + size.width_m * c]
    np.testing.assert_allclose(2.0 * half[0], own)
    np.testing.assert_allclose(
        2.0 * half[1:], car_box_m(guide.headings_rad[1:], 0.2, size.length_m, size.width_m)
    )
    assert (half[1:] > half[0] + 0.05).all()
