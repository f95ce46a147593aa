"""Recordings repaired to motions that a car can drive."""

from __future__ import annotations

import numpy as np
import polars as pl

from istc_replay.config import Config
from istc_replay.scenario import build_scenario
from istc_replay.trajectories.repair import RecordingRepairer
from istc_replay.windows import settled_config

from ..support.planning import first_part
from ..support.tracks import driver, log_of


def test_a_noisy_recording_is_repaired_to_a_drivable_one() -> None:
    noise = np.random.default_rng(4).normal(0.0, 0.05, (2, 41))
    straight = driver("1")
    log = log_of(straight.with_columns(x_m=pl.col("x_m") + noise[0], y_m=pl.col("y_m") + noise[1]))
    scenario = build_scenario(first_part(log, Config()), Config(), 0.5)
    limits = settled_config(log, Config()).trajectories
    motion, record = RecordingRepairer(limits).repair(scenario.participants[0], 0.5, 20.0)
    assert motion is not None
    assert record.stage == "repair"
    assert motion.deviation_m < 0.25
    assert np.hypot(*(motion.poses[0, :2] - scenario.participants[0].recording.poses[0, :2])) < 0.04
    acceleration = motion.driven.states[:, 5]
    assert acceleration.max() <= limits.acceleration_max_mps2 + 1e-6
    assert acceleration.min() >= -limits.deceleration_max_mps2 - 1e-6
