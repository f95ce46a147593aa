"""Plots, manoeuvres and precedence of the Rerun view.

Manoeuvres are told from the plan alone, sample by sample:

- stop: slower than 0.3 m/s;
- yield: slower than 85 % of the guidance at the same time;
- turn: the heading turns faster than 0.1 rad/s;
- cruise: none of these.

The first that applies counts, and stretches shorter than 0.4 s join the one before. Precedence:
of two vehicles whose corridor-cubes cover common ground in different units, the one that is
there earlier, on average over those cubes, goes first.
"""

from __future__ import annotations

import itertools

import numpy as np
import polars as pl
import rerun as rr
from rerun.chunk import Chunk

from istc_replay.datatypes import FloatArray
from istc_replay.export.colours import LANE, PALETTE, Colour
from istc_replay.export.rerun.chunks import FOREVER_NS, IntArray, each, entity, ragged, same, shown, static
from istc_replay.export.rerun.clearance import HORIZON_M, Clearance
from istc_replay.export.rerun.spans import Span
from istc_replay.export.rerun.stage import Stage, greyed
from istc_replay.export.rerun.tracks import Track

STOP_MPS = 0.3
YIELD_SHARE = 0.85
TURN_RADPS = 0.1
_SHORTEST_NS = 400_000_000
_STATE_COLOURS: dict[str, Colour] = {
    "cruise": (70, 150, 80),
    "yield": (205, 130, 30),
    "stop": (200, 70, 60),
    "turn": (70, 110, 200),
    "not planned": LANE,
}
#: Plots by name: the track's attribute. Jerk is held from a state to the next.
_SIGNALS = {
    "speed": "speeds_mps",
    "acceleration": "accelerations_mps2",
    "steering": "steering_rad",
    "jerk": "jerks_mps3",
}


def plot_chunks(stage: Stage, found: list[Clearance]) -> list[Chunk]:
    """Chunks under `/plots`, `/states`, `/quiet/states` and `/precedence`."""
    chunks = _limits(stage)
    for source, tracks in (("recorded", stage.recorded), ("planned", stage.in_force)):
        for track in tracks.values():
            plotted = track.vehicle_id in stage.starring or stage.plots_all
            if plotted and stage.in_part(track.times_ns).any():
                chunks += _signals(stage, source, track)
    for vehicle_id in stage.vehicle_ids:
        if vehicle_id in stage.starring or not stage.slots:
            chunks += _states(stage, vehicle_id)
    return chunks + _clearances(stage, found) + _precedence(stage)


# --- plots -----------------------------------------------------------------------------------


def speed_limit_mps(stage: Stage, span: Span) -> float:
    """A window's speed limit: the configured one, or more where its vehicles were faster."""
    speeds = [0.0]
    for vehicle in span.summary["vehicles"]:
        track = stage.recorded.get(vehicle["id"])
        if track is not None:
            inside = (track.times_ns >= span.start_ns) & (track.times_ns <= span.end_ns)
            speeds.append(float(np.nanmax(np.abs(track.speeds_mps[inside]), initial=0.0)))
    return max(stage.config.trajectories.speed_max_mps, 1.15 * max(speeds) + 1.0)


def _limits(stage: Stage) -> list[Chunk]:
    limits = stage.config.trajectories
    bounds = {
        "acceleration": (-limits.deceleration_max_mps2, limits.acceleration_max_mps2),
        "steering": (-limits.steering_max_rad, limits.steering_max_rad),
        "jerk": (-limits.jerk_max_mps3, limits.jerk_max_mps3),
        "clearance": (0.0, stage.config.corridors.vehicle_gap_m),
    }
    times = [time for span in stage.spans for time in (span.start_ns, span.shown_end_ns)]
    lines = {name: np.tile(pair, len(times)) for name, pair in bounds.items()}
    lines["speed"] = np.ravel([(0.0, speed_limit_mps(stage, span)) * 2 for span in stage.spans])
    style = rr.SeriesLines.columns(names=["limit"] * 2, colors=[LANE] * 2, widths=[1.0] * 2).partition([2])
    chunks = []
    for signal, values in lines.items():
        path = entity("plots", signal, "limit")
        rows = ragged(rr.Scalars, [2] * len(times), scalars=values)
        chunks += [static(path, style), *shown(stage.clock, path, times, [FOREVER_NS] * len(times), rows)]
    return chunks


def _signals(stage: Stage, source: str, track: Track) -> list[Chunk]:
    name, planned, chunks = stage.names[track.vehicle_id], source == "planned", []
    place = (source,) if track.vehicle_id in stage.starring else ("quiet", source)
    colour = stage.colours[track.vehicle_id] if planned else stage.recorded_colour(track.vehicle_id)
    for signal, attribute in _SIGNALS.items():
        values = getattr(track, attribute)
        if np.isfinite(values).any():
            style = {"names": [f"{name} {source}"], "colors": [colour], "widths": [2.4 if planned else 1.0]}
            if planned and signal == "jerk":
                style["interpolation_mode"] = [rr.components.InterpolationMode.StepAfter]
            path = entity("plots", signal, *place, name)
            chunks += [static(path, rr.SeriesLines.columns(**style)), *_line(stage, path, track, values)]
    return chunks


def _line(stage: Stage, path: str, track: Track, values: FloatArray) -> list[Chunk]:
    """A line of values (S,) with a gap where the track is interrupted, or may go on in a later part."""
    following = FOREVER_NS if stage.anchor.until_ns is not None else -FOREVER_NS
    breaks = np.flatnonzero(track.ends_ns < np.append(track.times_ns[1:], following)) + 1
    own = stage.in_part(track.times_ns)
    own = np.insert(own, breaks, own[breaks - 1])
    times = np.insert(track.times_ns, breaks, track.ends_ns[breaks - 1])
    return _scalars(stage, path, times[own], np.insert(values, breaks, np.nan)[own])


def _scalars(stage: Stage, path: str, times_ns: IntArray, values: FloatArray) -> list[Chunk]:
    return shown(
        stage.clock, path, times_ns, np.full(len(times_ns), FOREVER_NS), each(rr.Scalars, scalars=values)
    )


def _clearances(stage: Stage, found: list[Clearance]) -> list[Chunk]:
    """Clearances of the closest pairs over all windows, NaN between the windows of a pair."""
    chunks = []
    for number, pair in enumerate(stage.closest):
        for source in ("recorded", "planned"):
            own = [c for c in found if c.pair == pair and c.source == source]
            if not own:
                continue
            times = np.concatenate([np.append(c.times_ns, c.times_ns[-1]) for c in own])
            gaps = np.concatenate([np.append(c.gaps_m, np.nan) for c in own])
            gaps[gaps > HORIZON_M] = np.nan
            name = " / ".join(stage.names[vehicle_id] for vehicle_id in pair)
            colour = PALETTE[number % len(PALETTE)]
            if source == "recorded":
                colour = greyed(colour)
            style = rr.SeriesLines.columns(
                names=[f"{name} {source}"], colors=[colour], widths=[2.4 if source == "planned" else 1.0]
            )
            path = entity("plots", "clearance", source, name)
            chunks += [static(path, style), *_scalars(stage, path, times, gaps)]
    return chunks


# --- manoeuvres ------------------------------------------------------------------------------


def manoeuvres(stage: Stage, vehicle_id: str) -> list[tuple[int, int, str]]:
    """Stretches of a vehicle's states: start and end [ns], and the state."""
    stretches: list[tuple[int, int, str]] = []
    planned = False
    for span in stage.spans:
        track = stage.planned.get((span.index, vehicle_id))
        if track is not None:
            planned = True
            stretches += _window_manoeuvres(span, track, stage.guidance.get((span.index, vehicle_id)))
    recorded = stage.recorded.get(vehicle_id)
    if not planned and recorded is not None:
        own = stage.own(recorded)
        for part in own.segments():
            stretches.append((int(own.times_ns[part][0]), int(own.ends_ns[part][-1]), "not planned"))
    return stretches


def _window_manoeuvres(span: Span, track: Track, guidance: Track | None) -> list[tuple[int, int, str]]:
    times, speeds = track.times_ns, np.abs(track.speeds_mps)
    seconds = (times - times[0]) / 1e9
    yaw_rates = np.abs(np.gradient(track.poses[:, 2], seconds)) if len(times) > 1 else np.zeros(len(times))
    wanted = np.zeros(len(times))
    if guidance is not None and len(guidance.times_ns) > 1:
        own = (guidance.times_ns - times[0]) / 1e9
        steps = np.hypot(*np.gradient(guidance.poses[:, :2], own, axis=0).T)
        wanted = np.interp(seconds, own, steps)
    states = np.select(
        [speeds < STOP_MPS, speeds < YIELD_SHARE * wanted, yaw_rates > TURN_RADPS],
        ["stop", "yield", "turn"],
        "cruise",
    )
    stretches: list[tuple[int, int, str]] = []
    starts = np.concatenate([[0], np.flatnonzero(states[1:] != states[:-1]) + 1])
    ends = [*times[starts[1:]].tolist(), int(track.ends_ns[-1])]
    for start, end, state in zip(times[starts].tolist(), ends, states[starts].tolist(), strict=True):
        start, end = int(start), min(int(end), span.shown_end_ns)
        if stretches and (end - start < _SHORTEST_NS or stretches[-1][2] == state):
            stretches[-1] = (stretches[-1][0], end, stretches[-1][2])
        elif end > start:
            stretches.append((start, end, str(state)))
    return stretches


def _states(stage: Stage, vehicle_id: str) -> list[Chunk]:
    stretches = manoeuvres(stage, vehicle_id)
    if not stretches:
        return []
    times: list[int] = []
    states: list[str] = []
    counts: list[int] = []
    for (start, end, state), following in zip(stretches, [*stretches[1:], None], strict=True):
        times.append(start)
        states.append(state)
        counts.append(1)
        if following is None or end < following[0]:
            times.append(end)
            counts.append(0)  # no state ends the lane
    place = ("states",) if vehicle_id in stage.starring else ("quiet", "states")
    path = entity(*place, stage.names[vehicle_id])
    style = rr.StateConfiguration.columns(
        values=list(_STATE_COLOURS), labels=list(_STATE_COLOURS), colors=list(_STATE_COLOURS.values())
    ).partition([len(_STATE_COLOURS)])
    rows = ragged(rr.StateChange, counts, state=states)
    return [static(path, style), *shown(stage.clock, path, times, [FOREVER_NS] * len(times), rows)]


# --- precedence ------------------------------------------------------------------------------


def precedences(table: pl.DataFrame) -> list[tuple[str, str]]:
    """Who goes before whom, from one window's corridors: pairs (first, second)."""
    box = ["k", "x_min_m", "x_max_m", "y_min_m", "y_max_m"]
    cubes = {
        str(key[0]): own.select(box).to_numpy()
        for key, own in table.sort("vehicle_id", "k").partition_by("vehicle_id", as_dict=True).items()
    }
    edges = []
    for a, b in itertools.combinations(cubes, 2):
        one, two = cubes[a][:, None, :], cubes[b][None, :, :]
        common = (one[..., 1] < two[..., 2]) & (two[..., 1] < one[..., 2])
        common &= (one[..., 3] < two[..., 4]) & (two[..., 3] < one[..., 4])
        if common.any():
            later = float((two[..., 0] - one[..., 0])[common].mean())
            if later != 0.0:
                edges.append((a, b) if later > 0.0 else (b, a))
    return edges


def _precedence(stage: Stage) -> list[Chunk]:
    tables = stage.by_span(stage.result.corridors)
    if not tables:
        return []
    ids = [sorted(set(own["vehicle_id"])) for _, own in tables]
    edges = [precedences(own) for _, own in tables]
    starts, ends = stage.overview([span for span, _ in tables])
    nodes = [stage.names[vehicle_id] for group in ids for vehicle_id in group]
    colours = [stage.colours[vehicle_id] for group in ids for vehicle_id in group]
    pairs = [(stage.names[a], stage.names[b]) for group in edges for a, b in group]
    return shown(
        stage.clock,
        entity("precedence"),
        starts,
        ends,
        ragged(rr.GraphNodes, [len(group) for group in ids], node_ids=nodes, labels=nodes, colors=colours),
        ragged(rr.GraphEdges, [len(group) for group in edges], edges=pairs),
        same(rr.GraphEdges, graph_type=rr.components.GraphType.Directed),
        row_bytes=100.0 * float(np.mean([len(group) + 1 for group in ids])),
    )
