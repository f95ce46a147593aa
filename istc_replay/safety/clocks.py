"""Clocks and stamps, looked at in the order of the file: sorted by time, backward jumps are hidden."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import polars as pl
from numpy.typing import NDArray

from istc_replay.config import AuditConfig
from istc_replay.datatypes import FloatArray
from istc_replay.units import NS_PER_S

IntArray = NDArray[np.int64]

#: What only the order of the file tells.
CLOCK_RULES = ("data_stamps", "data_clock_step", "data_clock_drift")
#: Offsets on either side of a message whose medians make a step.
_SIDE = 5
#: What is compared for a drift, at either end, as a share of all messages.
_END_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Clock:
    """Stamps of a topic that cannot be trusted, and the vehicles it tells of."""

    rule: str
    topic: str
    vehicles: tuple[str, ...]
    start_ns: int
    worst_ns: int
    end_ns: int
    value: float
    unit: str
    threshold: float
    source: str
    detail: str


def check_clocks(states: pl.DataFrame, audit: AuditConfig) -> list[Clock]:
    """Find stamps that do not increase, and steps and drift of log time less the message's own.

    Parameters
    ----------
    states : polars.DataFrame
        States of STATES_SCHEMA; `message_index` gives the order of the file.
    audit : AuditConfig
        The thresholds.
    """
    known = states.filter(pl.col("time_ns").is_not_null(), pl.col("vehicle_id").is_not_null())
    found: list[Clock] = []
    for (topic,), rows in sorted(known.partition_by("topic", as_dict=True).items(), key=str):
        name = "" if topic is None else str(topic)
        found += _stamps(name, rows.sort("message_index", maintain_order=True))
        messages = rows.unique("message_index", keep="first", maintain_order=True).sort("message_index")
        vehicles = tuple(rows["vehicle_id"].unique().sort().to_list())
        found += _offsets(name, vehicles, messages, audit)
    return found


def _stamps(topic: str, rows: pl.DataFrame) -> list[Clock]:
    steps = rows.select("vehicle_id", "time_ns", before=pl.col("time_ns").shift(1).over("vehicle_id")).filter(
        pl.col("time_ns") <= pl.col("before")
    )
    # One clock is behind a message's vehicles: their jumps are told once, and neighbours together.
    jumps = steps.group_by("time_ns", "before", maintain_order=True).agg(pl.col("vehicle_id").sort())
    found: list[Clock] = []
    last: dict[tuple[str, ...], int] = {}
    for time, before, names in jumps.sort("time_ns", maintain_order=True).iter_rows():
        vehicles, back = tuple(names), (before - time) / NS_PER_S
        detail = f"a stamp goes back by {back:.6g} s" if back else "a stamp repeats"
        clock = Clock("data_stamps", topic, vehicles, time, time, before, back, "s", 0.0, "ours", detail)
        known = found[last[vehicles]] if vehicles in last else None
        if known is None or known.end_ns + NS_PER_S < time:
            last[vehicles] = len(found)
            found.append(clock)
            continue
        largest = clock if back > known.value else known
        found[last[vehicles]] = replace(largest, start_ns=known.start_ns, end_ns=max(known.end_ns, before))
    return found


def _offsets(
    topic: str, vehicles: tuple[str, ...], messages: pl.DataFrame, audit: AuditConfig
) -> list[Clock]:
    both = messages.filter(pl.col("log_time_ns").is_not_null())
    times = both["time_ns"].to_numpy().astype(np.int64)
    offsets = (both["log_time_ns"].to_numpy().astype(np.int64) - times) / NS_PER_S
    if times.size <= 2 * _SIDE:
        return []
    found, stepped = [], 0.0
    for k, step in _steps(offsets, audit.clock_step_s):
        stepped += step
        around = (int(min(times[k - 1], times[k])), int(times[k]), int(max(times[k - 1], times[k])))
        detail = f"log time less stamp steps by {step:.6g} s"
        found.append(
            Clock(
                "data_clock_step",
                topic,
                vehicles,
                *around,
                abs(step),
                "s",
                audit.clock_step_s,
                "ours",
                detail,
            )
        )
    end = max(int(times.size * _END_SHARE), _SIDE)
    drift = float(np.median(offsets[-end:]) - np.median(offsets[:end])) - stepped
    span = float(np.median(times[-end:]) - np.median(times[:end])) / NS_PER_S
    rate = abs(drift) / span * 1e6 if span > 0.0 else 0.0
    if rate > audit.clock_drift_ppm and abs(drift) > audit.clock_step_s:
        whole = (int(times.min()), int(times.max()), int(times.max()))
        detail = f"log time less stamp drifts by {drift:.6g} s"
        found.append(
            Clock(
                "data_clock_drift",
                topic,
                vehicles,
                *whole,
                rate,
                "ppm",
                audit.clock_drift_ppm,
                "ours",
                detail,
            )
        )
    return found


def _steps(offsets: FloatArray, least_s: float) -> list[tuple[int, float]]:
    """Messages before which the offset steps for good: the medians of either side differ."""
    windows = np.lib.stride_tricks.sliding_window_view(offsets, _SIDE)
    medians = np.median(windows, axis=1)
    change = medians[_SIDE:] - medians[:-_SIDE]  # before message k = row + _SIDE
    found, row = [], 0
    past = np.abs(change) > least_s
    while row < change.size:
        if not past[row]:
            row += 1
            continue
        end = row
        while end < change.size and past[end]:
            end += 1
        # Of equal changes of the medians the message is where the offset itself changes most.
        near = np.arange(row, end) + _SIDE
        k = int(near[np.argmax(np.abs(offsets[near] - offsets[near - 1]))])
        found.append((k, float(change[row:end][np.argmax(np.abs(change[row:end]))])))
        row = end
    return found
