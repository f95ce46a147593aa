"""The safety audit of a result: its recorded behaviour, its plans anew, and one against the other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import polars as pl

from istc_replay.config import Config
from istc_replay.datatypes import Certificate, Log, Result
from istc_replay.safety.against_plan import against_plan_table, compared_rows, recorded_rows
from istc_replay.safety.bodies import recorded_bodies
from istc_replay.safety.certificate import certify_plan
from istc_replay.safety.clocks import CLOCK_RULES, Clock
from istc_replay.safety.log_audit import Audit, audit_log
from istc_replay.safety.recorded import recorded_tracks
from istc_replay.safety.solver_record import with_solver_record
from istc_replay.safety.written_plans import written_plans
from istc_replay.states import CERTIFICATES_SCHEMA, STATES_SCHEMA, conform
from istc_replay.units import seconds_to_ns


def audit_result(
    result: Result,
    config: Config,
    recorded: pl.DataFrame | None = None,
    parts: Iterable[Result] | None = None,
) -> Audit:
    """Audit a result from its tables alone.

    Parameters
    ----------
    result : Result
        As read back. Stamps and clocks cannot be judged from it, as it is sorted by time: what was
        found of them when it was made is taken over.
    config : Config
        The thresholds, and what the plans promise.
    recorded, parts : DataFrame and iterable of Result, optional
        Its recorded states, and its plans part by part, where it is without states.

    Returns
    -------
    Audit
        With the certificates of all plans, made anew, and what was recorded against them.
    """
    clocks = [
        Clock(
            **{name: row[name] for name in ("rule", "topic", "start_ns", "worst_ns", "end_ns")},
            **{name: row[name] for name in ("value", "unit", "threshold", "detail")},
            vehicles=tuple(row["vehicles"]),
            source=row["threshold_source"],
        )
        for row in result.findings.filter(pl.col("rule").is_in(CLOCK_RULES)).iter_rows(named=True)
    ]
    states = recorded_rows(result) if recorded is None else recorded
    certificates, against = _judged([result] if parts is None else parts, states, result, config)
    found = audit_log(recorded_log(result, states), config, against, clocks)
    windows = result.summary.get("windows") or ()
    found = with_solver_record(found, windows, config)
    starts = [window["start_ns"] for window in windows]
    origin_ns = min(starts, default=found.log.start_ns or 0)
    return replace(found, certificates=_table(certificates, result), origin_ns=origin_ns)


def _judged(
    parts: Iterable[Result], recorded: pl.DataFrame, result: Result, config: Config
) -> tuple[list[Certificate], pl.DataFrame]:
    """The certificates of all plans, and what was recorded against them."""
    everybody = recorded_tracks(recorded, vehicles_only=False)
    vehicles = recorded_tracks(recorded)
    bodies = {body.name: body for body in recorded_bodies(recorded, config.vehicles)}
    certificates, rows = list[Certificate](), list[dict[str, Any]]()
    for plan in written_plans(parts):
        certificates += certify_plan(plan, everybody, result.scene, config)
        rows += compared_rows(plan, vehicles, bodies, result.scene, config)
    return certificates, against_plan_table(rows)


def recorded_log(result: Result, rows: pl.DataFrame) -> Log:
    """What a result has of its log: its recorded states; messages are counted within its own topics."""
    states = rows.with_columns(log_time_ns=pl.col("time_ns"), publish_time_ns=pl.col("time_ns"))
    states = states.drop("source", "window")
    told = result.summary.get("input") or {}
    return Log(
        path=result.path,
        sha256=str(told.get("sha256", "")),
        complete=told.get("complete") is True,
        messages=states.height,
        attachments=0,
        metadata=0,
        chunks=0,
        start_ns=states["time_ns"].min(),  # type: ignore[arg-type]
        end_ns=states["time_ns"].max(),  # type: ignore[arg-type]
        channels=(),
        states=conform(states, STATES_SCHEMA),
        scene=result.scene,
        problems=(),
    )


def _table(certificates: Sequence[Certificate], result: Result) -> pl.DataFrame:
    starts = {window["index"]: window["start_ns"] for window in result.summary.get("windows") or ()}
    rows = [
        {
            "window": c.window,
            "check": c.check,
            "verdict": c.verdict.value,
            "margin": c.margin,
            "unit": c.unit,
            "time_ns": None if c.time_s is None else starts.get(c.window, 0) + seconds_to_ns(c.time_s),
            "vehicles": list(c.vehicles),
            "detail": c.detail,
        }
        for c in certificates
    ]
    return pl.DataFrame(rows, schema=CERTIFICATES_SCHEMA) if rows else CERTIFICATES_SCHEMA.to_frame()
