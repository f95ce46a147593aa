"""The continuous motion that a plan's controls cause: the kinematic bicycle, eq. (17), re-integrated.

Time is cut into P pieces at every knot and every unit boundary, the same for all V vehicles, so
that in one piece every control is held and every corridor-cube stays. Steering, speed and
acceleration are then exact polynomials; the pose follows by classical RK4 in n substeps. The
heading's rate depends on time alone, and the position's on time and heading, so RK4 is a sum of
known terms and all steps are taken at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray
from istc_replay.safety.plan import IntArray, VehiclePlan
from istc_replay.units import NS_PER_S

#: Beyond this steering angle the bicycle's tan(delta) means nothing.
_STEERING_SENSE_RAD = 1.5
#: Vehicles x nodes kept in memory, and how often the substeps are halved for accuracy.
_MOST_NODES = 2_000_000
_HALVINGS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Re-integrated motions, rear axle, corridor frame; NaN where a vehicle is not there.

    `edges_ns` (P+1,) piece boundaries from the window's start, `edges_s` the same in seconds.
    `dimensions` (V, 4): length, width, wheelbase, rear axle to centre [m]. `present` (V, P).
    `nodes` (V, P, n+1, 6): x, y, heading, steering, speed, acceleration. `controls` (V, P, 2):
    steering rate and jerk. `bounds` (V, P, 4): the largest |v|, |a|, |w| and |dw/dt| of the piece,
    w the yaw rate. `error_m` (V,) bounds the integration's error at any point of a box. `judged`
    (V,) says where all of this is finite and accurate.
    """

    edges_ns: IntArray
    edges_s: FloatArray
    dimensions: FloatArray
    present: NDArray[np.bool_]
    nodes: FloatArray
    controls: FloatArray
    bounds: FloatArray
    error_m: FloatArray
    judged: NDArray[np.bool_]

    @property
    def durations_s(self) -> FloatArray:
        """(P,) lengths of the pieces [s]."""
        return np.diff(self.edges_s)

    def at(self, vehicle: IntArray, piece: IntArray, offset_s: FloatArray) -> FloatArray:
        """(m, 6) states of the vehicles at offsets from the starts of the pieces."""
        substeps = self.nodes.shape[2] - 1
        step = self.durations_s[piece] / substeps
        node = np.clip(offset_s // step, 0, substeps - 1).astype(np.int64)
        held, wheelbase = self.controls[vehicle, piece], self.dimensions[vehicle, 2]
        return _advance(self.nodes[vehicle, piece, node], held, wheelbase, offset_s - node * step)

    def sample(
        self, vehicle: IntArray, piece: IntArray, offset_s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Boxes (m, 5) as `box_gap` takes them, and velocities (m, 2) of their centres."""
        states, dimensions = self.at(vehicle, piece, offset_s), self.dimensions[vehicle]
        c, s = np.cos(states[:, 2]), np.sin(states[:, 2])
        sway = dimensions[:, 3] * _turn_rate(states, dimensions[:, 2])
        velocities = np.column_stack([states[:, 4] * c - sway * s, states[:, 4] * s + sway * c])
        return boxes_of(states, dimensions), velocities

    def point_acceleration(self, reach_m: FloatArray) -> FloatArray:
        """(V, P) bounds of the acceleration of points `reach_m` (V,) from the rear axle."""
        speed, acceleration, turn, turn_rate = np.moveaxis(self.bounds, -1, 0)
        return np.asarray(acceleration + speed * turn + reach_m[:, None] * (turn_rate + turn**2))


def integrate(
    plans: Sequence[VehiclePlan], edges_ns: IntArray, step_s: float, tolerance_m: float
) -> Motion | None:
    """Integrate from the first knots alone with the held controls.

    The integration runs with substeps h <= step_s and h / 2 and keeps the second; their largest
    difference bounds its error. Where that is above the tolerance, h is halved again.

    Parameters
    ----------
    plans : sequence of VehiclePlan
        Every knot must be an edge; there may be none.
    edges_ns : ndarray
        (P+1,) increasing times that cut the window into pieces.
    step_s, tolerance_m : float
        Longest substep [s], and error allowed in any point of a box [m].

    Returns
    -------
    Motion or None
        None where the nodes would be too many to keep.
    """
    edges_s = edges_ns / NS_PER_S
    present, first, controls, dimensions = _held(plans, edges_ns)
    durations = np.where(present, np.diff(edges_s), 0.0)
    substeps = max(1, int(min(np.ceil(durations.max(initial=0.0) / step_s * (1.0 - 1e-9)), _MOST_NODES)))
    if present.size * (2 * substeps + 1) > _MOST_NODES:
        return None
    with np.errstate(all="ignore"):
        starts = _starts(first, controls, durations)
        coarse = _nodes(starts, controls, dimensions, durations, substeps)
        for _ in range(_HALVINGS):
            substeps *= 2
            nodes = _nodes(starts, controls, dimensions, durations, substeps)
            error = _difference(coarse, nodes[:, :, ::2], dimensions, present)
            inaccurate = np.isfinite(error) & (error > tolerance_m)
            if not inaccurate.any() or present.size * (2 * substeps + 1) > _MOST_NODES:
                break
            coarse = nodes
        bounds = _bounds(starts, controls, dimensions, durations)
    nodes[~present], bounds[~present] = np.nan, np.nan
    finite = (np.isfinite(bounds).all(axis=2) & np.isfinite(nodes).all(axis=(2, 3))) | ~present
    judged = finite.all(axis=1) & (error <= tolerance_m)
    return Motion(edges_ns, edges_s, dimensions, present, nodes, controls, bounds, error, judged)


def boxes_of(states: FloatArray, dimensions: FloatArray) -> FloatArray:
    """Boxes (..., 5) as `box_gap` takes them, of rear-axle states (..., 6) and dimensions (..., 4)."""
    ahead, heading = dimensions[..., 3], states[..., 2]
    x, y = states[..., 0] + ahead * np.cos(heading), states[..., 1] + ahead * np.sin(heading)
    return np.stack(np.broadcast_arrays(x, y, heading, dimensions[..., 0], dimensions[..., 1]), axis=-1)


def _held(
    plans: Sequence[VehiclePlan], edges_ns: IntArray
) -> tuple[NDArray[np.bool_], FloatArray, FloatArray, FloatArray]:
    """Presence (V, P), first rear-axle states (V, 6), held controls (V, P, 2), dimensions (V, 4)."""
    pieces = edges_ns.size - 1
    present = np.zeros((len(plans), pieces), dtype=bool)
    controls = np.zeros((len(plans), pieces, 2))
    first = np.array([plan.states[0] for plan in plans]).reshape(-1, 6)
    dimensions = np.array([plan.dimensions for plan in plans]).reshape(-1, 4)
    for row, plan in enumerate(plans):
        begin, end = np.searchsorted(edges_ns, plan.knots_ns[[0, -1]])
        held = np.searchsorted(plan.knots_ns, edges_ns[begin:end], side="right") - 1
        present[row, begin:end] = True
        controls[row, begin:end] = plan.controls[held]
    first[:, 0] -= dimensions[:, 3] * np.cos(first[:, 2])
    first[:, 1] -= dimensions[:, 3] * np.sin(first[:, 2])
    return present, first, controls, dimensions


def _starts(first: FloatArray, controls: FloatArray, durations: FloatArray) -> FloatArray:
    """(V, P, 6) states at the starts of the pieces; the pose still the first, the rest exact."""
    rate, jerk = controls[..., 0], controls[..., 1]
    starts = np.repeat(first[:, None], controls.shape[1], axis=1)
    starts[..., 3] += _before(rate * durations)
    starts[..., 5] += _before(jerk * durations)
    starts[..., 4] += _before(starts[..., 5] * durations + jerk * durations**2 / 2.0)
    return starts


def _before(increments: FloatArray) -> FloatArray:
    """Sums of the increments before each place, along the last axis."""
    return np.asarray(np.cumsum(increments, axis=-1) - increments)


def _nodes(
    starts: FloatArray, controls: FloatArray, dimensions: FloatArray, durations: FloatArray, substeps: int
) -> FloatArray:
    """(V, P, substeps + 1, 6) states at the nodes."""
    held, wheelbase = controls[:, :, None], dimensions[:, 2, None, None]
    step = (durations / substeps)[..., None]
    nodes = _polynomials(starts[:, :, None], held, step * np.arange(substeps + 1))
    shape = nodes.shape[:2]
    before = nodes[:, :, :-1]
    flat = (shape[0], shape[1] * substeps)
    for increments in (_turned, _travelled):
        # The heading's increments first: the position's depend on the headings.
        for column, values in increments(before, held, wheelbase, step).items():
            sums = np.cumsum(values.reshape(flat), axis=1).reshape(*shape, substeps)
            nodes[..., 1:, column] += sums
            nodes[:, 1:, 0, column] += sums[:, :-1, -1]
    return nodes


def _advance(states: FloatArray, held: FloatArray, wheelbase: FloatArray, step: FloatArray) -> FloatArray:
    """One RK4 step of (..., 6) states under held controls."""
    after = _polynomials(states, held, step)
    for increments in (_turned, _travelled):
        for column, values in increments(states, held, wheelbase, step).items():
            after[..., column] += values
    return after


def _polynomials(states: FloatArray, held: FloatArray, step: FloatArray) -> FloatArray:
    """Steering, speed and acceleration after the step, exact; the pose unchanged."""
    shape = np.broadcast_shapes(states.shape[:-1], held.shape[:-1], np.shape(step))
    after = np.empty((*shape, 6))
    after[...] = states
    after[..., 3] += held[..., 0] * step
    after[..., 4] += states[..., 5] * step + held[..., 1] * step**2 / 2.0
    after[..., 5] += held[..., 1] * step
    return after


def _turn_rate(states: FloatArray, wheelbase: FloatArray) -> FloatArray:
    return np.asarray(states[..., 4] * np.tan(states[..., 3]) / wheelbase)


def _turned(
    states: FloatArray, held: FloatArray, wheelbase: FloatArray, step: FloatArray
) -> dict[int, FloatArray]:
    """RK4 of the heading, whose rate depends on time alone (Simpson's rule)."""
    rates = [_turn_rate(_polynomials(states, held, share * step), wheelbase) for share in (0.0, 0.5, 1.0)]
    return {2: step * (rates[0] + 4.0 * rates[1] + rates[2]) / 6.0}


def _travelled(
    states: FloatArray, held: FloatArray, wheelbase: FloatArray, step: FloatArray
) -> dict[int, FloatArray]:
    """RK4 of the position."""
    middle, end = (_polynomials(states, held, share * step) for share in (0.5, 1.0))
    first, second = _turn_rate(states, wheelbase), _turn_rate(middle, wheelbase)
    stages = [
        (1.0, states[..., 4], states[..., 2]),
        (2.0, middle[..., 4], states[..., 2] + step / 2.0 * first),
        (2.0, middle[..., 4], states[..., 2] + step / 2.0 * second),
        (1.0, end[..., 4], states[..., 2] + step * second),
    ]
    return {
        0: step / 6.0 * sum(weight * speed * np.cos(heading) for weight, speed, heading in stages),
        1: step / 6.0 * sum(weight * speed * np.sin(heading) for weight, speed, heading in stages),
    }


def _difference(
    coarse: FloatArray, fine: FloatArray, dimensions: FloatArray, present: NDArray[np.bool_]
) -> FloatArray:
    """(V,) largest distance of any point of a box between two integrations."""
    change = np.abs(fine - coarse)
    reach = np.hypot(np.abs(dimensions[:, 3]) + dimensions[:, 0] / 2.0, dimensions[:, 1] / 2.0)
    distance = np.hypot(change[..., 0], change[..., 1]) + reach[:, None, None] * change[..., 2]
    largest = np.where(present[:, :, None], distance, 0.0).max(axis=(1, 2), initial=0.0)
    return np.where(np.isfinite(largest), largest, np.inf)


def _bounds(
    starts: FloatArray, controls: FloatArray, dimensions: FloatArray, durations: FloatArray
) -> FloatArray:
    """(V, P, 4) bounds of |v|, |a|, |w|, |dw/dt| over the pieces, w = v tan(delta) / wheelbase."""
    ends = _polynomials(starts, controls, durations)
    turning = _polynomials(starts, controls, speed_extreme_s(starts, controls, durations))
    largest = np.maximum.reduce([np.abs(starts), np.abs(ends), np.abs(turning)])
    steering, speed, acceleration = largest[..., 3], largest[..., 4], largest[..., 5]
    wheelbase = dimensions[:, 2, None]
    slope = np.where(steering < _STEERING_SENSE_RAD, np.tan(steering), np.inf)
    turn = speed * slope / wheelbase
    turn_rate = (acceleration * slope + speed * np.abs(controls[..., 0]) * (1.0 + slope**2)) / wheelbase
    return np.stack([speed, acceleration, turn, turn_rate], axis=-1)


def speed_extreme_s(starts: FloatArray, controls: FloatArray, durations: FloatArray) -> FloatArray:
    """(V, P) offsets within the pieces at which the speed may be extreme: where a + j t = 0 [s]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = -starts[..., 5] / controls[..., 1]
    return np.clip(np.where(np.isfinite(offset), offset, 0.0), 0.0, durations)
