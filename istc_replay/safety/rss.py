"""Responsibility-sensitive safety (Shalev-Shwartz, Shammah and Shashua 2017) for pairs of boxes.

A pair is in danger where its distance along and its distance across are both unsafe. Logs tell no
lanes, so along and across are the axes of either vehicle in turn, and danger is what both say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray
from istc_replay.units import wrap_angle


@dataclass(frozen=True, slots=True)
class RssParameters:
    """The response time and the accelerations that everybody is taken to keep to."""

    response_s: float
    acceleration_mps2: float
    least_braking_mps2: float
    most_braking_mps2: float
    correct_braking_mps2: float
    lateral_acceleration_mps2: float
    lateral_braking_mps2: float
    margin_m: float


def safe_distance_same(rear_mps: FloatArray, front_mps: FloatArray, rss: RssParameters) -> FloatArray:
    """Safe distance along of two vehicles in one direction, Lemma 2 [m]."""
    rho, after = rss.response_s, rear_mps + rss.response_s * rss.acceleration_mps2
    way = (
        rear_mps * rho
        + rss.acceleration_mps2 * rho**2 / 2.0
        + after**2 / (2.0 * rss.least_braking_mps2)
        - front_mps**2 / (2.0 * rss.most_braking_mps2)
    )
    return np.maximum(way, 0.0)


def safe_distance_opposite(correct_mps: FloatArray, wrong_mps: FloatArray, rss: RssParameters) -> FloatArray:
    """Safe distance along of two vehicles towards each other, Definition 4 [m].

    Both speeds are positive; the first vehicle is in its own lane and brakes gently.
    """
    way = np.zeros(np.broadcast_shapes(np.shape(correct_mps), np.shape(wrong_mps)))
    for speed, braking in ((correct_mps, rss.correct_braking_mps2), (wrong_mps, rss.least_braking_mps2)):
        after = speed + rss.response_s * rss.acceleration_mps2
        way = way + (speed + after) / 2.0 * rss.response_s + after**2 / (2.0 * braking)
    return way


def safe_distance_lateral(left_mps: FloatArray, right_mps: FloatArray, rss: RssParameters) -> FloatArray:
    """Safe distance across, Definition 6 [m].

    Velocities across, positive from the first vehicle towards the second. Who moves away after the response
    time needs no room to brake in: the printed square, which has no sign, holds for who comes nearer.
    """
    rho, gain = rss.response_s, rss.response_s * rss.lateral_acceleration_mps2
    one, two = left_mps + gain, right_mps - gain
    twice = 2.0 * rss.lateral_braking_mps2
    closing = ((left_mps + one) / 2.0 * rho + np.maximum(one, 0.0) ** 2 / twice) - (
        (right_mps + two) / 2.0 * rho - np.minimum(two, 0.0) ** 2 / twice
    )
    return np.asarray(rss.margin_m + np.maximum(closing, 0.0))


def rss_margin(
    first: FloatArray,
    second: FloatArray,
    speeds: tuple[FloatArray, FloatArray],
    rss: RssParameters,
    limits_rad: tuple[float, float],
) -> FloatArray:
    """By how much a pair keeps RSS [m]: the better of distance less safe distance, along and across.

    Parameters
    ----------
    first, second : ndarray
        (n, 5) boxes, their headings turned to their courses.
    speeds : (ndarray, ndarray)
        (n,) each, not negative [m/s].
    rss : RssParameters
        The parameters.
    limits_rad : (float, float)
        Courses that differ by less than the first go the same way, by more than the second
        opposite ways; between them lanes would be needed, and the pair is not judged.

    Returns
    -------
    ndarray
        (n,) margins, negative in danger; NaN where not judged.
    """
    turn = wrap_angle(second[:, 2] - first[:, 2])
    same, opposite = np.abs(turn) < limits_rad[0], np.abs(turn) > limits_rad[1]
    one = _margin(first, second, speeds, rss, opposite)
    two = _margin(second, first, speeds[::-1], rss, opposite)
    return np.where(same | opposite, np.maximum(one, two), np.nan)


def _margin(
    own: FloatArray,
    other: FloatArray,
    speeds: tuple[FloatArray, FloatArray],
    rss: RssParameters,
    opposite: NDArray[np.bool_],
) -> FloatArray:
    """The margin along the axes of `own`."""
    turn = wrap_angle(other[:, 2] - own[:, 2])
    dx, dy = (other[:, :2] - own[:, :2]).T
    c, s = np.cos(own[:, 2]), np.sin(own[:, 2])
    x, y = c * dx + s * dy, c * dy - s * dx
    ct, st = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    along = np.abs(x) - (own[:, 3] + other[:, 3] * ct + other[:, 4] * st) / 2.0
    across = np.abs(y) - (own[:, 4] + other[:, 3] * st + other[:, 4] * ct) / 2.0
    forward = speeds[1] * np.cos(turn)
    behind = x >= 0.0  # the own vehicle is the rear one
    rear, front = np.where(behind, speeds[0], forward), np.where(behind, forward, speeds[0])
    safe_along = safe_distance_same(np.maximum(rear, 0.0), np.maximum(front, 0.0), rss)
    towards = np.maximum(
        safe_distance_opposite(speeds[0], np.abs(forward), rss),
        safe_distance_opposite(np.abs(forward), speeds[0], rss),
    )
    # Once they have passed, opposite ways only lead apart.
    safe_along = np.where(opposite, np.where(behind, towards, -np.inf), safe_along)
    sideways = speeds[1] * np.sin(turn) * np.where(y >= 0.0, 1.0, -1.0)
    safe_across = safe_distance_lateral(np.zeros_like(sideways), sideways, rss)
    return np.asarray(np.maximum(along - safe_along, across - safe_across))
