"""Results of simulated cars, as a certificate reads them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from istc_replay.datatypes import Frame, MapBounds, Result, StaticScene
from istc_replay.geometry import to_map
from istc_replay.states import (
    CERTIFICATES_SCHEMA,
    CORRIDORS_SCHEMA,
    FINDINGS_SCHEMA,
    OBSTACLES_SCHEMA,
    RESULT_STATES_SCHEMA,
    SOLVES_SCHEMA,
    conform,
)

from .bicycles import DENSE, Car

Array = NDArray[np.float64]
NS = 1_000_000_000


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
