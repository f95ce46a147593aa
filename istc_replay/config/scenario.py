"""The configuration's sections `window` and `vehicles`: who is planned, and when."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from istc_replay.config.sections import Count, NonNegative, Positive, Section


class WindowConfig(Section):
    """Cutting the log into windows."""

    unit_s: Positive | Literal["auto"] = "auto"
    """Length of a time unit T, each corridor-cube holds for one; auto: 1 s, in traffic 1, 0.5 or 0.25 s."""
    rules: Literal["auto", "scene", "traffic"] = "auto"
    """How to plan: a staged scene, recorded traffic, or by `slow_mps` and what the log tells."""
    slow_mps: Positive = 6.0
    """A log with nothing of a scene in which someone is faster than this is traffic."""
    frame: Literal["auto", "map", "road"] = "auto"
    """Axes of the cubes: the map's, turned to the road, or the road's in traffic alone."""
    whole_log_s: Positive = 20.0
    """A log no longer than this is one window."""
    horizon_s: Positive = 8.0
    """Length of a window of a longer log; in steps, at least the stride and time to stand."""
    stride_s: Positive = 8.0
    """Distance from one window's start to the next."""
    start: Literal["recording", "handed_over"] = "recording"
    """Where windows start: each from the recording, or where the plan of the one before has led (in turn)."""
    minimum_presence_units: Count = 1
    """A vehicle present for fewer whole units is not planned."""
    minimum_rate_hz: Positive = 4.0
    """A vehicle of traffic that is recorded more rarely is not planned."""
    speed_mismatch_mps: Positive = 2.0
    """A vehicle of traffic whose recorded speed and motion differ by more, on average, is not planned."""
    parked_m: NonNegative = 0.5
    """A vehicle of traffic that moves less than this in the whole log is an obstacle."""


class VehicleConfig(Section):
    """One vehicle."""

    length_m: Positive | None = None
    """Box length."""
    width_m: Positive | None = None
    """Box width."""
    wheelbase_m: Positive | None = None
    """Distance between the axles."""
    rear_axle_to_centre_m: float | None = None
    """Distance from the rear axle forward to the box centre."""
    priority: Positive | None = None
    """Priority weight eta of eq. (4)."""
    cooperative: bool = True
    """Whether the vehicle is planned; if not, it is an obstacle that moves as recorded."""


class VehiclesConfig(Section):
    """Vehicles: defaults for what the log does not tell, and per-vehicle values."""

    length_m: Positive = 4.0
    """Default box length."""
    width_m: Positive = 2.0
    """Default box width."""
    wheelbase_ratio: Positive = 0.675
    """Default wheelbase as a share of the length (2.7 m of 4 m)."""
    priority: Positive = 1.0
    """Default priority weight eta."""
    by_id: dict[str, VehicleConfig] = Field(default={})
    """Values for single vehicles: a priority overrides the log's, dimensions fill what it lacks."""
