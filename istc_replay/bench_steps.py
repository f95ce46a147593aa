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


@dataclass(frozen=True, slots=True)
class StepsRow:
    """One scene by one horizon and stride [s]; both are None where it is planned in one window.

    `length_m` sums the motion that is driven: of each plan what lies before the next window begins.
    `cpu_s` is processor time of all that a replay does, CBC's included.
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
    names: Sequence[str],
    steps: Sequence[tuple[float, float]],
    config: Config,
    told: Callable[[str], None],
) -> list[StepsRow]:
    """Replay scenes in one window, and in steps of each horizon and stride [s]."""
    rows = []
    for name in names:
        log = recorded_log(find_sample(name).record())
        for step in (None, *steps):
            told(name if step is None else f"{name}, {step[0]:g} s every {step[1]:g} s")
            rows.append(_row(name, log, config, step))
    return rows


def _row(name: str, log: Log, config: Config, step: tuple[float, float] | None) -> StepsRow:
    if step is not None:
        window = {"whole_log_s": min(step), "horizon_s": step[0], "stride_s": step[1], "start": "handed_over"}
        config = config.model_copy(update={"window": config.window.model_copy(update=window)})
    began = _cpu_s()
    done = replay_read(log, config)
    spent = _cpu_s() - began
    windows = done.summary["windows"]
    checks = [c for w in windows for c in (w.get("certificate") or {}).get("checks", ())]
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
        arrived=sum(v["arrived"] is True for v in windows[-1]["vehicles"]),
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
