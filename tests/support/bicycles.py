"""Bicycles with known truth: simulated finely, apart from every integrator of the product."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Dense samples of one control step.
DENSE = 64


@dataclass
class Car:
    """A simulated vehicle: first rear-axle state, controls (S-1, 2), and what follows from them."""

    name: str
    first: Array  # x, y, heading, steering, speed, acceleration
    controls: Array
    dt: float
    first_unit: int = 0
    dimensions: tuple[float, float, float, float] = (4.5, 1.9, 2.7, 1.35)
    dense: Array = field(init=False)  # ((S-1) * DENSE + 1, 6) rear axle

    def __post_init__(self) -> None:
        self.dense = simulate(self.first, self.controls, self.dt, self.dimensions[2])

    def moved(self, x: float, y: float) -> Car:
        return replace(self, first=self.first + np.array([x, y, 0.0, 0.0, 0.0, 0.0]))

    def renamed(self, name: str) -> Car:
        return replace(self, name=name)

    def centres(self) -> Array:
        """(m, 3) dense poses of the box centre."""
        ahead, heading = self.dimensions[3], self.dense[:, 2]
        return np.column_stack(
            [self.dense[:, 0] + ahead * np.cos(heading), self.dense[:, 1] + ahead * np.sin(heading), heading]
        )

    def boxes(self) -> Array:
        """(m, 5) dense boxes."""
        size = np.broadcast_to(self.dimensions[:2], (self.dense.shape[0], 2))
        return np.hstack([self.centres(), size])

    def times_s(self, unit_s: float) -> Array:
        return self.first_unit * unit_s + self.dt / DENSE * np.arange(self.dense.shape[0])

    def corners(self) -> Array:
        """(m, 4, 2) dense corners."""
        pose = self.centres()
        length, width = self.dimensions[:2]
        local = np.array([[length, width], [length, -width], [-length, -width], [-length, width]]) / 2.0
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        turn = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)  # (m, 2, 2)
        return pose[:, None, :2] + np.einsum("mij,nj->mni", turn, local)

    def hulls(self, unit_s: float, pad: float) -> Array:
        """(K, 4) cubes: the hull of all dense corners of each closed unit, widened by pad."""
        per_unit = round(unit_s / self.dt) * DENSE
        corners = self.corners()
        rows = []
        for begin in range(0, corners.shape[0] - 1, per_unit):
            part = corners[begin : begin + per_unit + 1].reshape(-1, 2)
            low, high = part.min(axis=0) - pad, part.max(axis=0) + pad
            rows.append([low[0], high[0], low[1], high[1]])
        return np.array(rows)


def simulate(first: Array, controls: Array, dt: float, wheelbase: float) -> Array:
    """Integrate the bicycle by Gauss-Legendre quadrature on a fine grid; rear axle, (m, 6)."""
    points, weights = np.polynomial.legendre.leggauss(5)
    h = dt / DENSE
    held = np.repeat(controls, DENSE, axis=0)  # one row a cell
    offset = np.tile(np.arange(DENSE) * h, controls.shape[0])
    a_knot = first[5] + np.concatenate([[0.0], np.cumsum(controls[:, 1] * dt)])
    v_knot = first[4] + np.concatenate([[0.0], np.cumsum(a_knot[:-1] * dt + controls[:, 1] * dt**2 / 2)])
    d_knot = first[3] + np.concatenate([[0.0], np.cumsum(controls[:, 0] * dt)])
    a0, v0, d0 = (np.repeat(knot[:-1], DENSE) for knot in (a_knot, v_knot, d_knot))

    def at(t: Array) -> tuple[Array, Array, Array]:
        return d0 + held[:, 0] * t, v0 + a0 * t + held[:, 1] * t**2 / 2, a0 + held[:, 1] * t

    def turn(begin: Array, span: Array) -> Array:
        total = np.zeros_like(begin)
        for point, weight in zip(points, weights, strict=True):
            steering, speed, _ = at(begin + span * (point + 1) / 2)
            total += weight * speed * np.tan(steering) / wheelbase
        return total * span / 2

    whole = np.full_like(offset, h)
    heading = first[2] + np.concatenate([[0.0], np.cumsum(turn(offset, whole))])
    dx, dy = np.zeros_like(offset), np.zeros_like(offset)
    for point, weight in zip(points, weights, strict=True):
        part = whole * (point + 1) / 2
        angle, speed = heading[:-1] + turn(offset, part), at(offset + part)[1]
        dx += weight * h / 2 * speed * np.cos(angle)
        dy += weight * h / 2 * speed * np.sin(angle)
    x = first[0] + np.concatenate([[0.0], np.cumsum(dx)])
    y = first[1] + np.concatenate([[0.0], np.cumsum(dy)])
    steering, speed, acceleration = (
        np.append(values, last)
        for values, last in zip(at(offset), (d_knot[-1], v_knot[-1], a_knot[-1]), strict=True)
    )
    return np.column_stack([x, y, heading, steering, speed, acceleration])


def random_car(rng: np.random.Generator, name: str, steps: int, dt: float = 0.2, first_unit: int = 0) -> Car:
    """A car that wanders within the default limits."""
    steering, speed, acceleration = rng.uniform(-0.3, 0.3), rng.uniform(3.0, 7.0), 0.0
    first = np.array([*rng.uniform(-5, 5, 2), rng.uniform(-np.pi, np.pi), steering, speed, acceleration])
    controls = []
    for _ in range(steps):
        rate = (np.clip(steering + rng.uniform(-0.75, 0.75) * dt, -0.5, 0.5) - steering) / dt
        wanted = rng.uniform(-1.5, 1.5) + (5.0 - speed) * 0.5
        jerk = np.clip((np.clip(wanted, -2.0, 2.0) - acceleration) / dt, -6.0, 6.0)
        controls.append([rate, jerk])
        steering += rate * dt
        speed += acceleration * dt + jerk * dt**2 / 2
        acceleration += jerk * dt
    length = rng.uniform(3.5, 5.5)
    dimensions = (length, rng.uniform(1.6, 2.2), 0.6 * length, 0.3 * length + rng.uniform(-0.1, 0.2))
    return Car(name, first, np.array(controls), dt, first_unit, dimensions)


def straight_car(
    name: str,
    x: float,
    y: float,
    heading: float,
    speed: float,
    steps: int,
    dt: float = 0.2,
    first_unit: int = 0,
) -> Car:
    """A car that keeps its course and speed; x, y of the box centre."""
    ahead = 1.35
    rear = [x - ahead * np.cos(heading), y - ahead * np.sin(heading)]
    first = np.array([*rear, heading, 0.0, speed, 0.0])
    return Car(name, first, np.zeros((steps, 2)), dt, first_unit)


def stacked(cars: Iterable[Car], gap: float = 0.3, pad: float = 0.05) -> list[Car]:
    """The cars moved along y so that their whole corridors are exactly the gap apart."""
    placed: list[Car] = []
    top = 0.0
    for car in cars:
        y = car.corners()[..., 1]
        placed.append(car.moved(0.0, top + gap + pad - y.min()))
        top = placed[-1].corners()[..., 1].max() + pad
    return placed
