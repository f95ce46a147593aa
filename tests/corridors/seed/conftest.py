"""Vehicles that want to pass each other, with their lattices."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from istc_replay.config import Config
from istc_replay.corridors.seed.lattice import Lattice
from istc_replay.corridors.seed.seeding import make_lattices
from istc_replay.datatypes import (
    Frame,
    Guidance,
    Obstacle,
    Participant,
    Scenario,
    Window,
    read_only,
)
from istc_replay.guidance.build import build_guidance

from ...support.participants import straight_on

UNIT_S = 0.5


def standing_driver(name: str, start: tuple[float, float, float], length_m: float, units: int) -> Participant:
    """A participant that drives straight on at 5 m/s and brakes at 2 m/s^2 to stand."""
    times = np.linspace(0.0, units * UNIT_S, 10 * units + 1)
    cruising = (length_m - 6.25) / 5.0
    braking = np.clip(times - cruising, 0.0, 2.5)
    way = 5.0 * np.minimum(times, cruising) + 5.0 * braking - braking**2
    return straight_on(name, start, times, way, np.round(np.gradient(way, times), 6), units)


@pytest.fixture
def meeting() -> Callable[..., tuple[Scenario, tuple[Guidance, ...], tuple[Lattice, ...]]]:
    """Vehicles by start pose that each drive 30 m, and obstacles by box."""

    def make(
        starts: list[tuple[float, float, float]],
        boxes: tuple[tuple[float, float, float, float], ...] = (),
        units: int = 24,
    ) -> tuple[Scenario, tuple[Guidance, ...], tuple[Lattice, ...]]:
        drivers = tuple(standing_driver(str(i + 1), start, 30.0, units) for i, start in enumerate(starts))
        obstacles = tuple(
            Obstacle(f"block {i + 1}", read_only([box] * units), read_only(np.zeros((4, 2))))
            for i, box in enumerate(boxes)
        )
        window = Window(0, 0, round(units * UNIT_S * 1e9), UNIT_S, units, Frame())
        scenario = Scenario(window, drivers, obstacles, (-25.0, 25.0, -25.0, 25.0), (), len(drivers))
        config = Config()
        guidance = build_guidance(scenario, config.guidance)
        return scenario, guidance, make_lattices(scenario, guidance, config.corridors)

    return make
