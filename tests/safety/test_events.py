"""Hysteresis of events, and the smoothing of what they are made of."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from istc_replay.config import AuditConfig
from istc_replay.safety.events import Event, find_events
from istc_replay.safety.smoothing import pieces_of, smoothed
from istc_replay.safety.vehicle_samples import fit_samples

Array = NDArray[np.float64]
NS = 1_000_000_000


def events(values: list[float], step_s: float = 0.1, keys: list[int] | None = None) -> list[Event]:
    """Events of a time to collision: 1.5 opens, 2 releases, 0.95 is severe."""
    times = np.round(np.arange(len(values)) * step_s * NS).astype(np.int64)
    return find_events(
        np.array(keys or [0] * len(values)),
        times,
        -np.asarray(values, dtype=float),
        -np.array([1.5, 0.95]),
        release=-2.0,
        bridge_ns=np.full(len(values), 0.3 * NS),
        least_samples=np.array([2, 2]),
    )


def test_an_event_opens_at_the_threshold_and_lasts_past_the_release() -> None:
    assert events([5, 1.9, 1.5, 1.2, 1.4, 1.9, 1.7, 2.1, 1.9]) == [Event(2, 3, 8, 0)]
    assert events([5, 1.9, 1.6, 1.9, 5]) == []


def test_pauses_are_bridged_and_longer_ones_are_not() -> None:
    short, long = [1.4, 1.3, 3, 3, 1.4, 1.4], [1.4, 1.3, 3, 3, 3, 1.4, 1.4]
    assert events(short) == [Event(0, 1, 5, 0)]
    assert [(e.start, e.end) for e in events(long)] == [(0, 1), (5, 6)]


def test_one_sample_is_no_event_and_one_severe_sample_no_severe_one() -> None:
    assert events([5, 1.2, 5]) == []
    assert events([1.4, 0.5, 1.4]) == [Event(0, 1, 2, 0)]
    assert events([1.4, 0.5, 0.9, 1.4]) == [Event(0, 1, 3, 1)]


def test_samples_that_do_not_follow_each_other_do_not_count_together() -> None:
    assert events([1.4, 1.9, 1.4, 1.9, 1.4]) == []
    assert events([1.4, 0.9, 1.2, 0.9, 1.4]) == [Event(0, 1, 4, 0)]


def test_what_is_not_judged_is_in_no_event_and_keys_do_not_mix() -> None:
    assert events([np.nan] * 5) == []
    assert events([1.4, 1.4, np.nan, 1.4, 1.4]) == [Event(0, 0, 4, 0)]
    assert events([1.4, 1.4, 1.4, 1.4], keys=[0, 0, 1, 1]) == [Event(0, 0, 1, 0), Event(2, 2, 3, 0)]
    assert events([]) == []


def parabolas(times: Array, values: Array, window: int) -> Array:
    """The fit of each window by numpy's own least squares: value, slope and curvature."""
    out = np.full((3, values.size), np.nan)
    half = window // 2
    for k in range(half, values.size - half):
        part = slice(k - half, k + half + 1)
        c, b, a = np.polynomial.polynomial.polyfit(times[part] - times[k], values[part], 2)
        out[:, k] = c, b, 2 * a
    return out


@pytest.mark.parametrize("window", [3, 9, 25])
def test_fits_are_those_of_least_squares(window: int) -> None:
    times = np.arange(60) * 0.1
    values = np.random.default_rng(1).normal(size=60) + 1e6
    found = smoothed(times, values, np.zeros(60, dtype=np.int64), window)
    for one, two in zip(found, parabolas(times, values - 1e6, window) + [[1e6], [0], [0]], strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-7)


def test_no_fit_reaches_across_a_gap_or_a_missing_value() -> None:
    times = np.concatenate([np.arange(20) * 0.1, 10 + np.arange(20) * 0.1])
    values = np.where(times < 5, times, 100.0 - times)
    pieces = pieces_of(np.round(times * NS).astype(np.int64), 0.3 * NS)
    _, rate, curvature = smoothed(times, values, pieces, 9)
    judged = np.isfinite(rate)
    assert judged.sum() == 2 * (20 - 8)
    np.testing.assert_allclose(np.abs(rate[judged]), 1.0)
    np.testing.assert_allclose(curvature[judged], 0.0, atol=1e-9)
    values[10] = np.nan
    assert np.isfinite(smoothed(times, values, pieces, 9)[1]).sum() == 2 + 1 + 12
    assert not np.isfinite(smoothed(times[:8], values[:8], pieces[:8], 9)[1]).any()


def test_noise_of_positions_is_held_down_as_published() -> None:
    # 2 cm at 10 Hz: 4.9 m/s^2 by second differences, 0.23 by fits of 9 samples.
    noise = np.random.default_rng(3).normal(0, 0.02, 20_000)
    times = np.arange(noise.size) * 0.1
    assert np.diff(noise, 2).std() / 0.01 == pytest.approx(4.9, rel=0.05)
    curvature = smoothed(times, noise, np.zeros(noise.size, dtype=np.int64), 9)[2]
    assert np.nanstd(curvature) == pytest.approx(0.23, rel=0.05)


def test_fits_span_time_enough_at_any_rate() -> None:
    audit = AuditConfig()
    assert [fit_samples(period, audit) for period in (1.0, 0.1, 0.033, 0.01, 0.0)] == [9, 9, 27, 81, 9]
