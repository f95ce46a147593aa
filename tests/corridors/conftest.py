"""Small scenarios for layer 1, made without any log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from istc_replay.config import Config, CorridorsConfig
from istc_replay.corridors import cbc
from istc_replay.corridors.formulation import build_problem, default_limits
from istc_replay.corridors.problem import CorridorProblem
from istc_replay.corridors.seed.lattice import Lattice
from istc_replay.corridors.seed.seeding import make_lattices
from istc_replay.corridors.solve import solve_corridors
from istc_replay.datatypes import (
    Corridors,
    Frame,
    Guidance,
    Obstacle,
    Participant,
    Scenario,
    Window,
    read_only,
)
from istc_replay.guidance.build import build_guidance
from istc_replay.samples.scenes import find_sample

from ..support.participants import straight_on
from ..support.planning import scenarios
from ..support.tracks import log_of


@dataclass(frozen=True)
class Case:
    """A scenario with its guidance and settings."""

    scenario: Scenario
    guidance: tuple[Guidance, ...]
    config: CorridorsConfig

    def problem(self) -> CorridorProblem:
        """The corridor problem in our reading."""
        limits = {p.vehicle_id: default_limits(self.config) for p in self.scenario.participants}
        return build_problem(self.scenario, self.guidance, self.config, limits, 10.0)

    def solved(self, **changes: object) -> Corridors:
        """The corridors, with some settings changed."""
        config = self.config.model_copy(update=changes)
        limits = {p.vehicle_id: default_limits(config) for p in self.scenario.participants}
        return solve_corridors(self.scenario, self.guidance, config, limits, 10.0)


def straight_driver(
    vehicle_id: str, start: tuple[float, float, float], speed_mps: float, units: int, priority: float
) -> Participant:
    """A participant recorded driving straight on."""
    times = np.linspace(0.0, units, 10 * units + 1)
    speeds = np.full(len(times), speed_mps)
    return straight_on(vehicle_id, start, times, speed_mps * times, speeds, units, priority)


def case_of(participants: list[Participant], units: int, obstacles: tuple[Obstacle, ...] = ()) -> Case:
    """A case of one window with these participants and the default settings."""
    window = Window(0, 0, units * 1_000_000_000, 1.0, units, Frame())
    scenario = Scenario(window, tuple(participants), obstacles, None, (), len(participants))
    config = Config()
    return Case(scenario, build_guidance(scenario, config.guidance), config.corridors)


@pytest.fixture(scope="session")
def crossing() -> Callable[..., Case]:
    """Random vehicles that all drive through the middle at about the same time."""

    def make(seed: int, vehicles: int = 3, units: int = 4, obstacle: bool = False) -> Case:
        random = np.random.default_rng(seed)
        participants = []
        for number in range(vehicles):
            heading = 2.0 * np.pi * (number + random.uniform(-0.2, 0.2)) / vehicles
            speed = random.uniform(4.0, 6.0)
            distance = random.uniform(10.0, 13.0)
            start = (-distance * np.cos(heading), -distance * np.sin(heading), float(heading))
            priority = float(random.choice([0.01, 0.2, 0.5, 1.0]))
            participants.append(straight_driver(str(number + 1), start, speed, units, priority))
        boxes = read_only([[1.0, 3.0, -1.0, 1.0]] * units)
        return case_of(participants, units, (Obstacle("block", boxes),) if obstacle else ())

    return make


@pytest.fixture(scope="session")
def intersection() -> Callable[[str], Case]:
    """A sample of the paper's intersection, as a case."""

    def make(name: str) -> Case:
        recorded = find_sample(name).record()
        stamps = [pl.col("time_ns").alias(c) for c in ("log_time_ns", "publish_time_ns")]
        states = recorded.states.with_columns(stamps).sort("vehicle_id", "time_ns")
        log = log_of(states, scene=recorded.scene)
        config = Config()
        scenario = scenarios(log, config)[0]
        return Case(scenario, build_guidance(scenario, config.guidance), config.corridors)

    return make


@pytest.fixture(scope="session")
def transformed() -> Callable[..., Case]:
    """A case moved by a shift and turned by quarter turns, and its vehicles renamed."""

    def make(case: Case, quarter_turns: int, shift_m: tuple[float, float], names: dict[str, str]) -> Case:
        angle = quarter_turns * np.pi / 2
        c, s = round(np.cos(angle)), round(np.sin(angle))
        turn = np.array([[c, -s], [s, c]], dtype=float)

        def poses(values: np.ndarray) -> np.ndarray:
            return read_only(np.column_stack([values[:, :2] @ turn.T + shift_m, values[:, 2] + angle]))

        participants = []
        for p in case.scenario.participants:
            x, y = turn @ (p.start.x_m, p.start.y_m) + shift_m
            start = replace(p.start, x_m=float(x), y_m=float(y), heading_rad=p.start.heading_rad + angle)
            recording = replace(p.recording, poses=poses(p.recording.poses))
            lane = None if p.lane_m is None else read_only(p.lane_m @ turn.T + shift_m)
            name = names.get(p.vehicle_id, p.vehicle_id)
            participants.append(replace(p, vehicle_id=name, start=start, recording=recording, lane_m=lane))
        participants.sort(key=lambda p: p.vehicle_id)
        scenario = replace(case.scenario, participants=tuple(participants))
        return Case(scenario, build_guidance(scenario, Config().guidance), case.config)

    return make


@pytest.fixture
def fake_cbc(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Callable[[str], None]]:
    """Put a shell script in CBC's place."""

    def put(script: str) -> None:
        fake = tmp_path / "cbc"
        fake.write_text("#!/bin/sh\n" + script)
        fake.chmod(0o755)
        cbc.executable.cache_clear()
        monkeypatch.setattr(cbc.cbcbox, "cbc_bin_path", lambda: str(fake))

    yield put
    cbc.executable.cache_clear()


_SEED_UNIT_S = 0.5


def standing_driver(name: str, start: tuple[float, float, float], length_m: float, units: int) -> Participant:
    """A participant that drives straight on at 5 m/s and brakes at 2 m/s^2 to stand."""
    times = np.linspace(0.0, units * _SEED_UNIT_S, 10 * units + 1)
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
        window = Window(0, 0, round(units * _SEED_UNIT_S * 1e9), _SEED_UNIT_S, units, Frame())
        scenario = Scenario(window, drivers, obstacles, (-25.0, 25.0, -25.0, 25.0), (), len(drivers))
        config = Config()
        guidance = build_guidance(scenario, config.guidance)
        return scenario, guidance, make_lattices(scenario, guidance, config.corridors)

    return make
