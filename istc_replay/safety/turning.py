"""Contacts with the yaw rates held: what a straight-line prediction of turning vehicles is worth.

At constant velocity a car in a bend points for a moment at whatever stands beside the bend. The
model of constant turn rate and velocity (Schubert, Richter and Wanielik 2008) lets each rear axle
go on along its arc. Where the straight lines meet and the arcs do not, a time to collision is told,
but counts for no more than minor.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from istc_replay.config import AuditConfig
from istc_replay.datatypes import FloatArray
from istc_replay.safety.bodies import Body
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.pair_samples import Pairs
from istc_replay.safety.vehicle_samples import Motion

IntArray = NDArray[np.int64]

#: Boxes nearer than this are in contact [m].
_CONTACT_M = 0.01
#: Steps of one pair at most; what is undecided then counts as contact.
_MOST_STEPS = 200


def with_turning(pairs: Pairs, bodies: list[Body], motions: list[Motion], audit: AuditConfig) -> Pairs:
    """The pairs with the column `ttc_turning_s`.

    It is told where a straight-line measure is serious and one of the two turns by more than
    `audit.turning_radps`; inf where no contact follows within the minor time to collision. All
    else is NaN.
    """
    required = np.fmin(pairs["required_first_mps2"], pairs["required_second_mps2"])
    serious = pairs["ttc_s"] <= audit.ttc_serious_s
    serious |= (pairs["drac_mps2"] >= audit.drac_serious_mps2) | (required >= audit.required_serious_mps2)
    rows = np.flatnonzero(serious & (pairs["gap_m"] > 0.0))
    boxes, speeds, yaw_rates, ahead = _states(pairs, rows, bodies, motions)
    turns = (np.abs(yaw_rates) > audit.turning_radps).any(axis=0) & np.isfinite(yaw_rates).all(axis=0)
    rows, boxes = rows[turns], boxes[:, turns]
    found = np.full(pairs.time_ns.size, np.nan)
    found[rows] = turning_contact(
        boxes, speeds[:, turns], yaw_rates[:, turns], ahead[:, turns], audit.ttc_minor_s
    )
    return replace(pairs, values={**pairs.values, "ttc_turning_s": found})


def _states(
    pairs: Pairs, rows: IntArray, bodies: list[Body], motions: list[Motion]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of either body at the rows: boxes (2, n, 5), speeds, yaw rates, axle to centre (2, n)."""
    boxes = np.full((2, rows.size, 5), np.nan)
    speeds, yaw_rates, ahead = (np.full((2, rows.size), np.nan) for _ in range(3))
    for side, names in enumerate((pairs.first, pairs.second)):
        who, times = names[rows], pairs.time_ns[rows]
        for body_row in np.unique(who).tolist():
            own, body = np.flatnonzero(who == body_row), bodies[body_row]
            boxes[side, own], speeds[side, own] = body.boxes(times[own])
            known, rate = body.track.times_ns, motions[body_row].yaw_rate_radps
            if body.is_vehicle:
                yaw_rates[side, own] = np.interp(times[own], known, rate)
                ahead[side, own] = body.rear_axle_to_centre_m
            else:  # who walks turns at will: straight on is as good as any arc
                yaw_rates[side, own], ahead[side, own] = 0.0, 0.0
    return boxes, speeds, yaw_rates, ahead


def turning_contact(
    boxes: FloatArray,
    speeds_mps: FloatArray,
    yaw_rates_radps: FloatArray,
    ahead_m: FloatArray,
    longest_s: float,
) -> FloatArray:
    """First contact of pairs of boxes whose rear axles go on along their arcs, by conservative steps.

    Parameters
    ----------
    boxes : ndarray
        (2, n, 5) boxes.
    speeds_mps, yaw_rates_radps, ahead_m : ndarray
        (2, n) speeds along the headings, yaw rates, and distances from rear axle to box centre.
    longest_s : float
        Contacts later than this are none.

    Returns
    -------
    ndarray
        (n,) times [s]; inf where there is none.
    """
    half = np.hypot(boxes[..., 3], boxes[..., 4]) / 2.0
    # No point of a box is faster than this, so the gap shrinks by no more.
    fastest = (np.abs(speeds_mps) + np.abs(yaw_rates_radps) * (half + np.abs(ahead_m))).sum(axis=0)
    times, found = np.zeros(boxes.shape[1]), np.full(boxes.shape[1], np.inf)
    live = np.arange(boxes.shape[1])
    for _ in range(_MOST_STEPS):
        moved = _moved(
            boxes[:, live], speeds_mps[:, live], yaw_rates_radps[:, live], ahead_m[:, live], times[live]
        )
        gap = box_gap(moved[0], moved[1])
        touching = ~(gap > _CONTACT_M)
        found[live[touching]] = times[live[touching]]
        times[live] += gap / np.maximum(fastest[live], 1e-9)
        live = live[~touching & (times[live] <= longest_s)]
        if not live.size:
            return found
    found[live] = times[live]
    return found


def _moved(
    boxes: FloatArray, speeds: FloatArray, yaw_rates: FloatArray, ahead: FloatArray, times: FloatArray
) -> FloatArray:
    """(2, n, 5) boxes after the times (n,)."""
    x, y, heading = boxes[..., 0], boxes[..., 1], boxes[..., 2]
    turned = heading + yaw_rates * times
    # The chord of the arc: 2 v / w sin(w t / 2), along the mean heading.
    half_turn = yaw_rates * times / 2.0
    chord = speeds * times * np.sinc(half_turn / np.pi)
    middle = heading + half_turn
    moved = boxes.copy()
    moved[..., 0] = x - ahead * np.cos(heading) + chord * np.cos(middle) + ahead * np.cos(turned)
    moved[..., 1] = y - ahead * np.sin(heading) + chord * np.sin(middle) + ahead * np.sin(turned)
    moved[..., 2] = turned
    return moved
