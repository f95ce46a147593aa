"""Results with known truth: bicycles simulated finely, apart from the audit's own integrator."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

from istc_replay.datatypes import Frame, Log, MapBounds, Result, StaticScene
from istc_replay.geometry import to_map
from istc_replay.states import (
    CERTIFICATES_SCHEMA,
    CORRIDORS_SCHEMA,
    FINDINGS_SCHEMA,
    OBSTACLES_SCHEMA,
    RESULT_STATES_SCHEMA,
    SOLVES_SCHEMA,
    STATES_SCHEMA,
    conform,
)

Array = NDArray[np.float64]
NS = 1_000_000_000
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


@dataclass
class Scene:
    """Everything a result is made of."""

    cars: list[Car]
    unit_s: float = 1.0
    start_ns: int = 1_700_000_000 * NS
    frame: Frame = field(default_factory=Frame)
    obstacles: dict[str, Array] = field(default_factory=dict)  # (N, 4) in the corridor frame
    bounds: MapBounds | None = None
    pad: float = 0.05
    window: int = 0
    cubes: dict[str, Array] = field(default_factory=dict)  # in place of the hulls

    def result(self) -> Result:
        states: list[dict[str, Any]] = []
        corridors: list[dict[str, Any]] = []
        for car in self.cars:
            states += self._planned(car) + self._recorded(car)
            walls = self.cubes.get(car.name, car.hulls(self.unit_s, self.pad))
            corridors += [
                {"vehicle_id": car.name, **self._box(row, car.first_unit + k)} for k, row in enumerate(walls)
            ]
        obstacles = [
            {"obstacle_id": name, **self._box(row, k)}
            for name, boxes in self.obstacles.items()
            for k, row in enumerate(boxes)
        ]
        units = max(car.first_unit + round(len(car.controls) * car.dt / self.unit_s) for car in self.cars)
        summary = {
            "windows": [
                {
                    "index": self.window,
                    "start_ns": self.start_ns,
                    "end_ns": self.start_ns + round(units * self.unit_s * NS),
                    "status": "certified",
                }
            ]
        }
        return Result(
            path="result.mcap",
            states=_table(states, RESULT_STATES_SCHEMA),
            corridors=_table(corridors, CORRIDORS_SCHEMA),
            obstacles=_table(obstacles, OBSTACLES_SCHEMA),
            solves=SOLVES_SCHEMA.to_frame(),
            certificates=CERTIFICATES_SCHEMA.to_frame(),
            findings=FINDINGS_SCHEMA.to_frame(),
            scene=StaticScene(bounds=self.bounds),
            summary=summary,
            config_toml="",
        )

    def _planned(self, car: Car) -> list[dict[str, Any]]:
        centres, knots = car.centres()[::DENSE], car.dense[::DENSE]
        points = to_map(centres[:, :2], self.frame)
        rows = []
        for k, (point, centre, knot) in enumerate(zip(points, centres, knots, strict=True)):
            heading = (centre[2] + self.frame.yaw_rad + np.pi) % (2 * np.pi) - np.pi
            control = car.controls[k] if k < len(car.controls) else (None, None)
            time_ns = self.start_ns + round((car.first_unit * self.unit_s + k * car.dt) * NS)
            rows.append(
                self._state(car, "planned", time_ns, point, heading, knot[4])
                | {"window": self.window, "acceleration_mps2": knot[5], "steering_rad": knot[3]}
                | {"steering_rate_radps": control[0], "jerk_mps3": control[1]}
            )
        return rows

    def _recorded(self, car: Car) -> list[dict[str, Any]]:
        centres = car.centres()[:: DENSE // 2]
        points = to_map(centres[:, :2], self.frame)
        rows = []
        for k, (point, centre) in enumerate(zip(points, centres, strict=True)):
            time_ns = self.start_ns + round((car.first_unit * self.unit_s + k * car.dt / 2) * NS)
            heading = (centre[2] + self.frame.yaw_rad + np.pi) % (2 * np.pi) - np.pi
            rows.append(self._state(car, "recorded", time_ns, point, heading, car.dense[k * DENSE // 2, 4]))
        return rows

    def _state(
        self, car: Car, source: str, time_ns: int, point: Array, heading: float, speed: float
    ) -> dict[str, Any]:
        length, width, wheelbase, ahead = car.dimensions
        return {
            "source": source,
            "vehicle_id": car.name,
            "time_ns": time_ns,
            "x_m": point[0],
            "y_m": point[1],
            "heading_rad": heading,
            "speed_mps": speed,
            "length_m": length,
            "width_m": width,
            "wheelbase_m": wheelbase,
            "rear_axle_to_centre_m": ahead,
        }

    def _box(self, row: Array, k: int) -> dict[str, Any]:
        return {
            "window": self.window,
            "k": k,
            "start_ns": self.start_ns + round(k * self.unit_s * NS),
            "end_ns": self.start_ns + round((k + 1) * self.unit_s * NS),
            **dict(zip(("x_min_m", "x_max_m", "y_min_m", "y_max_m"), row.tolist(), strict=True)),
            "frame_x_m": self.frame.x_m,
            "frame_y_m": self.frame.y_m,
            "frame_yaw_rad": self.frame.yaw_rad,
        }


def _table(rows: list[dict[str, Any]], schema: pl.Schema) -> pl.DataFrame:
    return conform(pl.DataFrame(rows, infer_schema_length=None) if rows else schema.to_frame(), schema)


@pytest.fixture(scope="session")
def kit() -> SimpleNamespace:
    """Builders of simulated cars and of results made of them."""
    return SimpleNamespace(
        Scene=Scene, Car=Car, random_car=random_car, straight_car=straight_car, stacked=stacked, dense=DENSE
    )


#: Start of the logs of `make_log`.
LOG_START_NS = 1_700_000_000 * NS


def recorded(name: str, time_s: Array, **columns: Any) -> pl.DataFrame:
    """States of one vehicle at times from the log's start; columns broadcast to the times."""
    times = np.round(np.asarray(time_s) * NS).astype(np.int64) + LOG_START_NS
    size = times.size
    values = {
        "vehicle_id": name,
        "time_ns": times,
        "log_time_ns": times,
        "publish_time_ns": times,
        "y_m": 0.0,
        "heading_rad": 0.0,
        "length_m": 4.5,
        "width_m": 1.9,
        "role": "vehicle",
        "topic": f"/{name}",
        "message_index": np.arange(size),
        "derived": 0,
    } | columns
    wide = {key: np.broadcast_to(np.asarray(value), (size,)) for key, value in values.items()}
    return conform(pl.DataFrame(wide), STATES_SCHEMA)


def log_of(*parts: pl.DataFrame) -> Log:
    """A log of recorded states."""
    states = pl.concat(parts).sort("vehicle_id", "time_ns", maintain_order=True)
    start, end = (
        int(value) for value in states.select(pl.min("time_ns"), pl.max("time_ns").alias("end")).row(0)
    )
    return Log(
        path="made.mcap", sha256="0" * 64, complete=True, messages=states.height, attachments=0, metadata=0,
        chunks=0, start_ns=start, end_ns=end, channels=(), states=states, scene=StaticScene(), problems=(),
    )  # fmt: skip


@pytest.fixture(scope="session")
def logs() -> SimpleNamespace:
    """Builders of logs: `recorded(name, time_s, **columns)` and `log_of(*parts)`."""
    return SimpleNamespace(recorded=recorded, log_of=log_of, start_ns=LOG_START_NS)
