"""Certificates of results, and results with a fault planted in their tables."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import polars as pl

from istc_replay.config import Config
from istc_replay.datatypes import Certificate, Result, Verdict
from istc_replay.safety.certificate import certify

NS = 1_000_000_000
CONFIG = Config()
FAIL, PASS = Verdict.FAIL, Verdict.PASS
INCONCLUSIVE, NOT_APPLICABLE = Verdict.INCONCLUSIVE, Verdict.NOT_APPLICABLE
#: Checks that need a vehicle's trajectory.
OF_MOTION = ("cubes_overlap", "start", "dynamics", "limits", "in_corridor", "separation")


def judge(result: Result, config: Config = CONFIG) -> dict[str, Certificate]:
    return {certificate.check: certificate for certificate in certify(result, config)}


def failed(checks: dict[str, Certificate]) -> set[str]:
    return {name for name, check in checks.items() if check.verdict == FAIL}


def edited(result: Result, table: str, where: pl.Expr, **values: Any) -> Result:
    """The result with columns replaced in the rows where the condition holds."""
    frame: pl.DataFrame = getattr(result, table)
    columns = [
        pl.when(where).then(value if isinstance(value, pl.Expr) else pl.lit(value)).otherwise(pl.col(name))
        .cast(frame.schema[name]).alias(name)
        for name, value in values.items()
    ]  # fmt: skip
    return replace(result, **{table: frame.with_columns(columns)})


def without(result: Result, table: str, where: pl.Expr) -> Result:
    return replace(result, **{table: getattr(result, table).filter(~where)})


def knot(result: Result, vehicle: str, k: int) -> pl.Expr:
    """The planned row of a vehicle's k-th knot (dt = 0.2 s)."""
    start = result.summary["windows"][0]["start_ns"]
    planned = (pl.col("source") == "planned") & (pl.col("vehicle_id") == vehicle)
    return planned & (pl.col("time_ns") == start + k * NS // 5)


def cube(vehicle: str, k: int) -> pl.Expr:
    return (pl.col("vehicle_id") == vehicle) & (pl.col("k") == k)
