"""Logs planned from memory, without any file."""

from __future__ import annotations

from typing import Any

import numpy as np

from istc_replay.config import Config
from istc_replay.coordinate import Planners, plan_part
from istc_replay.datatypes import Log, Scenario, WindowPlan
from istc_replay.pipeline.assembly import Replay
from istc_replay.pipeline.replay import replay_read
from istc_replay.scenario import build_scenario
from istc_replay.windows import LogPart, log_parts, settled_config

FAST = Config.model_validate({"corridors": {"mode": "fast"}})


def first_part(log: Log, config: Config) -> LogPart:
    """The part of the log's first window."""
    return next(log_parts(log, config))


def scenarios(log: Log, config: Config) -> list[Scenario]:
    """The scenario of each window of the log."""
    return [build_scenario(part, config) for part in log_parts(log, config)]


def planned(log: Log, config: Config = FAST) -> WindowPlan:
    """The plan of the log's first window."""
    settled = settled_config(log, config)
    return plan_part(first_part(log, settled), settled, Planners(settled))


def replayed(log: Log, config: Config = FAST) -> tuple[Replay, dict[str, Any]]:
    """The replay of a log and its one window."""
    done = replay_read(log, config)
    (window,) = done.summary["windows"]
    return done, window


def map_motion(plan: WindowPlan) -> dict[str, np.ndarray]:
    """Planned rear axles (S, 2) in the map frame, by vehicle."""
    frame = plan.scenario.window.frame
    c, s = np.cos(frame.yaw_rad), np.sin(frame.yaw_rad)
    turn = np.array([[c, -s], [s, c]])
    return {t.vehicle_id: t.states[:, :2] @ turn.T + (frame.x_m, frame.y_m) for t in plan.trajectories}
