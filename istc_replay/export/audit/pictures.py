"""The pictures of the audit: when findings lie, and how each serious encounter looked from above."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from istc_replay.datatypes import FloatArray
from istc_replay.export.colours import PALETTE
from istc_replay.export.figures.style import (
    CONTACT,
    GRID,
    INK,
    MARKERS,
    MUTED,
    PAPER,
    VehicleStyle,
    line_colour,
    new_figure,
    vehicle_legend,
    vehicle_styles,
)
from istc_replay.geometry import box_corners
from istc_replay.safety.bodies import Body, recorded_bodies
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.log_audit import Audit
from istc_replay.safety.rules import PAIR_RULES, RULE_NAMES
from istc_replay.units import NS_PER_S

IntArray = NDArray[np.int64]

#: Colour, marker and size of each severity: told apart without colour as well.
SEVERITY_LOOKS: dict[str | None, tuple[str, str, float]] = {
    "critical": (CONTACT, "X", 7.0),
    "serious": ("#c07a00", "D", 5.0),
    "minor": (MUTED, "o", 3.5),
    None: (MUTED, "|", 6.0),
}
_WIDTH_IN = 9.9
#: What is shown before and after an encounter [s], and about its boxes [m].
_AROUND_S, _REACH_M, _MOST_REACH_M = 3.0, 12.0, 60.0
#: Marks of one rule and severity on the timeline are told apart to this share of the log.
_MARKS = 600


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What the pictures are drawn of: bodies by name with their styles, and the log's start."""

    audit: Audit
    bodies: dict[str, Body]
    styles: dict[str, VehicleStyle]
    start_ns: int

    def seconds(self, times_ns: IntArray) -> FloatArray:
        """Times from the log's start [s]."""
        return (np.asarray(times_ns) - self.start_ns) / NS_PER_S


def recording_of(audit: Audit) -> Recording:
    """Gather what an audit's pictures show."""
    bodies = {b.name: b for b in recorded_bodies(audit.log.states, audit.config.vehicles)}
    first = audit.log.states["time_ns"].min()
    return Recording(audit, bodies, vehicle_styles(bodies), first if isinstance(first, int) else 0)


def draw_timeline(recording: Recording) -> Figure:
    """Draw each finding as a bar over its time, a row a rule, marked where it is worst."""
    findings = recording.audit.findings
    rules = [rule for rule in RULE_NAMES if rule in set(findings["rule"])]
    figure = new_figure(_WIDTH_IN, 0.9 + 0.24 * len(rules))
    height = 0.9 + 0.24 * len(rules)
    axes = figure.add_axes((0.19, 0.48 / height, 0.79, 0.24 * len(rules) / height))
    rows = {rule: row for row, rule in enumerate(rules)}
    times = recording.audit.log.states["time_ns"]
    last = float(recording.seconds(np.array([times.max() if times.len() else 0]))[0])
    for severity, (colour, marker, size) in reversed(SEVERITY_LOOKS.items()):
        own = _thinned(findings.filter(pl.col("severity").eq_missing(severity)), recording.start_ns, last)
        if own.is_empty():
            continue
        y = np.array([rows[rule] for rule in own["rule"]])
        start, worst, end = (recording.seconds(own[n].to_numpy()) for n in ("start_ns", "worst_ns", "end_ns"))
        bars = np.stack([np.column_stack([start, y]), np.column_stack([end, y])], axis=1)
        axes.add_collection(LineCollection(list(bars), colors=colour, linewidths=3.0, alpha=0.45))
        axes.plot(worst, y, marker, color=colour, markersize=size, linestyle="none", mew=1.2)
    axes.set_xlim(0.0, max(last, 0.1))
    axes.set_ylim(len(rules) - 0.4, -0.6)
    axes.set_yticks(range(len(rules)), [rule.replace("_", " ") for rule in rules])
    axes.set_xlabel("time from the log's first state [s]")
    handles = [
        Line2D([], [], color=colour, marker=marker, markersize=size, linestyle="none")
        for colour, marker, size in SEVERITY_LOOKS.values()
    ]
    names = ["critical", "serious", "minor", "data in doubt"]
    figure.legend(handles, names, loc="upper right", ncols=4, bbox_to_anchor=(0.99, 1.0))
    return figure


def _thinned(findings: pl.DataFrame, start_ns: int, last_s: float) -> pl.DataFrame:
    """Findings of one rule whose marks would cover each other, joined."""
    width_ns = max(int(last_s * NS_PER_S / _MARKS), 1)
    mark = (pl.col("worst_ns") - start_ns) // width_ns
    spans = (pl.col("start_ns").min(), pl.col("worst_ns").first(), pl.col("end_ns").max())
    return findings.group_by("rule", mark.alias("mark"), maintain_order=True).agg(spans)


def draw_encounter(recording: Recording, row: dict[str, Any]) -> Figure | None:
    """Draw an encounter from above at its worst instant, and its gap, TTC and speeds over time."""
    pair = [recording.bodies.get(str(row[side])) for side in ("first", "second")]
    if pair[0] is None or pair[1] is None:
        return None
    one, two = pair[0], pair[1]
    recording = replace(recording, styles={**recording.styles, **_told_apart(recording, one.name, two.name)})
    when = row["least_gap_ns"] if row["least_gap_ns"] is not None else row["worst_ns"]
    figure = new_figure(_WIDTH_IN, 4.6)
    above = figure.add_axes((0.06, 0.13, 0.43, 0.78))
    _draw_above(above, recording, (one, two), row, int(row["worst_ns"]))
    span = (int(row["start_ns"]) - _ns(_AROUND_S), int(row["end_ns"]) + _ns(_AROUND_S))
    times = np.unique(np.concatenate([_within(body.track.times_ns, span) for body in (one, two)]))
    plots = [figure.add_axes((0.58, 0.13 + 0.275 * (2 - k), 0.4, 0.215)) for k in range(3)]
    _draw_gap(plots[0], recording, (one, two), times, int(when))
    _draw_ttc(plots[1], recording, row, span)
    _draw_speeds(plots[2], recording, (one, two), times)
    for axes in plots:
        axes.axvspan(*recording.seconds(np.array([row["start_ns"], row["end_ns"]])), color=GRID, alpha=0.5)
        axes.axvline(recording.seconds(np.array([row["worst_ns"]]))[0], color=INK, linewidth=0.8)
        axes.set_xlim(*recording.seconds(np.array(span)))
    plots[0].set_xticklabels([])
    plots[1].set_xticklabels([])
    plots[2].set_xlabel("time from the log's first state [s]")
    vehicle_legend(figure, [recording.styles[b.name] for b in (one, two)], loc="lower left", ncols=2)
    return figure


def _told_apart(recording: Recording, first: str, second: str) -> dict[str, VehicleStyle]:
    """The styles of a pair; of one colour, as colours repeat, the second gets another one."""
    one, two = recording.styles[first], recording.styles[second]
    if one.colour == two.colour:
        two = replace(two, colour=next(c for c in map(line_colour, PALETTE) if c != one.colour))
    if one.marker == two.marker:
        two = replace(two, marker=next(m for m in MARKERS if m != one.marker))
    return {first: one, second: two}


def _ns(seconds: float) -> int:
    return round(seconds * NS_PER_S)


def _within(times_ns: IntArray, span: tuple[int, int]) -> IntArray:
    return times_ns[(times_ns >= span[0]) & (times_ns <= span[1])]


def _draw_above(
    axes: Axes, recording: Recording, pair: tuple[Body, Body], row: dict[str, Any], worst_ns: int
) -> None:
    at = np.array([worst_ns])
    boxes = {name: body.boxes(at)[0][0] for name, body in recording.bodies.items()}
    own = [boxes[body.name] for body in pair]
    known = [box for box in own if np.isfinite(box).all()]
    middle = np.mean([box[:2] for box in known], axis=0) if known else np.array([row["x_m"], row["y_m"]])
    apart = max((float(np.hypot(*(box[:2] - middle)) + box[3]) for box in known), default=0.0)
    speed = max((body.fastest_mps() for body in pair), default=0.0)
    reach = min(max(_REACH_M, apart + 2.0, 1.2 * speed), max(_MOST_REACH_M, apart + 2.0))
    _draw_ground(axes, recording, middle, reach)
    for body in pair:
        _draw_trail(axes, recording, body, row, middle)
    others = [
        box for name, box in boxes.items() if name not in {b.name for b in pair} and np.isfinite(box).all()
    ]
    _draw_boxes(axes, others, [GRID] * len(others), middle, 0.9)
    _draw_boxes(axes, known, [recording.styles[b.name].colour for b in pair], middle, 0.6)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(f"at {recording.seconds(at)[0]:.2f} s; axes about x {middle[0]:.1f}, y {middle[1]:.1f} m")


def _draw_ground(axes: Axes, recording: Recording, middle: FloatArray, reach: float) -> None:
    scene = recording.audit.log.scene
    lines = [line.points_m - middle for line in scene.lane_lines if line.points_m.shape[0] > 1]
    edges = [edge - middle for edge in scene.edges_m if (np.abs(edge - middle) < 4.0 * reach).any()]
    axes.add_collection(LineCollection(edges, colors=MUTED, linewidths=0.7, zorder=0), autolim=False)
    near = [line for line in lines if (np.abs(line) < 4.0 * reach).any()]
    axes.add_collection(LineCollection(near, colors=GRID, linewidths=1.0, zorder=0), autolim=False)
    standing = [
        box_corners(o.x_m, o.y_m, o.heading_rad, o.length_m, o.width_m) - middle for o in scene.obstacles
    ]
    axes.add_collection(
        PolyCollection(standing, facecolors="none", edgecolors=MUTED, hatch="////", zorder=1), autolim=False
    )


def _draw_trail(
    axes: Axes, recording: Recording, body: Body, row: dict[str, Any], middle: FloatArray
) -> None:
    span = (int(row["start_ns"]) - _ns(_AROUND_S), int(row["end_ns"]) + _ns(_AROUND_S))
    times = _within(body.track.times_ns, span)
    boxes, _ = body.boxes(times)
    style = recording.styles[body.name]
    points = boxes[:, :2] - middle
    axes.plot(*points.T, color=style.colour, linewidth=1.3, zorder=2)
    seconds = recording.seconds(times)
    whole = np.arange(np.ceil(seconds[0]), seconds[-1] + 1e-9) if times.size else np.empty(0)
    for second in whole:
        x, y = (np.interp(second, seconds, column) for column in points.T)
        axes.plot(x, y, style.marker, color=style.colour, markersize=4, mfc=PAPER, zorder=2)
        beside: dict[str, Any] = {"xytext": (4, 4), "textcoords": "offset points", "annotation_clip": True}
        axes.annotate(f"{second:.0f}", (x, y), fontsize=6, color=MUTED, **beside)


def _draw_boxes(
    axes: Axes, boxes: list[FloatArray], colours: list[str], middle: FloatArray, alpha: float
) -> None:
    if not boxes:
        return
    corners = box_corners(*np.array(boxes).T) - middle
    axes.add_collection(
        PolyCollection(
            list(corners),
            facecolors=[to_rgba(colour, alpha) for colour in colours],
            edgecolors=INK,
            linewidths=0.9,
            zorder=3,
        ),
        autolim=False,
    )
    noses = np.stack([corners.mean(axis=1), corners[:, :2].mean(axis=1)], axis=1)
    axes.add_collection(LineCollection(list(noses), colors=INK, linewidths=0.9, zorder=4), autolim=False)


def _draw_gap(
    axes: Axes, recording: Recording, pair: tuple[Body, Body], times_ns: IntArray, least_ns: int
) -> None:
    gap = box_gap(pair[0].boxes(times_ns)[0], pair[1].boxes(times_ns)[0])
    axes.plot(recording.seconds(times_ns), gap, color=INK, linewidth=1.2)
    least = box_gap(pair[0].boxes(np.array([least_ns]))[0], pair[1].boxes(np.array([least_ns]))[0])
    if np.isfinite(least).all():
        axes.plot(recording.seconds(np.array([least_ns])), least, "o", color=INK, markersize=3.5)
    _thresholds(axes, recording, "gap")
    axes.set_ylabel("gap [m]")
    if np.isfinite(gap).any():
        top = max(float(np.nanmin(gap)) + 6.0, 3.0)
        axes.set_ylim(min(float(np.nanmin(gap)), 0.0) - 0.3, top)


def _draw_ttc(axes: Axes, recording: Recording, row: dict[str, Any], span: tuple[int, int]) -> None:
    samples = recording.audit.pair_samples.filter(
        pl.col("first") == row["first"],
        pl.col("second") == row["second"],
        pl.col("time_ns").is_between(*span),
        pl.col("ttc_s").is_finite(),
    )
    axes.plot(
        recording.seconds(samples["time_ns"].to_numpy()), samples["ttc_s"], ".", color=INK, markersize=4
    )
    _thresholds(axes, recording, "ttc")
    axes.set(ylabel="TTC [s]", ylim=(-0.2, recording.audit.config.audit.horizon_s))


def _draw_speeds(axes: Axes, recording: Recording, pair: tuple[Body, Body], times_ns: IntArray) -> None:
    for body in pair:
        style, own = recording.styles[body.name], np.isin(body.track.times_ns, times_ns)
        seconds = recording.seconds(body.track.times_ns[own])
        axes.plot(seconds, body.track.states[own, 3], color=style.colour, linewidth=1.3)
    axes.set_ylabel("speed [m/s]")
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))


def _thresholds(axes: Axes, recording: Recording, name: str) -> None:
    rule = next(rule for rule in PAIR_RULES if rule.name == name)
    for severity, level, _ in rule.thresholds(recording.audit.config.audit):
        axes.axhline(level, color=SEVERITY_LOOKS[severity][0], linewidth=0.8, linestyle=(0, (4, 2)))
