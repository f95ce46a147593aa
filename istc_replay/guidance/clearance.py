"""Whether a car's box keeps clear of standing boxes and within the map, for many poses at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from functools import cached_property

import numpy as np

from istc_replay.datatypes import Dimensions, FloatArray, MapBounds, SceneObstacle
from istc_replay.geometry import shift_along
from istc_replay.guidance.separation import axis_gaps, axis_slopes

_ROUNDING_M = 1e-9
_FEW = 8  # obstacles that are looked at one by one
_PAIRS = 2_000_000  # of poses and obstacles, at once in memory
_RASTER_MAX = 500


@dataclass(frozen=True, eq=False)
class Clearance:
    """What a car has to keep clear of, and by how much.

    `obstacles` (O, 5): centre x, y, heading, half length, half width [m, rad]. The car-box, also
    turned by +-`slacks_rad` (O,) about its centre, keeps `margins_m` (O,) from each; the box as it
    is stays within the bounds. `room_m` is how far the bounds may be drawn in.
    """

    car: Dimensions
    bounds: MapBounds
    obstacles: FloatArray
    margins_m: FloatArray
    slacks_rad: FloatArray
    room_m: float = math.inf

    @classmethod
    def of(
        cls,
        car: Dimensions,
        bounds: MapBounds,
        obstacles: Sequence[SceneObstacle],
        margin_m: float,
        slack_rad: float,
    ) -> Clearance:
        """Ask one margin [m] and one heading slack [rad] of all obstacles."""
        rows = [[o.x_m, o.y_m, o.heading_rad, o.length_m / 2.0, o.width_m / 2.0] for o in obstacles]
        count = len(rows)
        return cls(
            car,
            bounds,
            np.array(rows, dtype=np.float64).reshape(-1, 5),
            np.full(count, margin_m),
            np.full(count, slack_rad),
        )

    def eased_at(self, poses: FloatArray) -> Clearance:
        """Ask no more than the car keeps at these poses (P, 3), where it stands anyway."""
        room_m = max(0.0, float(self.rooms(poses).min()))
        if not len(self.obstacles):
            return replace(self, room_m=room_m)
        bare = self.unslacked().gaps(poses).min(axis=0)
        tight = self.gaps(poses).min(axis=0) < self.margins_m
        return replace(
            self,
            margins_m=np.where(tight, np.minimum(bare, self.margins_m), self.margins_m),
            slacks_rad=np.where(tight, 0.0, self.slacks_rad),
            room_m=room_m,
        )

    def unslacked(self) -> Clearance:
        """Ask nothing of turned boxes."""
        return replace(self, slacks_rad=np.zeros_like(self.slacks_rad))

    def widened(self, by_m: float) -> Clearance:
        """Ask for more room where nothing was eased."""
        inward = min(by_m, self.room_m)
        low_x, high_x, low_y, high_y = astuple(self.bounds)
        return replace(
            self,
            bounds=MapBounds(low_x + inward, high_x - inward, low_y + inward, high_y - inward),
            margins_m=self.margins_m + by_m * (self.slacks_rad > 0.0),
            room_m=self.room_m - inward,
        )

    def gaps(self, poses: FloatArray) -> FloatArray:
        """Gaps (P, O) between the car-box at rear-axle poses (P, 3) and the obstacles [m].

        The largest distance along an axis of either box: the distance itself where a corner faces
        a side, at most the distance where two corners face each other; negative where they overlap.
        """
        centres = self._centres(poses)
        cars, boxes = np.indices((len(poses), len(self.obstacles))).reshape(2, -1)
        return self._pair_gaps(centres, poses[:, 2], cars, boxes).reshape(len(poses), len(self.obstacles))

    def near_gaps(self, poses: FloatArray, within_m: float) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """Gaps beyond the margins that are less than `within_m`, and their slopes by the pose.

        Returns
        -------
        tuple
            (N,) pose by index; (N,) room beyond the margin, or to an edge of the bounds [m]; (N, 3) slopes
            by x, y and heading of the rear axle.
        """
        parts = [self._near_edges(poses, within_m)]
        if len(self.obstacles):
            parts.append(self._near_obstacles(poses, within_m))
        who, gaps, slopes = (np.concatenate(part) for part in zip(*parts, strict=True))
        return who, gaps, slopes

    def _near_obstacles(
        self, poses: FloatArray, within_m: float
    ) -> tuple[np.ndarray, FloatArray, FloatArray]:
        centres = self._centres(poses)
        dx, dy = (centres[:, None, axis] - self.obstacles[None, :, axis] for axis in (0, 1))  # (P, O)
        cars, boxes = np.nonzero(dx * dx + dy * dy < (self._reach_m + 1.5 * within_m) ** 2)
        x, y, angles, sizes = self._relative(centres, poses[:, 2], cars, boxes)
        by_axis = axis_gaps(x, y, angles, sizes)  # (4, T, N)
        gaps = by_axis.max(axis=0)
        turn = gaps.argmin(axis=0)
        pairs = np.arange(len(cars))
        gap = gaps[turn, pairs] - self.margins_m[boxes]
        near = np.flatnonzero(gap < within_m)
        turn, cars, boxes = turn[near], cars[near], boxes[near]
        by_x, by_y, by_angle = axis_slopes(
            by_axis[:, turn, near].argmax(axis=0), x[near], y[near], angles[turn, near], sizes[:, near]
        )
        heading, own = self.obstacles[boxes, 2], poses[cars, 2]
        co, so = np.cos(heading), np.sin(heading)
        # The car moves against the obstacle.
        east, north = by_y * so - by_x * co, -by_x * so - by_y * co
        ahead = self.car.rear_axle_to_centre_m
        by_heading = by_angle + ahead * (north * np.cos(own) - east * np.sin(own))
        return cars, gap[near], np.column_stack([east, north, by_heading])

    def _near_edges(self, poses: FloatArray, within_m: float) -> tuple[np.ndarray, FloatArray, FloatArray]:
        bounds, ahead = self.bounds, self.car.rear_axle_to_centre_m
        a, b = self.car.length_m / 2.0, self.car.width_m / 2.0
        x, y = self._centres(poses).T
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        reach_x, reach_y = a * np.abs(c) + b * np.abs(s), a * np.abs(s) + b * np.abs(c)
        gaps = np.stack(
            [
                x - bounds.x_min_m - reach_x,
                bounds.x_max_m - x - reach_x,
                y - bounds.y_min_m - reach_y,
                bounds.y_max_m - y - reach_y,
            ]
        )
        edge, who = np.nonzero(gaps < within_m)
        c, s = c[who], s[who]
        along, across = -np.sign(c) * s, np.sign(s) * c
        sign = np.where(edge % 2 == 0, 1.0, -1.0)
        is_x = edge < 2
        turning = np.where(
            is_x, -sign * ahead * s - a * along - b * across, sign * ahead * c - a * across - b * along
        )
        return who, gaps[edge, who], np.column_stack([sign * is_x, sign * ~is_x, turning])

    def rooms(self, poses: FloatArray) -> FloatArray:
        """Least distances (P,) from the box at rear-axle poses (P, 3) to the bounds, negative beyond [m]."""
        centres = self._centres(poses)
        c, s = np.abs(np.cos(poses[:, 2])), np.abs(np.sin(poses[:, 2]))
        a, b = self.car.length_m / 2.0, self.car.width_m / 2.0
        reach_x, reach_y = a * c + b * s, a * s + b * c
        x, y = centres.T
        return np.asarray(
            np.minimum(
                np.minimum(x - self.bounds.x_min_m, self.bounds.x_max_m - x) - reach_x,
                np.minimum(y - self.bounds.y_min_m, self.bounds.y_max_m - y) - reach_y,
            )
        )

    def closed_at(self, pose: FloatArray) -> Clearance:
        """Bar the place of the car's box at a pose (3,) by one more obstacle."""
        x, y = self._centres(pose[None, :])[0]
        bar = [x, y, pose[2], self.car.width_m / 2.0, self.car.width_m / 2.0]
        return replace(
            self,
            obstacles=np.vstack([self.obstacles, bar]),
            margins_m=np.append(self.margins_m, 0.0),
            slacks_rad=np.append(self.slacks_rad, 0.0),
        )

    def lacks(self, poses: FloatArray) -> FloatArray:
        """By how much (P,) the car at poses (P, 3) is too near to anything [m]; negative: room left."""
        lacks = -self.rooms(poses)
        if len(self.obstacles):
            lacks = np.maximum(lacks, (self.margins_m - self.gaps(poses)).max(axis=1))
        return np.asarray(lacks)

    def free(self, poses: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Whether the car may be at rear-axle poses (..., 3), as (...)."""
        flat = poses.reshape(-1, 3)
        free = self.rooms(flat) >= -_ROUNDING_M
        if len(self.obstacles):
            todo = np.flatnonzero(free)
            centres = self._centres(flat[todo])
            if len(self.obstacles) > _FEW:
                crowded = self._is_crowded(centres)
                todo, centres = todo[crowded], centres[crowded]
            for part in range(0, len(todo), max(1, _PAIRS // len(self.obstacles))):
                some = slice(part, part + max(1, _PAIRS // len(self.obstacles)))
                free[todo[some]] = self._all_clear(centres[some], flat[todo[some], 2])
        return free.reshape(poses.shape[:-1])

    def near(self, poses: FloatArray, within_m: float) -> Clearance:
        """Leave out obstacles that are farther than this beyond reach at poses (P, 3), metres apart."""
        close = np.zeros(len(self.obstacles), dtype=bool)
        reach = self._reach_m + within_m
        for centre in self._centres(poses):
            close |= np.abs(self.obstacles[:, :2] - centre).max(axis=1) < reach
        return replace(
            self,
            obstacles=self.obstacles[close],
            margins_m=self.margins_m[close],
            slacks_rad=self.slacks_rad[close],
        )

    def _all_clear(self, centres: FloatArray, headings: FloatArray) -> np.ndarray:
        """Whether nothing is too near to boxes at centres (P, 2)."""
        dx, dy = (centres[:, None, axis] - self.obstacles[None, :, axis] for axis in (0, 1))  # (P, O)
        cars, boxes = np.nonzero(dx * dx + dy * dy < self._reach_m**2)
        hit = self._pair_gaps(centres, headings, cars, boxes) < self.margins_m[boxes] - _ROUNDING_M
        clear = np.ones(len(centres), dtype=bool)
        clear[cars[hit]] = False
        return clear

    def _is_crowded(self, centres: FloatArray) -> np.ndarray:
        """Whether the cell of a coarse raster that each centre (P, 2) is in has an obstacle in reach."""
        low, cell, raster = self._raster
        column, row = np.clip(((centres - low) / cell).astype(np.int64), 0, np.array(raster.shape) - 1).T
        return np.asarray(raster[column, row])

    @cached_property
    def _raster(self) -> tuple[FloatArray, float, np.ndarray]:
        bounds = self.bounds
        low = np.array([bounds.x_min_m, bounds.y_min_m])
        sides = np.array([bounds.x_max_m, bounds.y_max_m]) - low
        cell = max(1.0, float(sides.max()) / _RASTER_MAX)
        raster = np.zeros(np.ceil(sides / cell).astype(int) + 1, dtype=bool)
        for (x, y), reach in zip(self.obstacles[:, :2], self._reach_m, strict=True):
            first = np.maximum(np.floor((np.array([x, y]) - reach - low) / cell), 0).astype(int)
            last = np.maximum(np.floor((np.array([x, y]) + reach - low) / cell), -1).astype(int) + 1
            raster[first[0] : last[0], first[1] : last[1]] = True
        return low, cell, raster

    @property
    def _reach_m(self) -> FloatArray:
        """Distances (O,) of centres beyond which nothing can be too near."""
        half_diagonal = np.hypot(self.car.length_m, self.car.width_m) / 2.0
        return np.asarray(
            half_diagonal + np.hypot(*self.obstacles[:, 3:].T) + np.maximum(self.margins_m, 0.0) * 1.5
        )

    def _centres(self, poses: FloatArray) -> FloatArray:
        return shift_along(poses[:, 0], poses[:, 1], poses[:, 2], self.car.rear_axle_to_centre_m)

    def _pair_gaps(
        self, centres: FloatArray, headings: FloatArray, cars: np.ndarray, boxes: np.ndarray
    ) -> FloatArray:
        """Gaps of pairs (N,): car pose by index, obstacle by index; the least over the heading slack."""
        gaps = axis_gaps(*self._relative(centres, headings, cars, boxes))
        return np.asarray(gaps.max(axis=0).min(axis=0))

    def _relative(
        self, centres: FloatArray, headings: FloatArray, cars: np.ndarray, boxes: np.ndarray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """What `axis_gaps` takes of pairs (N,): obstacles from cars (N,), headings (T, N), sizes (4, N)."""
        x, y, heading, p, q = self.obstacles[boxes].T
        co, so = np.cos(heading), np.sin(heading)
        dx, dy = x - centres[cars, 0], y - centres[cars, 1]
        slack = self.slacks_rad[boxes]
        turns = np.stack([-slack, np.zeros_like(slack), slack]) if slack.any() else np.zeros((1, len(cars)))
        a, b = self.car.length_m / 2.0, self.car.width_m / 2.0
        sizes = np.stack([np.full(len(cars), a), np.full(len(cars), b), p, q])
        return dx * co + dy * so, dy * co - dx * so, headings[cars] - heading + turns, sizes
