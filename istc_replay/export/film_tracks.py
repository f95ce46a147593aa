"""What moves and stands in a result, for a film of it: unbroken motions, and boxes with their times."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import polars as pl

from istc_replay.config import VehiclesConfig
from istc_replay.datatypes import Dimensions, FloatArray, Log, Window, WindowPlan
from istc_replay.export.colours import OBSTACLE, RECORDED, Colour, vehicle_colour
from istc_replay.export.placing import (
    IntArray,
    PlannedMotion,
    planned_motions,
    topic_name,
    unit_span_ns,
)
from istc_replay.geometry import to_map

LAST_NS = 2**63 - 1
#: How long a vehicle of a single state is shown.
_INSTANT_NS = 100_000_000
#: A step longer than this many median steps is a gap, in which the vehicle is not shown.
_GAP_STEPS = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """An unbroken motion and its looks: `times_ns` (S,), `poses` (S, 3) in the map frame.

    It is to be seen from the first of its times until before `end_ns`.
    """

    entity_id: str
    frame_id: str
    label: str
    colour: Colour
    opacity: float
    length_m: float
    width_m: float
    planned: bool
    times_ns: IntArray
    poses: FloatArray
    end_ns: int


class Block(NamedTuple):
    """A box that is to be seen from start_ns until before end_ns; `pose` is x, y, yaw in the map frame."""

    entity_id: str
    start_ns: int
    end_ns: int
    pose: tuple[float, float, float]
    length_m: float
    width_m: float
    height_m: float
    colour: Colour
    opacity: float


@dataclass(slots=True)
class PlannedTracks:
    """The planned motions of all windows, and the spans of the boxes beside them."""

    tracks: list[Track] = field(default_factory=list)
    dimensions: dict[str, Dimensions] = field(default_factory=dict)
    spans: list[tuple[str, int, int]] = field(default_factory=list)
    boxes: list[tuple[int, int]] = field(default_factory=list)


def planned_tracks(plans: Iterable[WindowPlan], starts_ns: Sequence[int]) -> PlannedTracks:
    """The motions of all windows' plans, each until a later window plans its vehicle again.

    Parameters
    ----------
    plans : iterable of WindowPlan
        In order of their windows.
    starts_ns : sequence of int
        The windows' starts [ns].
    """
    found = PlannedTracks()
    for plan, until_ns in zip(plans, [*starts_ns[1:], LAST_NS], strict=False):
        found.boxes += [(block.start_ns, block.end_ns) for block in blocks(plan, until_ns)]
        for motion in planned_motions(plan):
            found.tracks.append(_planned_track(motion))
            found.dimensions[motion.vehicle_id] = motion.dimensions
            found.spans.append((motion.vehicle_id, int(motion.times_ns[0]), int(motion.times_ns[-1])))
    begins: dict[str, int] = {}
    kept: list[Track] = []
    for track, (vehicle_id, begin_ns, _) in zip(reversed(found.tracks), reversed(found.spans), strict=True):
        kept += _until(track, begins.get(vehicle_id, LAST_NS))
        begins[vehicle_id] = begin_ns
    found.tracks = kept[::-1]
    return found


def recorded_tracks(log: Log, planned: Mapping[str, Dimensions], vehicles: VehiclesConfig) -> Iterator[Track]:
    """Give the recorded motions, each cut at its gaps."""
    for (vehicle_id,), states in log.states.group_by("vehicle_id", maintain_order=True):
        yield from _recorded_tracks(str(vehicle_id), states, planned.get(str(vehicle_id)), vehicles)


def _recorded_tracks(
    vehicle_id: str, states: pl.DataFrame, planned: Dimensions | None, vehicles: VehiclesConfig
) -> Iterator[Track]:
    states = states.sort("time_ns", maintain_order=True)
    name = topic_name(vehicle_id)
    usual = planned or vehicles
    times_ns = states["time_ns"].to_numpy()
    poses = states.select("x_m", "y_m", pl.col("heading_rad").fill_nan(0.0).fill_null(0.0)).to_numpy()
    step_ns = _step_ns(times_ns)
    cuts = np.flatnonzero(np.diff(times_ns) > _GAP_STEPS * step_ns) + 1
    for rows in np.split(np.arange(len(times_ns)), cuts):
        yield Track(
            entity_id=f"recorded/{name}",
            frame_id=f"recorded/{name}",
            label="" if planned else name,
            colour=RECORDED,
            opacity=0.4,
            length_m=_first_known(states["length_m"], usual.length_m),
            width_m=_first_known(states["width_m"], usual.width_m),
            planned=False,
            times_ns=times_ns[rows],
            poses=poses[rows],
            end_ns=_end_ns(times_ns[rows], step_ns),
        )


def _planned_track(motion: PlannedMotion) -> Track:
    name = topic_name(motion.vehicle_id)
    return Track(
        entity_id=f"planned/{name}",
        frame_id=f"vehicle/{name}",
        label=name,
        colour=vehicle_colour(motion.vehicle_id),
        opacity=0.9,
        length_m=motion.dimensions.length_m,
        width_m=motion.dimensions.width_m,
        planned=True,
        times_ns=motion.times_ns,
        poses=motion.poses,
        end_ns=_end_ns(motion.times_ns, _step_ns(motion.times_ns)),
    )


def _until(track: Track, until_ns: int) -> list[Track]:
    """A planned motion as far as no later window plans its vehicle again; nothing where it is all later."""
    kept = track.times_ns < until_ns
    if kept.all():
        return [replace(track, end_ns=min(track.end_ns, until_ns))]
    if not kept.any():
        return []
    step_ns = track.end_ns - int(track.times_ns[-1])
    times_ns = track.times_ns[kept]
    return [
        replace(
            track,
            times_ns=times_ns,
            poses=track.poses[kept],
            end_ns=min(int(times_ns[-1]) + step_ns, until_ns),
        )
    ]


def _step_ns(times_ns: IntArray) -> int:
    steps = np.diff(times_ns)
    steps = steps[steps > 0]
    return int(np.median(steps)) if len(steps) else _INSTANT_NS


def _end_ns(times_ns: IntArray, step_ns: int) -> int:
    return min(int(times_ns[-1]) + max(step_ns, 1), LAST_NS)


def _first_known(sizes_m: pl.Series, default_m: float) -> float:
    known = sizes_m.drop_nulls()
    return float(known[0]) if len(known) else default_m


def blocks(plan: WindowPlan, until_ns: int) -> Iterator[Block]:
    """List a window's corridor-cubes and obstacles' boxes, each for its unit, until the next window."""
    for block in _window_blocks(plan):
        if block.start_ns < until_ns:
            yield block._replace(end_ns=min(block.end_ns, until_ns))


def _window_blocks(plan: WindowPlan) -> Iterator[Block]:
    window = plan.scenario.window
    for corridor in plan.corridors.corridors if plan.corridors is not None else ():
        name, colour = f"corridor/{topic_name(corridor.vehicle_id)}", vehicle_colour(corridor.vehicle_id)
        for row, box in enumerate(corridor.cubes_m):
            yield _block(name, window, corridor.first_unit + row, box, 0.1, colour, 0.3)
    for obstacle in plan.scenario.obstacles:
        name = f"obstacle/{topic_name(obstacle.obstacle_id)}"
        for k, box in enumerate(obstacle.boxes_m):
            if not np.isnan(box).any():
                yield _block(name, window, k, box, 0.5, OBSTACLE, 0.4)


def _block(
    name: str, window: Window, k: int, box: FloatArray, height_m: float, colour: Colour, opacity: float
) -> Block:
    x_min, x_max, y_min, y_max = box.tolist()
    x, y = to_map([(x_min + x_max) / 2.0, (y_min + y_max) / 2.0], window.frame).tolist()
    start_ns, end_ns = unit_span_ns(window, k)
    pose = (x, y, window.frame.yaw_rad)
    return Block(name, start_ns, end_ns, pose, x_max - x_min, y_max - y_min, height_m, colour, opacity)
