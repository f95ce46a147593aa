"""The recorded bodies of a log: their tracks, sizes and where each state came from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from istc_replay.config import AuditConfig, VehiclesConfig
from istc_replay.datatypes import FloatArray
from istc_replay.safety.recorded import GAP_PERIODS, Track
from istc_replay.units import NS_PER_S

IntArray = NDArray[np.int64]

#: Length and width where neither log nor configuration tell them [m].
_SIZES = {"pedestrian": (0.6, 0.6), "bicycle": (1.8, 0.6)}
#: Bit of `derived` for a speed from positions.
_SPEED_DERIVED = 2
#: Common times are no closer than this share of the shortest period: stamps may jitter.
_SPACING = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A recorded vehicle, or pedestrian or other.

    `topic` and `message_index` (S,) say where each sample of `track` came from.
    """

    name: str
    role: str
    track: Track
    wheelbase_m: float
    rear_axle_to_centre_m: float
    dimensions_source: str
    dimension_change_m: float
    speed_derived: bool
    topic: NDArray[np.object_]
    message_index: IntArray

    @property
    def is_vehicle(self) -> bool:
        """Whether it is driven: the checks of single vehicles apply."""
        return self.role == "vehicle"

    def fastest_mps(self) -> float:
        """Its largest speed, 0 where none is known."""
        return self.track.fastest_mps(int(self.track.times_ns[0]), int(self.track.times_ns[-1]))

    def origin(self, time_ns: int) -> tuple[str, int]:
        """Topic and message index of the sample at or before a time."""
        row = max(int(np.searchsorted(self.track.times_ns, time_ns, side="right")) - 1, 0)
        return str(self.topic[row]), int(self.message_index[row])

    def boxes(self, times_ns: IntArray) -> tuple[FloatArray, FloatArray]:
        """(n, 5) boxes and (n,) speeds at the times; NaN where not known."""
        states = self.track.at(times_ns)
        size = np.broadcast_to([self.track.length_m, self.track.width_m], (times_ns.size, 2))
        return np.hstack([states[:, :3], size]), states[:, 3]

    def bound_m(self, times_ns: IntArray, acceleration_mps2: float) -> FloatArray:
        """(n,) how far off positions about these times may be: a h^2 / 8, h between its samples."""
        known = self.track.times_ns
        if known.size < 2:
            return np.zeros(times_ns.size)
        after = np.clip(np.searchsorted(known, times_ns), 1, known.size - 1)
        step_s = (known[after] - known[after - 1]) / NS_PER_S
        # Around a gap nothing is interpolated: what is told there is a sample.
        step_s = np.minimum(step_s, self.track.period_ns / NS_PER_S * GAP_PERIODS)
        return np.asarray(acceleration_mps2 * step_s**2 / 8.0)


def recorded_bodies(states: pl.DataFrame, vehicles: VehiclesConfig) -> list[Body]:
    """Bodies of a log's states, sorted by name; states without time or position are left out."""
    known = (
        pl.col("x_m").is_finite()
        & pl.col("y_m").is_finite()
        & pl.col("vehicle_id").is_not_null()
        & pl.col("time_ns").is_not_null()
    )
    bodies = []
    for (name,), rows in states.filter(known).partition_by("vehicle_id", as_dict=True).items():
        samples = rows.unique("time_ns", keep="first", maintain_order=True).sort("time_ns")
        bodies.append(_body(str(name), samples, vehicles))
    return sorted(bodies, key=lambda body: body.name)


def _body(name: str, rows: pl.DataFrame, vehicles: VehiclesConfig) -> Body:
    role = rows["role"].drop_nulls().first() or "vehicle"
    own = vehicles.by_id.get(name)
    default = _SIZES.get(str(role), (vehicles.length_m, vehicles.width_m))
    size, source = [], "log"
    for key, fallback in zip(("length_m", "width_m"), default, strict=True):
        value = _extreme(rows[key], largest=True)
        if not value > 0.0:
            given = getattr(own, key) if own else None
            value, found = (given, "config") if given else (fallback, "default")
            source = found if source != "default" else source
        size.append(float(value))
    wheelbase = _extreme(rows["wheelbase_m"], largest=True)
    if not wheelbase > 0.0:
        wheelbase = (own.wheelbase_m if own else None) or size[0] * vehicles.wheelbase_ratio
    ahead = _extreme(rows["rear_axle_to_centre_m"], largest=True)
    changes = [
        _extreme(rows[key], largest=True) - _extreme(rows[key], largest=False)
        for key in ("length_m", "width_m")
    ]
    times = rows["time_ns"].to_numpy().astype(np.int64)
    columns = ("x_m", "y_m", "heading_rad", "speed_mps")
    track = Track.of(
        times_ns=times,
        states=np.column_stack([_floats(rows[key]) for key in columns]),
        length_m=size[0],
        width_m=size[1],
    )
    return Body(
        name=name,
        role=str(role),
        track=track,
        wheelbase_m=float(wheelbase),
        rear_axle_to_centre_m=ahead if np.isfinite(ahead) else float(wheelbase) / 2.0,
        dimensions_source=source,
        dimension_change_m=max((change for change in changes if np.isfinite(change)), default=0.0),
        speed_derived=bool((rows["derived"].fill_null(0).to_numpy() & _SPEED_DERIVED).any()),
        topic=rows["topic"].fill_null("").to_numpy().astype(object),
        message_index=rows["message_index"].fill_null(-1).to_numpy().astype(np.int64),
    )


def common_times(bodies: list[Body], audit: AuditConfig) -> IntArray:
    """Times at which all bodies are looked at: stamps of samples, thinned to the shortest period."""
    if not bodies:
        return np.empty(0, dtype=np.int64)
    stamps = np.unique(np.concatenate([body.track.times_ns for body in bodies]))
    periods = [body.track.period_ns for body in bodies if body.track.period_ns > 0.0]
    spacing = max(min(periods, default=0.0), audit.least_step_s * NS_PER_S) * _SPACING
    if stamps.size < 2 or np.diff(stamps).min() >= spacing:
        return stamps
    rows, row = [], 0
    while row < stamps.size:
        rows.append(row)
        row = max(int(np.searchsorted(stamps, stamps[row] + spacing)), row + 1)
    return np.asarray(stamps[rows])


def _floats(column: pl.Series) -> FloatArray:
    return np.asarray(column.cast(pl.Float64).to_numpy(), dtype=np.float64)


def _extreme(column: pl.Series, *, largest: bool) -> float:
    values = _floats(column)
    values = values[np.isfinite(values)]
    if not values.size:
        return float("nan")
    return float(values.max() if largest else values.min())
