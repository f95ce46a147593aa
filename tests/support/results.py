"""Results made of other results or plans."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import polars as pl
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from istc_replay import messages
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
    from istc_replay.export.result_mcap import Contents, result_bytes

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
    return result_bytes(Contents(long, plans, checks, summary | {"windows": windows}, CONFIG_TOML, {}))


def one_message(topic: str, kind: str, data: bytes) -> bytes:
    """A file with one message of istc.v1."""
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    descriptors = build_file_descriptor_set(messages.message(kind)).SerializeToString()
    schema = writer.register_schema(f"istc.v1.{kind}", "protobuf", descriptors)
    writer.add_message(writer.register_channel(topic, "protobuf", schema), 0, data, 0)
    writer.finish()
    return stream.getvalue()


def with_window(result: Result, **changes: Any) -> Result:
    """The same result with another first window in its summary."""
    first, *others = result.summary["windows"]
    return replace(result, summary=result.summary | {"windows": [first | changes, *others]})


def proven(result: Result) -> Result:
    """The same result, all of whose checks pass."""
    checks = result.certificates.head(2).with_columns(
        pl.lit("pass").alias("verdict"),
        pl.lit(0.4).alias("margin"),
        pl.Series("check", ["cubes_disjoint", "separation"]),
    )
    return replace(result, certificates=checks)
