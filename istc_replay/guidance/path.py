"""A path by arc length, and the speed laws that make a motion of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from istc_replay.datatypes import FloatArray, read_only
from istc_replay.units import wrap_angle

_REPEATED_M = 1e-3
#: How a car speeds up to its constant speed, and steps that this is summed up in.
_EASE_MPS2, _EASING = 1.0, 5
#: Where a path comes by the same place twice, a radian of heading counts as much as this; samples of it.
_HEADING_M, _PLACES_M = 3.0, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A path of box centres: `arc_m` (P,), `points_m` (P, 2), unwrapped `headings_rad` (P,)."""

    arc_m: FloatArray
    points_m: FloatArray
    headings_rad: FloatArray

    @classmethod
    def through(cls, points_m: FloatArray, headings_rad: FloatArray | None = None) -> Path:
        """Run a path through points (P, 2); without headings those of the polyline are taken.

        Points that repeat the one before (within 1 mm) are left out, so that standing still
        adds no length and no direction.
        """
        points = np.asarray(points_m, dtype=np.float64)
        keep = [0]
        for index in range(1, len(points)):
            if np.hypot(*(points[index] - points[keep[-1]])) > _REPEATED_M:
                keep.append(index)
        kept = points[keep]
        headings = polyline_headings(kept) if headings_rad is None else np.asarray(headings_rad)[keep]
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(kept, axis=0).T))])
        return cls(read_only(arc), read_only(kept), read_only(np.unwrap(headings)))

    @property
    def length_m(self) -> float:
        """Length of the path."""
        return float(self.arc_m[-1])

    def at(self, arc_m: FloatArray) -> FloatArray:
        """Poses (S, 3) at arc lengths (S,); straight on beyond the ends."""
        arc = np.asarray(arc_m, dtype=np.float64)
        inside = np.clip(arc, 0.0, self.length_m)
        heading = np.interp(inside, self.arc_m, self.headings_rad)
        beyond = arc - inside
        return np.stack(
            [
                np.interp(inside, self.arc_m, self.points_m[:, 0]) + beyond * np.cos(heading),
                np.interp(inside, self.arc_m, self.points_m[:, 1]) + beyond * np.sin(heading),
                heading,
            ],
            axis=-1,
        )

    def project(self, point_m: FloatArray) -> tuple[float, float]:
        """Arc length of the nearest point of the path, and its distance [m]."""
        if len(self.points_m) == 1:
            return 0.0, float(np.hypot(*(self.points_m[0] - point_m)))
        start, step = self.points_m[:-1], np.diff(self.points_m, axis=0)
        share = np.einsum("ij,ij->i", point_m - start, step) / np.einsum("ij,ij->i", step, step)
        nearest = start + np.clip(share, 0.0, 1.0)[:, None] * step
        distance = np.hypot(*(nearest - point_m).T)
        best = int(np.argmin(distance))
        arc = self.arc_m[best] + np.hypot(*(nearest[best] - start[best]))
        return float(arc), float(distance[best])

    def place(self, point_m: FloatArray, heading_rad: float) -> float:
        """Arc length [m] at which a car with this position and heading is most likely on its way."""
        arc = np.arange(0.0, self.length_m + _PLACES_M, _PLACES_M)
        poses = self.at(np.minimum(arc, self.length_m))
        turned = np.abs(wrap_angle(poses[:, 2] - heading_rad))
        away = np.hypot(*(poses[:, :2] - point_m).T) + _HEADING_M * turned
        return float(min(arc[int(np.argmin(away))], self.length_m))


def polyline_headings(points_m: FloatArray) -> FloatArray:
    """Headings (P,) at the vertices of a polyline: of the chord across each vertex."""
    if len(points_m) == 1:
        return np.zeros(1)
    chords = np.gradient(points_m, axis=0)
    return np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))


def constant_speed(times_s: FloatArray, speed_mps: float) -> FloatArray:
    """Arc lengths (S,) at constant speed: the paper's time law."""
    return np.asarray(speed_mps * np.asarray(times_s))


def constant_speed_then_stop(
    times_s: FloatArray, speed_mps: float, length_m: float, deceleration_mps2: float
) -> FloatArray:
    """Arc lengths (S,) at constant speed, braking to stand at the end of the path."""
    times = np.asarray(times_s, dtype=np.float64)
    speed = min(speed_mps, float(np.sqrt(2.0 * deceleration_mps2 * length_m)))
    if speed <= 0.0:
        return np.zeros_like(times)
    brake_s = speed / deceleration_mps2
    cruise_s = (length_m - speed * brake_s / 2.0) / speed
    braking = np.clip(times - cruise_s, 0.0, brake_s)
    cruising = speed * np.minimum(times, cruise_s)
    return np.asarray(cruising + speed * braking - deceleration_mps2 * braking**2 / 2.0)


def eased(
    times_s: FloatArray, start_mps: float, speed_mps: float, length_m: float, deceleration_mps2: float
) -> FloatArray:
    """Arc lengths (S,) from another speed to the constant one, braking to stand at the end of the path."""
    times = np.asarray(times_s, dtype=np.float64)
    arc, speed, here = [0.0], start_mps, 0.0
    for seconds in np.diff(times):
        step = float(seconds) / _EASING
        for _ in range(_EASING):
            speed = float(np.clip(speed_mps, speed - deceleration_mps2 * step, speed + _EASE_MPS2 * step))
            # What is left is braked on; the last millimetres are not.
            speed = min(speed, float(np.sqrt(2.0 * deceleration_mps2 * max(length_m - here, 0.0))))
            here = min(here + speed * step, length_m)
        arc.append(here)
    return np.asarray(arc)


def standing_in_the_end(times_s: FloatArray, arc_m: FloatArray, deceleration_mps2: float) -> FloatArray:
    """Arc lengths (S,) that are braked, as late as can be, to stand at the last instant."""
    left_s = times_s[-1] - np.asarray(times_s, dtype=np.float64)
    braked_m = deceleration_mps2 * (left_s[:-1] ** 2 - left_s[1:] ** 2) / 2.0
    steps = np.minimum(np.diff(arc_m), braked_m)
    return np.asarray(arc_m[0] + np.concatenate([[0.0], np.cumsum(steps)]))
