"""Scenes planned in steps beside the same scenes planned in one window."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from istc_replay.bench import recorded_log
from istc_replay.datatypes import SOUND
from istc_replay.fallback import FOUND_BY
from istc_replay.pipeline.replay import replay_read
from istc_replay.samples.scenes import find_sample

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from istc_replay.config import Config
    from istc_replay.datatypes import Log
    from istc_replay.pipeline.assembly import Replay

#: Horizon and stride [s].
Step = tuple[float, float]


@dataclass(frozen=True, slots=True)
class StepsRow:
    """One scene by one horizon and stride; both are None where it is planned in one window.

    `sound` windows pass every check; in `kept` ones of these the plan before goes on. `cpu_s` is processor
    time of the replay, CBC's included. `length_m` is that of what is driven, of each plan up to where the
    next window begins, None where a window has no plan.
    """

    name: str
    vehicles: int
    horizon_s: float | None
    stride_s: float | None
    windows: int
    sound: int
    kept: int
    arrived: int
    cpu_s: float
    length_m: float | None
    min_separation_m: float | None
    reasons: tuple[str, ...]


def bench_steps(
    names: Sequence[str], steps: Sequence[Step], config: Config, told: Callable[[str], None]
) -> list[StepsRow]:
    """Replay scenes in one window, and in steps; `told` hears what is being measured."""
    rows = []
    for name in names:
        log = recorded_log(find_sample(name).record())
        for step in (None, *steps):
            told(name if step is None else f"{name}, {step[0]:g} s every {step[1]:g} s")
            rows.append(_row(name, log, config, step))
    return rows


def table(rows: Sequence[StepsRow]) -> list[list[str]]:
    """Rows of text."""
    head = ["scene", "horizon, stride", "windows sound", "plan before", "arrived", "CPU s", "length m"]
    lines = [[*head, "least gap m"]]
    for row in rows:
        whole = row.horizon_s is None
        lines.append(
            [
                row.name,
                "one window" if whole else f"{row.horizon_s:g} s, {row.stride_s:g} s",
                f"{row.sound} of {row.windows}",
                "-" if whole else str(row.kept),
                f"{row.arrived} of {row.vehicles}",
                f"{row.cpu_s:.1f}",
                "-" if row.length_m is None else f"{row.length_m:.1f}",
                "-" if row.min_separation_m is None else f"{row.min_separation_m:.2f}",
            ]
        )
    return lines


def _row(name: str, log: Log, config: Config, step: Step | None) -> StepsRow:
    if step is not None:
        window = {"whole_log_s": min(step), "horizon_s": step[0], "stride_s": step[1], "start": "handed_over"}
        config = config.model_copy(update={"window": config.window.model_copy(update=window)})
    began = _cpu_s()
    done = replay_read(log, config)
    spent = _cpu_s() - began
    windows = done.summary["windows"]
    checks = [check for window in windows for check in window["certificate"]["checks"]]
    gaps = [c["margin"] for c in checks if c["check"] == "separation" and c["margin"] is not None]
    horizon, stride = step or (None, None)
    return StepsRow(
        name=name,
        vehicles=windows[-1]["vehicles_present"],
        horizon_s=horizon,
        stride_s=stride,
        windows=len(windows),
        sound=sum(w["status"] in SOUND for w in windows),
        kept=sum(w["corridors"]["found_by"] == FOUND_BY for w in windows),
        arrived=sum(v["arrived"] is not False for v in windows[-1]["vehicles"]),
        cpu_s=spent,
        length_m=_driven_m(done),
        min_separation_m=min(gaps, default=None),
        reasons=tuple(f"{w['index']}: {w['status']}: {w['reason']}" for w in windows if w["reason"]),
    )


def _cpu_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _driven_m(done: Replay) -> float | None:
    """Length of all planned motion up to each seam; None where a window has no plan."""
    windows: list[dict[str, Any]] = done.summary["windows"]
    if not all(w["status"] in SOUND for w in windows):
        return None
    planned, total = done.result.states.filter(pl.col("source") == "planned"), 0.0
    ends = [w["start_ns"] for w in windows[1:]] + [windows[-1]["end_ns"]]
    for window, end in zip(windows, ends, strict=True):
        own = planned.filter(pl.col("window") == window["index"], pl.col("time_ns") <= end)
        for _, track in own.sort("time_ns").group_by("vehicle_id"):
            steps = track.select(pl.col("x_m").diff(), pl.col("y_m").diff()).drop_nulls()
            total += float(np.hypot(steps["x_m"].to_numpy(), steps["y_m"].to_numpy()).sum())
    return total
