"""Eyes that the views follow, so that the layout need not know where and how large a scene is."""

from __future__ import annotations

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from istc_replay.datatypes import FloatArray
from istc_replay.export.rerun.chunks import FOREVER_NS, at_height, each, entity, shown, static
from istc_replay.export.rerun.stage import Stage

#: Vertical field of view.
_FOV_RAD = 0.9
_EYE_AZIMUTH_RAD, _EYE_ELEVATION_RAD, _EYE_TURN_RAD = -1.05, 0.5, 0.35
#: Distance of the oblique eye in radii of the scene, and the share of the height that it looks at.
_EYE_RADII, _EYE_HEIGHT = 0.7, 0.4
#: A long scene is seen from that much further away.
_EYE_BACK = 0.15
#: The close-up shows this much around those whom it follows [m], and moves as often.
_CLOSE_M = 12.0
_STEP_NS = 100_000_000


def eye_chunks(stage: Stage) -> list[Chunk]:
    """Chunks of `/camera`, `/now/camera` and `/now/close_up`; none without a window."""
    return _oblique(stage) + _above(stage) + _close_up(stage) if stage.spans else []


def _pinhole(path: str) -> Chunk:
    """An eye that a view can follow, so that the blueprint need not know the scene's size."""
    batches = rr.Pinhole(
        fov_y=_FOV_RAD, aspect_ratio=1.0, image_plane_distance=1e-3, line_width=0.0
    ).as_component_batches()
    return static(path, [rr.ComponentColumn(batch.component_descriptor(), batch) for batch in batches])


def _eye_times(stage: Stage) -> list[int]:
    """Since when each window's eye is in force: the first since the first record."""
    return [stage.first_ns, *(span.start_ns for span in stage.spans[1:])]


def _oblique(stage: Stage) -> list[Chunk]:
    """The eye of the (x, y, t) view."""
    places, turns = [], []
    for span in stage.spans:
        ground = stage.grounds[span.index]
        # A long scene is seen rather from its side.
        long = float(np.tanh(np.log(ground.half_m[0] / ground.half_m[1])))
        azimuth = ground.yaw_rad + _EYE_AZIMUTH_RAD - _EYE_TURN_RAD * long
        flat = np.cos(_EYE_ELEVATION_RAD)
        look = -np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(_EYE_ELEVATION_RAD)])
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        turns.append(np.column_stack([right, np.cross(look, right), look]))  # the image's right, down, ahead
        top = span.duration_s * stage.metres_per_second
        radius = np.linalg.norm([*ground.half_m, top / 2.0]) * (1.0 + _EYE_BACK * abs(long))
        centre = np.append(ground.centre_m, _EYE_HEIGHT * top)
        places.append(centre - look * _EYE_RADII * radius / np.sin(_FOV_RAD / 2.0))
    path, rows = entity("camera"), len(places)
    columns = each(rr.Transform3D, translation=np.array(places), mat3x3=np.array(turns))
    return [_pinhole(path), *shown(stage.clock, path, _eye_times(stage), [FOREVER_NS] * rows, columns)]


def _above(stage: Stage) -> list[Chunk]:
    """The eye of the view from above, over the whole window."""
    grounds = [stage.grounds[span.index] for span in stage.spans]
    heights = [1.05 * ground.half_m.max() / np.tan(_FOV_RAD / 2.0) for ground in grounds]
    path, rows = entity("now", "camera"), len(grounds)
    places = at_height(np.array([ground.centre_m for ground in grounds]), heights)
    turns = np.array([_from_above(ground.yaw_rad) for ground in grounds])
    columns = each(rr.Transform3D, translation=places, mat3x3=turns)
    return [_pinhole(path), *shown(stage.clock, path, _eye_times(stage), [FOREVER_NS] * rows, columns)]


def _from_above(yaw_rad: float) -> FloatArray:
    """An eye's axes (right, down, ahead as columns) that looks down, x of the turned frame to the right."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])


def _close_up(stage: Stage) -> list[Chunk]:
    """An eye above those whom one asked for, or else above the pair that comes closest."""
    times, places, turns = [], [], []
    for span in stage.spans:
        own = np.arange(span.start_ns, max(span.shown_end_ns, span.start_ns + 1), _STEP_NS, dtype=np.int64)
        tracks = [
            stage.planned.get((span.index, vehicle_id)) or stage.recorded.get(vehicle_id)
            for vehicle_id in stage.follows[span.index]
        ]
        boxes = np.array([track.boxes_at(own) for track in tracks if track is not None])
        centres = np.tile(stage.grounds[span.index].centre_m, (len(own), 1))
        reach = np.full(len(own), stage.grounds[span.index].half_m.max())
        if boxes.size:
            low, high = _range(boxes[..., :2])
            seen = np.isfinite(low[:, 0])
            centres[seen] = ((low + high) / 2.0)[seen]
            reach[seen] = np.clip((high - low).max(axis=1) / 2.0 + _CLOSE_M, None, reach[0])[seen]
        times.append(own)
        places.append(at_height(centres, reach / np.tan(_FOV_RAD / 2.0)))
        turns.append(np.tile(_from_above(span.frame.yaw_rad), (len(own), 1, 1)))
    path, at = entity("now", "close_up"), np.concatenate(times)
    columns = each(rr.Transform3D, translation=np.concatenate(places), mat3x3=np.concatenate(turns))
    chunks = shown(stage.clock, path, at, np.full(len(at), FOREVER_NS), columns, row_bytes=90.0)
    return [_pinhole(path), *chunks]


def _range(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and largest coordinates (T, 2) of points (V, T, 2); NaN where there is none."""
    absent = np.isnan(points_m)
    low = np.where(absent, np.inf, points_m).min(axis=0)
    high = np.where(absent, -np.inf, points_m).max(axis=0)
    return np.where(np.isfinite(low), low, np.nan), np.where(np.isfinite(high), high, np.nan)
