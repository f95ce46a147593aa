"""One vehicle's task: its corridor about its own start, its limits, and a first guess."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from istc_replay.config import TrajectoriesConfig
from istc_replay.datatypes import (
    Corridor,
    Dimensions,
    FloatArray,
    Guidance,
    Participant,
    StartState,
    Undrivable,
)
from istc_replay.errors import SolveError
from istc_replay.geometry import shift_along
from istc_replay.trajectories.nlp import NlpData
from istc_replay.trajectories.walls import SIDES, Grid, base_margins, box_extents, walls_at

#: How far a start may miss a limit or its first cube and still be taken as within.
_ROUNDING = 1e-6
#: Recorded speeds above this are the jitter of a standing car, not reversing.
_STANDING_MPS = -0.1
WALLS = ("x_min", "x_max", "y_min", "y_max")


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """The NLP's numbers for one vehicle, moved so that the car-box starts at the origin.

    `cubes_m` (K, 4), `pivots_m` (K+1, 2), `headings_rad` (K+1,) of the start and then of the
    guidance, unwrapped; `origin_m` (2,) where the start lies in the corridor frame. Who goes on beyond the
    window has to stand at its end.
    """

    vehicle_id: str
    first_unit: int
    grid: Grid
    dimensions: Dimensions
    start: StartState
    origin_m: FloatArray
    cubes_m: FloatArray
    pivots_m: FloatArray
    headings_rad: FloatArray
    speed_max_mps: float
    stands_at_end: bool = False

    @classmethod
    def of(
        cls,
        participant: Participant,
        corridor: Corridor,
        guidance: Guidance,
        grid: Grid,
        speed_max_mps: float,
    ) -> Task:
        """Collect a vehicle's numbers.

        Raises
        ------
        SolveError
            If shapes do not match or a number is not finite.
        """
        start = participant.start
        units = grid.units
        origin = np.array([start.x_m, start.y_m])
        headings = np.unwrap(np.concatenate([[start.heading_rad], guidance.headings_rad[1:]]))
        pivots = np.asarray(corridor.pivots_m) - origin
        shapes = (corridor.cubes_m.shape, pivots.shape, headings.shape)
        if units < 1 or shapes != ((units, 4), (units + 1, 2), (units + 1,)):
            raise SolveError(
                f"vehicle {corridor.vehicle_id}: cubes, pivots and headings of shapes {shapes} do not make a "
                "corridor of K >= 1 cubes: give (K, 4), (K+1, 2) and (K+1,)"
            )
        numbers = (corridor.cubes_m, pivots, headings, (start.speed_mps, speed_max_mps))
        if not all(np.isfinite(part).all() for part in numbers):
            raise SolveError(
                f"vehicle {corridor.vehicle_id}: its start, corridor or guidance holds a number that "
                "is not finite: leave the vehicle out"
            )
        cubes = np.asarray(corridor.cubes_m) - np.repeat(origin, 2)
        box = box_extents(np.zeros(2), np.asarray(start.heading_rad), participant.dimensions)
        if (SIDES * (box - cubes[0])).max() <= _ROUNDING:
            cubes[0] = SIDES * np.maximum(SIDES * cubes[0], SIDES * box)
        return cls(
            vehicle_id=corridor.vehicle_id,
            first_unit=corridor.first_unit,
            grid=grid,
            dimensions=participant.dimensions,
            start=start,
            origin_m=origin,
            cubes_m=cubes,
            pivots_m=pivots,
            headings_rad=headings,
            speed_max_mps=speed_max_mps,
            stands_at_end=participant.goes_on,
        )

    def start_fault(self, config: TrajectoriesConfig) -> Undrivable | None:
        """What makes the start itself impossible, or None."""
        start, braking = self.start, config.deceleration_max_mps2
        limits = (
            ("speed", start.speed_mps, _STANDING_MPS, self.speed_max_mps, "m/s"),
            ("steering", start.steering_rad, -config.steering_max_rad, config.steering_max_rad, "rad"),
            ("acceleration", start.acceleration_mps2, -braking, config.acceleration_max_mps2, "m/s^2"),
        )
        for name, value, low, high, unit in limits:
            if value is not None and not low - _ROUNDING <= value <= high + _ROUNDING:
                detail = f"it starts with {name} {value:.3f} {unit}, outside [{low:.3f}, {high:.3f}]"
                return self.undrivable(0, 0.0, detail)
        box = box_extents(np.zeros(2), np.asarray(start.heading_rad), self.dimensions)
        out = SIDES * (box - self.cubes_m[0])
        if out.max() > _ROUNDING:
            where = f"{out.max():.3f} m at {WALLS[int(out.argmax())]}"
            return self.undrivable(
                0, float(out.max()), f"its start box sticks out of its first cube by {where}"
            )
        return None

    def undrivable(self, row: int, slack_m: float, detail: str) -> Undrivable:
        """The diagnosis at one cube of the corridor."""
        return Undrivable(self.vehicle_id, self.first_unit + row, slack_m, detail)

    def data(self, config: TrajectoriesConfig, margin_m: float, extra_m: FloatArray) -> NlpData:
        """Bounds and parameters of the NLP, eq. (18) and (19); `extra_m` (S-1, 4) is added to the margins."""
        margins = base_margins(self.cubes_m, self.pivots_m, self.headings_rad, self.dimensions, margin_m)
        lower, upper = self._state_bounds(config)
        return NlpData(
            dimensions=self.dimensions,
            lower=lower,
            upper=upper,
            walls_m=walls_at(self.grid, self.cubes_m, margins, extra_m),
            targets_m=self._over_time(self.pivots_m),
        )

    def first_guess(self, config: TrajectoriesConfig) -> tuple[FloatArray, FloatArray]:
        """States (S, 6) and controls (S-1, 2): pivotal points and guidance headings, linear in time."""
        grid = self.grid
        centres = self._over_time(self.pivots_m)
        headings = self._over_time(self.headings_rad)
        axle = shift_along(centres[:, 0], centres[:, 1], headings, -self.dimensions.rear_axle_to_centre_m)
        steps = np.hypot(*np.diff(self.pivots_m, axis=0).T) / grid.unit_s  # (K,)
        boundary = np.concatenate([[self.start.speed_mps], (steps[:-1] + steps[1:]) / 2, steps[-1:]])
        speeds = np.clip(self._over_time(boundary), 0.0, self.speed_max_mps)
        turning = np.gradient(headings, grid.step_s) / np.maximum(speeds, 1.0)
        most = 0.9 * config.steering_max_rad
        steering = np.clip(np.arctan(turning * self.dimensions.wheelbase_m), -most, most)
        states = np.column_stack([axle, headings, steering, speeds, np.zeros_like(speeds)])
        return states, np.zeros((grid.intervals, 2))

    def costs(
        self, states: FloatArray, controls: FloatArray, config: TrajectoriesConfig
    ) -> tuple[float, float, float]:
        """Eq. (13), (14), (15) of states (S, 6) and controls (S-1, 2) at the grid's knots."""
        x, y, heading, steering = states[:, :4].T
        off = shift_along(x, y, heading, self.dimensions.rear_axle_to_centre_m) - self._over_time(
            self.pivots_m
        )
        curvature = np.tan(steering) / self.dimensions.wheelbase_m
        comfort = [config.steering_rate_weight, config.jerk_weight] @ (controls**2).sum(axis=0)
        pivotal = [config.pivotal_x_weight, config.pivotal_y_weight] @ (off**2).sum(axis=0)
        return config.curvature_weight * float(curvature @ curvature), float(comfort), float(pivotal)

    def _over_time(self, values: FloatArray) -> FloatArray:
        """Values (K+1, ...) at unit boundaries, linear in time at the knots (S, ...)."""
        grid = self.grid
        at = np.arange(grid.intervals + 1) / grid.per_unit
        row = np.minimum(at.astype(int), grid.units - 1)
        share = (at - row).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values[row] * (1 - share) + values[row + 1] * share)

    def _state_bounds(self, config: TrajectoriesConfig) -> tuple[FloatArray, FloatArray]:
        """Limits (S, 6) of eq. (18), the start fixed where it is known."""
        steering, braking, free = config.steering_max_rad, config.deceleration_max_mps2, np.inf
        knots = self.grid.intervals + 1
        lower = np.tile([-free, -free, -free, -steering, 0.0, -braking], (knots, 1))
        upper = np.tile(
            [free, free, free, steering, self.speed_max_mps, config.acceleration_max_mps2], (knots, 1)
        )
        start = self.start
        x, y = shift_along(0.0, 0.0, start.heading_rad, -self.dimensions.rear_axle_to_centre_m)
        speed = float(np.clip(start.speed_mps, 0.0, self.speed_max_mps))
        fixed: list[tuple[int, float | None]] = [(0, x), (1, y), (2, start.heading_rad), (4, speed)]
        fixed += [(3, start.steering_rad), (5, start.acceleration_mps2)]
        for column, value in fixed:
            if value is not None:
                held = float(np.clip(value, lower[0, column], upper[0, column]))
                lower[0, column] = upper[0, column] = held
        # A recorded deceleration must not make a standing car reverse within the first step.
        stop = -2.0 * speed / self.grid.step_s
        lower[0, 5], upper[0, 5] = max(lower[0, 5], stop), max(upper[0, 5], stop)
        if self.stands_at_end:
            lower[-1, 4:] = upper[-1, 4:] = 0.0
        return lower, upper
