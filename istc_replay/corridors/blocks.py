"""The variables of one vehicle, and the car-box of eq. (7) that its cubes have room for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from istc_replay.corridors.problem import CONSTANT, Block
from istc_replay.datatypes import FloatArray, read_only
from istc_replay.geometry import box_corners

if TYPE_CHECKING:
    from istc_replay.datatypes import Guidance, Participant


def make_block(
    participant: Participant, guide: Guidance, heading_slack_rad: float | FloatArray, offset: int
) -> Block:
    """Lay out one vehicle's variables from `offset` on."""
    units = participant.units
    pivot = np.full((units + 1, 2), CONSTANT, dtype=np.int64)
    pivot[1:] = offset + np.arange(2 * units).reshape(units, 2)
    cube = offset + 2 * units + np.arange(4 * units).reshape(units, 4)
    size = participant.dimensions
    start = participant.start
    half = car_box_m(guide.headings_rad, heading_slack_rad, size.length_m, size.width_m) / 2.0
    corners = box_corners(0.0, 0.0, start.heading_rad, size.length_m, size.width_m)
    half[0] = np.ptp(corners, axis=0) / 2.0
    return Block(
        vehicle_id=participant.vehicle_id,
        priority=participant.priority,
        first_unit=participant.first_unit,
        units=units,
        start_m=read_only([start.x_m, start.y_m]),
        reference_m=guide.points_m,
        half_gamma_m=read_only(half),
        pivot=pivot,
        cube=cube,
    )


def car_box_m(
    headings_rad: FloatArray, slack_rad: float | FloatArray, length_m: float, width_m: float
) -> FloatArray:
    """Extents (K+1, 2) of the car-box that holds the car at any heading within the slack, eq. (7)."""
    diagonal = np.arctan2(width_m, length_m)

    def extent(headings: FloatArray, peak: float) -> FloatArray:
        # l|cos| + w|sin| peaks at +-atan(w/l) modulo pi; elsewhere an end of the range is largest.
        ends = np.stack([headings - slack_rad, headings + slack_rad])
        largest = (length_m * np.abs(np.cos(ends)) + width_m * np.abs(np.sin(ends))).max(axis=0)
        for angle in (peak, -peak):
            off = np.abs((headings - angle + np.pi / 2) % np.pi - np.pi / 2)
            largest = np.where(off <= slack_rad, np.hypot(length_m, width_m), largest)
        return np.asarray(largest)

    headings = np.asarray(headings_rad)
    return np.stack([extent(headings, diagonal), extent(headings - np.pi / 2, diagonal)], axis=-1)
