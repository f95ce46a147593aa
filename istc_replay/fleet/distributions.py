"""The distributions that a fleet's report shows."""

from __future__ import annotations

from collections.abc import Sequence

import polars as pl

from istc_replay.export.fleet_page import Distribution

_ESTIMATE = "Recorded less planned, a vehicle and window: a counterfactual estimate."
_DECADES = "A window, by decades."
#: TTC and PET beyond this are no concern [s].
_SPAN_S = (0.0, 6.0)


def distributions(
    encounters: pl.LazyFrame | None,
    against_plan: pl.LazyFrame | None,
    windows: pl.DataFrame,
    logs: pl.DataFrame,
) -> dict[str, Sequence[Distribution]]:
    """Give the distributions by group, from tables of the data set; None where no log has the table."""
    return {
        "Recorded behaviour": _behaviour(encounters),
        "Planned against recorded": _against(against_plan),
        "Solves and jobs": _effort(windows, logs),
    }


def _values(frame: pl.LazyFrame | None, expression: pl.Expr) -> pl.Series:
    if frame is None:
        return pl.Series("value", [], dtype=pl.Float64)
    return frame.select(expression.alias("value")).collect()["value"]


def _behaviour(encounters: pl.LazyFrame | None) -> list[Distribution]:
    ttc = _values(encounters, pl.col("least_ttc_s"))
    pet = _values(encounters, pl.col("least_pet_s").abs())
    gap = _values(encounters, pl.col("least_gap_m"))
    no_course = "An encounter; those on no course of collision have none."
    return [
        Distribution("Least time to collision", "s", ttc, no_course, _SPAN_S),
        Distribution("Least post-encroachment time", "s", pet, "An encounter whose paths cross.", _SPAN_S),
        Distribution("Least gap", "m", gap, "An encounter; below zero the boxes overlap."),
    ]


def _against(against_plan: pl.LazyFrame | None) -> list[Distribution]:
    def spared(name: str) -> pl.Series:
        return _values(against_plan, pl.col(f"recorded_{name}") - pl.col(f"planned_{name}"))

    delay = _values(against_plan, pl.col("delay_end_s"))
    at_equal = "Planned less recorded time at equal arc length: a counterfactual estimate."
    return [
        Distribution("Delay at the end", "s", delay, at_equal),
        Distribution("Braking spared", "m/s²", spared("braking_mps2"), _ESTIMATE),
        Distribution("Lateral acceleration spared", "m/s²", spared("lateral_mps2"), _ESTIMATE),
        Distribution("Jerk spared", "m/s³", spared("jerk_mps3"), _ESTIMATE),
    ]


def _effort(windows: pl.DataFrame, logs: pl.DataFrame) -> list[Distribution]:
    layer_1, layer_2 = windows["corridors_s"], windows["trajectories_s"]
    to_bound = "Objective to proven bound, a window, by decades; up to 1e-3 counts as optimal."
    return [
        Distribution("Layer 1, corridors", "s", layer_1, _DECADES, log=True, digits=3),
        Distribution("Layer 2, trajectories", "s", layer_2, _DECADES, log=True, digits=3),
        Distribution("Gap of the corridors", "", windows["gap"], to_bound, log=True, digits=5),
        Distribution("Time of a job", "s", logs["seconds"], "A log, by decades.", log=True),
        Distribution("Memory of a job", "MB", logs["peak_mb"], "A log, at its peak.", digits=0),
    ]
