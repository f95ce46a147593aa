"""How two vehicles meet: conflict type, headway along the path, and the speed changes of a collision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray
from istc_replay.units import wrap_angle

#: Types by the angle between the courses, in the order of the limits between them.
CONFLICT_TYPES = ("rear_end", "lane_change", "crossing", "head_on")


def conflict_angle(first_course_rad: FloatArray, second_course_rad: FloatArray) -> FloatArray:
    """Angle between two courses, in [0, pi] [rad]."""
    return np.asarray(np.abs(wrap_angle(second_course_rad - first_course_rad)))


def conflict_type(angle_rad: FloatArray, limits_rad: tuple[float, float, float]) -> NDArray[np.int64]:
    """Index into CONFLICT_TYPES of angles between courses, -1 where an angle is NaN.

    Below the first limit two vehicles follow each other (rear end), up to the second one changes
    lanes, up to the third their courses cross, and above it they meet head on.
    """
    kind = np.searchsorted(np.asarray(limits_rad), angle_rad, side="right")
    # SSAM counts 30 degrees as a lane change, and 85 degrees as one still.
    kind = np.where(angle_rad == limits_rad[1], 1, kind)
    kind = np.where(angle_rad == limits_rad[2], 2, kind)
    return np.where(np.isnan(angle_rad), -1, kind)


def headway(
    follower: FloatArray,
    leader: FloatArray,
    speed_mps: FloatArray,
    *,
    moving_mps: float,
    same_path_rad: float,
) -> tuple[FloatArray, FloatArray]:
    """Bumper gap along the path, and the time headway of a follower.

    The path is the circular arc that leaves the follower's centre along its course and leads to
    the leader's: on it the leader's course differs by twice its bearing. What is left of the
    leader's offset across is |y - x tan(turn / 2)|; with less than half of both widths of it, the
    two are on the same path.

    Parameters
    ----------
    follower, leader : ndarray
        (n, 5) boxes, their headings turned to their courses.
    speed_mps : ndarray
        (n,) the follower's speed.
    moving_mps : float
        A slower follower has no headway.
    same_path_rad : float
        Vehicles whose courses differ by more are not on the same path.

    Returns
    -------
    gap_m, headway_s : ndarray
        (n,) each; NaN where the two are not on the same path, or a value is NaN.
    """
    turn = wrap_angle(leader[:, 2] - follower[:, 2])
    dx, dy = (leader[:, :2] - follower[:, :2]).T
    c, s = np.cos(follower[:, 2]), np.sin(follower[:, 2])
    x, y = c * dx + s * dy, c * dy - s * dx
    across = np.abs(y - x * np.tan(turn / 2.0))
    half = turn / 2.0
    arc = np.hypot(x, y) / np.sinc(half / np.pi)
    gap = arc - (follower[:, 3] + leader[:, 3]) / 2.0
    on_path = (x > 0.0) & (np.abs(turn) < same_path_rad) & (across < (follower[:, 4] + leader[:, 4]) / 2.0)
    gap = np.where(on_path, np.maximum(gap, 0.0), np.nan)
    moving = speed_mps >= moving_mps
    return gap, np.where(moving, gap / np.where(moving, speed_mps, 1.0), np.nan)


def delta_v(first: FloatArray, second: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Changes of speed of two vehicles that collide and stay together [m/s].

    The masses are as the boxes' areas: dv_1 = m_2 / (m_1 + m_2) |v|.

    Parameters
    ----------
    first, second : ndarray
        (n, 5) boxes.
    velocity : ndarray
        (n, 2) relative velocity.
    """
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    share = second[:, 3] * second[:, 4] / (first[:, 3] * first[:, 4] + second[:, 3] * second[:, 4])
    return share * speed, (1.0 - share) * speed
