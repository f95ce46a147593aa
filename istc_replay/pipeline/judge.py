"""Judging a window: its plan goes to bytes, is read back, and only what these say is certified."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from istc_replay.datatypes import SOUND, Log, Verdict, WindowOutcome, WindowStatus

if TYPE_CHECKING:
    from collections.abc import Sequence

    import polars as pl

    from istc_replay.config import Config
    from istc_replay.datatypes import Certificate, Result, WindowPlan
    from istc_replay.windows import LogPart


def judged(
    plan: WindowPlan, part: LogPart, config: Config, before: WindowPlan | None = None
) -> WindowOutcome:
    """Certify one window's plan from the bytes of a result that holds it, and tell what was recorded.

    `before` is the plan that handed its vehicles over; the result that is certified holds it too.
    """
    from istc_replay.changes import changes
    from istc_replay.safety.recorded import least_recorded_gap

    began = time.perf_counter()
    window = plan.scenario.window
    gap = least_recorded_gap(_sized(part.states, plan), window.start_ns, window.end_ns)
    certificates, against = _certified(plan, part, config, before) if plan.trajectories else ((), ())
    seconds = {**plan.seconds, "certificate": time.perf_counter() - began}
    verdict = replace(_with_verdict(plan, certificates), seconds=seconds)
    sound = verdict.status in SOUND
    return WindowOutcome(verdict, certificates, gap, against if sound else (), changes(plan) if sound else ())


def _certified(
    plan: WindowPlan, part: LogPart, config: Config, before: WindowPlan | None
) -> tuple[tuple[Certificate, ...], tuple[dict[str, Any], ...]]:
    """The certificates, and what was recorded against the plan."""
    import polars as pl

    from istc_replay.config import render_config
    from istc_replay.export.result_mcap import Contents, result_bytes
    from istc_replay.export.summary import summarise, window_figures
    from istc_replay.ingest.result import read_result
    from istc_replay.safety.against_plan import against_plan
    from istc_replay.safety.certificate import certify

    # What was recorded is the log's own; what was planned is read back from the bytes.
    log = Log("", "", True, 0, 0, 0, 0, None, None, (), part.states.clear(), part.scene, ())
    hoped = replace(plan, status=WindowStatus.CERTIFIED)
    plans = [hoped] if before is None else [before, hoped]
    summary = summarise(log, [window_figures(WindowOutcome(each)) for each in plans], {}, "")
    written = result_bytes(Contents(log, plans, (), summary, render_config(config), {}, shown=False))
    result = read_result(written)
    draft = replace(result, states=pl.concat([_recorded_rows(plan, part, result), result.states]))
    index = plan.scenario.window.index
    certificates = tuple(c for c in certify(draft, config) if c.window == index)
    return certificates, tuple(against_plan(draft, config).filter(pl.col("window") == index).to_dicts())


def _recorded_rows(plan: WindowPlan, part: LogPart, result: Result) -> pl.DataFrame:
    """The recorded states as a result tells them: with the window that they fall into."""
    import polars as pl

    window = plan.scenario.window
    within = pl.col("time_ns").is_between(window.start_ns, window.end_ns)
    recorded = part.states.with_columns(
        source=pl.lit("recorded"),
        window=pl.when(within).then(pl.lit(window.index, pl.Int32)),
    )
    return recorded.select(result.states.columns)


def _sized(states: pl.DataFrame, plan: WindowPlan) -> pl.DataFrame:
    """Recorded states with the sizes that the plan took for vehicles whose log tells none."""
    import polars as pl

    sizes = {p.vehicle_id: p.dimensions for p in plan.scenario.participants}
    return states.with_columns(
        pl.col(name).fill_null(
            pl.col("vehicle_id").replace_strict(
                {vehicle: getattr(size, name) for vehicle, size in sizes.items()},
                default=None,
                return_dtype=pl.Float64,
            )
        )
        for name in ("length_m", "width_m")
    )


def _with_verdict(plan: WindowPlan, certificates: Sequence[Certificate]) -> WindowPlan:
    from istc_replay.safety.certificate import overall

    if plan.status is not WindowStatus.NOT_CERTIFIED:
        return plan
    verdict = overall(certificates) if certificates else Verdict.NOT_APPLICABLE
    if verdict is Verdict.PASS:
        if plan.frozen:
            stay = "; ".join(f"{e.vehicle_id}: {e.detail}" for e in plan.frozen)
            reason = "; ".join(filter(None, [f"as recorded stay {stay}", plan.reason]))
            return replace(plan, status=WindowStatus.PARTIAL, reason=reason)
        return replace(plan, status=WindowStatus.GOAL_NOT_REACHED if plan.late else WindowStatus.CERTIFIED)
    faults = [c for c in certificates if c.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE)]
    reason = "; ".join(f"{c.check} {c.verdict}: {c.detail}" for c in faults) or "nothing was certified"
    return replace(plan, reason=reason)
