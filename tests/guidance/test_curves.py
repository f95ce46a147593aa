"""Curves of continuous curvature, against independent integration."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from istc_replay.datatypes import FloatArray, read_only
from istc_replay.guidance.curves import Curve, Pose, smooth_curve

RAMP_M = 4.0


def stepped(curve: Curve, step_m: float = 1e-3) -> FloatArray:
    """The curve's end by the midpoint rule, from its curvature alone."""
    count = math.ceil(curve.length_m / step_m)
    s = (np.arange(count) + 0.5) * curve.length_m / count
    kappa = np.interp(s, curve.breaks_m, curve.curvatures_1pm)
    ds = curve.length_m / count
    heading = curve.start.heading_rad + (np.cumsum(kappa) - kappa / 2) * ds
    end = [curve.start.x_m + np.cos(heading).sum() * ds, curve.start.y_m + np.sin(heading).sum() * ds]
    return np.array([*end, curve.start.heading_rad + kappa.sum() * ds])


def test_a_straight_curve_is_a_straight_line() -> None:
    curve = Curve(Pose(1.0, 2.0, math.pi / 2), read_only([0.0, 10.0]), read_only([0.0, 0.0]))
    np.testing.assert_allclose(
        curve.points([-3.0, 0.0, 4.0, 12.0]), [[1, -1], [1, 2], [1, 6], [1, 14]], atol=1e-12
    )


def test_an_arc_is_a_circle() -> None:
    curve = Curve(Pose(0.0, 0.0, 0.0), read_only([0.0, 60.0]), read_only([0.2, 0.2]))
    points = curve.points(np.linspace(0.0, 60.0, 301))
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1] - 5.0), 5.0, atol=1e-11)


@given(
    lengths=st.lists(st.floats(0.0, 20.0), min_size=1, max_size=4),
    signs=st.lists(st.sampled_from([-1.0, 0.0, 1.0]), min_size=4, max_size=4),
    radius=st.floats(4.0, 10.0),
)
def test_a_smooth_curve_turns_as_far_as_its_arcs_and_never_tighter(
    lengths: list[float], signs: list[float], radius: float
) -> None:
    curvatures = np.array(signs[: len(lengths)]) / radius
    curve = smooth_curve(Pose(3.0, -1.0, 0.4), lengths, curvatures, RAMP_M)
    assert curve.length_m == pytest.approx(sum(lengths) + RAMP_M)
    assert curve.heading(curve.length_m) - 0.4 == pytest.approx(float(np.dot(lengths, curvatures)), abs=1e-9)
    assert np.abs(curve.curvatures_1pm).max() <= 1.0 / radius + 1e-12
    assert curve.curvatures_1pm[[0, -1]] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(curve.poses([curve.length_m])[0], stepped(curve), atol=1e-5)


def test_heading_and_points_agree_everywhere_along_a_curve() -> None:
    curve = smooth_curve(Pose(0.0, 0.0, 1.0), [5.0, 9.0, 3.0], [0.15, -0.15, 0.1], RAMP_M)
    s = np.linspace(0.0, curve.length_m, 2001)
    step = np.diff(curve.points(s), axis=0)
    middle = (s[1:] + s[:-1]) / 2
    np.testing.assert_allclose(np.hypot(*step.T), np.diff(s), rtol=1e-5)
    np.testing.assert_allclose(
        np.unwrap(np.arctan2(step[:, 1], step[:, 0])), curve.heading(middle), atol=1e-5
    )
    without_break = np.diff(np.searchsorted(curve.breaks_m, s)) == 0
    slopes = np.diff(curve.curvature(s)) / np.diff(s)
    np.testing.assert_allclose(slopes[without_break], curve.sharpness(middle)[without_break], atol=1e-9)
