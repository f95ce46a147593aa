"""Results made of other results or plans."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import polars as pl

from istc_replay.datatypes import Certificate, Log, Result, WindowPlan

CONFIG_TOML = "[window]\nunit_s = 1.0\n"


def renamed(result: Result, new_names: dict[str, str]) -> Result:
    """The same result of vehicles by other names, in its tables and in its summary."""

    def rename(value: Any) -> Any:
        if isinstance(value, str):
            return new_names.get(value, value)
        if isinstance(value, list):
            return [rename(part) for part in value]
        if isinstance(value, dict):
            return {key: rename(part) for key, part in value.items()}
        return value

    ids = pl.col("vehicle_id").replace(new_names)
    vehicles = pl.col("vehicles").list.eval(pl.element().replace(new_names))
    return replace(
        result,
        states=result.states.with_columns(ids),
        corridors=result.corridors.with_columns(ids),
        solves=result.solves.with_columns(ids),
        certificates=result.certificates.with_columns(vehicles),
        summary=rename(result.summary),
    )


def repeated_bytes(
    log: Log, plan: WindowPlan, certificates: list[Certificate], summary: dict[str, Any], times: int
) -> bytes:
    """The result.mcap of a log and its one window's plan, several times in a row."""
    from istc_replay.export.result_mcap import result_bytes

    window, (entry,) = plan.scenario.window, summary["windows"]
    span_ns = window.end_ns - window.start_ns
    plans, checks, windows, tables = [], [], [], []
    for k in range(times):
        span = {"start_ns": window.start_ns + k * span_ns, "end_ns": window.end_ns + k * span_ns}
        moved = replace(plan.scenario, window=replace(window, index=k, **span))
        plans.append(replace(plan, scenario=moved))
        checks += [replace(check, window=k) for check in certificates]
        windows.append(entry | span | {"index": k})
        # The next window begins with the state at its start.
        own = log.states.filter(pl.col("time_ns") < window.end_ns) if k < times - 1 else log.states
        tables.append(own.with_columns(pl.col("time_ns") + k * span_ns))
    long = replace(log, states=pl.concat(tables).sort("vehicle_id", "time_ns"))
    return result_bytes(long, plans, checks, summary | {"windows": windows}, CONFIG_TOML, {})
