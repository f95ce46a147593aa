"""A log cut into windows: the spans, and for each the part of the log that its plan follows from."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from istc_replay.datatypes import Log, StaticScene
from istc_replay.errors import ScenarioError
from istc_replay.road import Road, scene_near
from istc_replay.units import NS_PER_S, seconds_to_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from istc_replay.config import Config, WindowConfig

#: Time units by rule: of a scene, of a small crowd, and of a crowded one; of traffic from coarse to fine; and
#: of traffic that has no conflict at them, the first that does.
SCENE_UNIT_S, SMALL_CROWD_UNIT_S, CROWDED_UNIT_S = 1.0, 0.75, 0.5
TRAFFIC_UNITS_S, CALM_UNITS_S = (0.5, 0.25, 0.125), (1.0, 0.5, 0.25)
#: Limits and weights of layer 2 in traffic, where the configuration does not set them: recorded cars do brake
#: as hard as a dry road allows, and layer 1 asks for no more than its own limits or what was recorded.
TRAFFIC_LIMITS = {
    "acceleration_max_mps2": 5.0,
    "deceleration_max_mps2": 8.0,
    "pivotal_x_weight": 20.0,
    "pivotal_y_weight": 20.0,
    "steering_rate_weight": 5.0,
}
#: Budget of layer 1 in traffic, where the configuration does not set it: no window may hold up hundreds of
#: others by its proof. A node of the largest problems that are proven takes some 20 ms.
TRAFFIC_BUDGET = {"milp_node_budget": 1000}
#: States this far outside a window still tell the state at its ends.
_MARGIN_S = 1.0
#: Of windows that are handed over so long before too, and of a scene's so long after: its way to the goal.
_BEHIND_S = _AHEAD_S = 20.0
#: How many times longer a window of a scene in steps reaches ahead where its plan would end in a jam.
_LONGER = (1.5, 2.25)
#: No log is cut into more windows than this.
_MOST_WINDOWS = 1_000_000

#: Start [ns], length [ns] and index of a window.
Span = tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class LogPart:
    """Everything of a log that one window's plan follows from, besides the configuration.

    `states` are those in the window and just outside, in the log's order. `traffic` and `parked`
    tell what only the whole log knows: by which rules it is planned, and who never moves in it. `road` is
    what is told of the road about the window.
    """

    span: Span
    states: pl.DataFrame
    scene: StaticScene
    traffic: bool
    parked: frozenset[str]
    road: Road | None = None


def check_states(log: Log) -> None:
    """Refuse a log without vehicles.

    Raises
    ------
    ScenarioError
        If it has none.
    """
    if log.states.is_empty():
        understood = ", ".join(sorted({c.schema for c in log.channels if c.schema})) or "none"
        raise ScenarioError(
            f"{log.path}: no vehicle states; schemas in the log: {understood}; "
            "see docs/formats.md for what is read, or name the topic in [ingest.topics]"
        )


def is_traffic(log: Log, config: WindowConfig) -> bool:
    """Whether a log is recorded traffic: nobody's intent, priority or bounds are told, and someone is fast.

    Standing obstacles decide nothing: they stand beside any road.
    """
    if config.rules != "auto":
        return config.rules == "traffic"
    scene = log.scene
    intended = any(line.vehicle_id for line in scene.lane_lines)
    if intended or scene.vehicles or scene.bounds is not None:
        return False
    speeds = log.states["speed_mps"].drop_nulls()
    speeds = speeds.filter(speeds.is_finite())
    return bool(len(speeds)) and float(speeds.abs().max()) > config.slow_mps  # type: ignore[arg-type]


def settled_config(log: Log, config: Config) -> Config:
    """The settings in force: in traffic, layer 2 may brake and speed up as recorded traffic does.

    It also keeps closer to its pivotal points, which lie on the road where nothing needs to change, and
    proofs of layer 1 have fewer nodes. Settings that are in force stay as they are.
    """
    if not is_traffic(log, config.window):
        return config
    settled: dict[str, Any] = {}
    for name, defaults in (("trajectories", TRAFFIC_LIMITS), ("corridors", TRAFFIC_BUDGET)):
        section = getattr(config, name)
        free = {key: value for key, value in defaults.items() if key not in section.model_fields_set}
        settled[name] = section.model_copy(update=free)
    return config.model_copy(update=settled)


def first_unit_s(config: WindowConfig, *, traffic: bool) -> float:
    """Length of the time unit that is tried first [s]; a window of calm traffic may have a longer one."""
    if config.unit_s != "auto":
        return config.unit_s
    return TRAFFIC_UNITS_S[0] if traffic else fitting_unit_s(SCENE_UNIT_S, config, traffic=False)


def in_steps(config: WindowConfig, *, traffic: bool) -> bool:
    """Whether a scene is planned in steps: each window goes on from the plan of the one before."""
    return config.start == "handed_over" and not traffic


def fitting_unit_s(unit_s: float, config: WindowConfig, *, traffic: bool) -> float:
    """The time unit [s] or, in steps, the next shorter one that divides the stride, to shift plans by."""
    if config.unit_s != "auto" or not in_steps(config, traffic=traffic):
        return unit_s
    stride = seconds_to_ns(config.stride_s)
    fewest = max(1, -(-stride // seconds_to_ns(unit_s)))
    count = next((n for n in range(fewest, 2 * fewest + 2) if stride % n == 0), None)
    return unit_s if count is None else stride / count / NS_PER_S


def window_spans(log: Log, config: Config) -> list[Span]:
    """Start [ns], length [ns] and index of every window of a log.

    Raises
    ------
    ScenarioError
        If the log has no vehicle, is shorter than one time unit, or would be cut into too many windows.
    """
    check_states(log)
    window, traffic = config.window, is_traffic(log, config.window)
    unit_ns = seconds_to_ns(first_unit_s(window, traffic=traffic))
    firsts = log.states.group_by("vehicle_id").agg(pl.col("time_ns").min())["time_ns"].to_numpy()
    # Vehicles are sampled in turn: start when all that are there at the start have been seen.
    start = int(firsts[firsts - firsts.min() < unit_ns // 2].max())
    end = int(log.states["time_ns"].max())  # type: ignore[arg-type]
    span = end - start
    if span < unit_ns:
        raise ScenarioError(
            f"{log.path}: {span / NS_PER_S:.3f} s of states, less than one time unit of "
            f"{unit_ns / NS_PER_S:g} s; set window.unit_s lower"
        )
    if span <= seconds_to_ns(window.horizon_s if traffic else window.whole_log_s):
        return [(start, span, 0)]
    horizon, stride = seconds_to_ns(window.horizon_s), seconds_to_ns(window.stride_s)
    if in_steps(window, traffic=traffic):  # who goes on stands at a window's end, and brakes after its step
        horizon = max(horizon, stride + _stop_ns(log, config))
    if span // max(stride, 1) > _MOST_WINDOWS:
        raise ScenarioError(
            f"{log.path}: {span / NS_PER_S:g} s in strides of {window.stride_s:g} s are more than "
            f"{_MOST_WINDOWS} windows; set window.stride_s higher, or clip the log"
        )
    offsets = range(0, span, stride)
    spans = ((start + offset, min(horizon, span - offset), index) for index, offset in enumerate(offsets))
    # One that begins after another has reached the end would tell nothing more.
    return [whole for whole in spans if whole[1] >= unit_ns and whole[2] * stride + horizon - stride < span]


def _stop_ns(log: Log, config: Config) -> int:
    """How long [ns] the fastest recorded vehicle takes to stand, in whole halves of a second."""
    speeds = log.states["speed_mps"].drop_nulls()
    fastest = float(speeds.filter(speeds.is_finite()).abs().max() or 0.0)  # type: ignore[arg-type]
    return seconds_to_ns(math.ceil(2.0 * fastest / config.corridors.deceleration_mps2) / 2.0)


def log_parts(log: Log, config: Config, indices: Iterable[int] | None = None) -> Iterator[LogPart]:
    """Cut a log into the parts of its windows, one after the other; the cost follows the log's length.

    Parameters
    ----------
    log, config
        What was read, and the settings.
    indices : iterable of int, optional
        Windows wanted, by index; all otherwise.

    Raises
    ------
    ScenarioError
        As of `window_spans`, and if there is no window of an index.
    """
    spans = {span[2]: span for span in window_spans(log, config)}
    wanted = list(spans) if indices is None else list(indices)
    missing = [index for index in wanted if index not in spans]
    if missing:
        raise ScenarioError(f"{log.path}: there is no window {missing[0]}; it has {len(spans)}, from 0 on")
    traffic = is_traffic(log, config.window)
    parked = _parked(log.states, config.window) if traffic else frozenset()
    # By time, so that a window is a slice; `place` is the log's own order.
    ordered = log.states.with_row_index("_place").sort("time_ns", maintain_order=True)
    times = ordered["time_ns"].to_numpy()
    margin = seconds_to_ns(_MARGIN_S)
    # Who was handed over may be far behind its recording: the path that it follows is told too.
    chained = config.window.start == "handed_over"
    behind = seconds_to_ns(_BEHIND_S) if chained else margin
    ahead = seconds_to_ns(_AHEAD_S) if chained and not traffic else margin
    for index in wanted:
        start_ns, length_ns, _ = spans[index]
        first = int(np.searchsorted(times, start_ns - behind, side="left"))
        end = int(np.searchsorted(times, start_ns + length_ns + ahead, side="right"))
        states = ordered.slice(first, end - first).sort("_place").drop("_place")
        near = scene_near(log.scene, states.select("x_m", "y_m").to_numpy())
        yield LogPart(spans[index], states, near, traffic, parked, Road.of(near) if traffic else None)


def lengthened(part: LogPart) -> list[LogPart]:
    """The same part of a scene with its window reaching further and further ahead, to the end at most."""
    start_ns, length_ns, index = part.span
    left_ns = int(part.states["time_ns"].max()) - start_ns  # type: ignore[arg-type]
    lengths = [min(int(length_ns * longer), left_ns) for longer in _LONGER]
    return [
        replace(part, span=(start_ns, longer_ns, index))
        for longer_ns in dict.fromkeys(lengths)
        if longer_ns > length_ns
    ]


def _parked(states: pl.DataFrame, config: WindowConfig) -> frozenset[str]:
    """Vehicles that never move in the whole log; one that stands in a queue moves at another time."""
    x, y = pl.col("x_m"), pl.col("y_m")
    moved = states.group_by("vehicle_id").agg(
        ((x.max() - x.min()) ** 2 + (y.max() - y.min()) ** 2).sqrt().alias("moved_m")
    )
    return frozenset(moved.filter(pl.col("moved_m") < config.parked_m)["vehicle_id"].to_list())
