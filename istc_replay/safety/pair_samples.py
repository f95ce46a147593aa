"""Every measure of every pair that is near enough to matter, at the common times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from istc_replay.config import HARDEST_BRAKING_MPS2, AuditConfig
from istc_replay.datatypes import FloatArray
from istc_replay.errors import LogError
from istc_replay.safety.bodies import Body
from istc_replay.safety.braking import required_deceleration
from istc_replay.safety.broad_phase import overlapping_pairs, reach_hulls
from istc_replay.safety.encroachment import encroachments
from istc_replay.safety.relation import CONFLICT_TYPES, conflict_angle, conflict_type, delta_v, headway
from istc_replay.safety.rss import RssParameters, rss_margin, safe_distance_same
from istc_replay.safety.swept import pair_measures, silhouette_overlap
from istc_replay.states import PAIR_SAMPLES_SCHEMA, conform
from istc_replay.units import NS_PER_S

IntArray = NDArray[np.int64]

#: States of all bodies worked on at once; this bounds the memory whatever the log's length.
_CHUNK_STATES = 20_000
#: Pair samples of one log.
_MOST_SAMPLES = 20_000_000
#: Footprints kept for the post-encroachment times reach this much further than the longest one.
_HALO_S = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Columns of the pair samples, sorted by first, second, time; (n,) each.

    `first` and `second` are rows of the bodies; those of `speeds` theirs, `follower_mps` that of
    the follower (NaN where nobody follows); `x_m`, `y_m` half way between the centres.
    """

    first: IntArray
    second: IntArray
    time_ns: IntArray
    values: dict[str, FloatArray]

    def __getitem__(self, name: str) -> FloatArray:
        return self.values[name]

    @property
    def key(self) -> IntArray:
        """One number a pair."""
        return self.first * (1 << 32) + self.second


@dataclass(frozen=True, slots=True, eq=False)
class Encroachments:
    """Post-encroachment times, sorted by first, second, earlier; (n,) each.

    The first body was there first, at `earlier_ns`, the second at `later_ns`.
    """

    first: IntArray
    second: IntArray
    earlier_ns: IntArray
    later_ns: IntArray
    angle_rad: FloatArray
    x_m: FloatArray
    y_m: FloatArray

    @property
    def key(self) -> IntArray:
        """One number an ordered pair."""
        return self.first * (1 << 32) + self.second


def rss_parameters(audit: AuditConfig) -> RssParameters:
    """The RSS parameters of a configuration."""
    return RssParameters(
        response_s=audit.rss_response_s,
        acceleration_mps2=audit.rss_acceleration_mps2,
        least_braking_mps2=audit.rss_least_braking_mps2,
        most_braking_mps2=audit.rss_most_braking_mps2,
        correct_braking_mps2=audit.rss_correct_braking_mps2,
        lateral_acceleration_mps2=audit.rss_lateral_acceleration_mps2,
        lateral_braking_mps2=audit.rss_lateral_braking_mps2,
        margin_m=audit.rss_margin_m,
    )


def sample_pairs(bodies: list[Body], times_ns: IntArray, audit: AuditConfig) -> tuple[Pairs, Encroachments]:
    """Measure all pairs at all common times, in chunks of time.

    Parameters
    ----------
    bodies : list[Body]
        Who was recorded.
    times_ns : ndarray
        (T,) the common times.
    audit : AuditConfig
        How far to look.

    Returns
    -------
    Pairs, Encroachments
        Rows of pairs that touch within the horizon at their velocities, are near, follow each
        other within the horizon or break RSS; and who was where another came to be.
    """
    rows: list[dict[str, NDArray[np.generic]]] = []
    left: list[dict[str, NDArray[np.generic]]] = []
    # Of many who come and go only those who are there at once count.
    spans = np.array([body.track.times_ns[[0, -1]] for body in bodies], dtype=np.int64).reshape(-1, 2)
    together = sum(body.track.times_ns.size for body in bodies) / max(times_ns.size, 1)
    size = max(int(_CHUNK_STATES / max(together, 1.0)), 1)
    sampled = 0
    halo_ns = int((audit.pet_minor_s + _HALO_S) * NS_PER_S)
    for start in range(0, times_ns.size, size):
        own = times_ns[start : start + size]
        until = int(np.searchsorted(times_ns, own[-1] + halo_ns, side="right"))
        chunk = times_ns[start:until]
        here = np.flatnonzero((spans[:, 0] <= chunk[-1]) & (spans[:, 1] >= chunk[0])).tolist()
        if len(here) < 2:
            continue
        boxes = np.full((chunk.size, len(here), 5), np.nan)
        speeds = np.full((chunk.size, len(here)), np.nan)
        bounds = np.zeros((own.size, len(here)))
        for column, row in enumerate(here):
            boxes[:, column], speeds[:, column] = bodies[row].boxes(chunk)
            bounds[:, column] = bodies[row].bound_m(own, audit.acceleration_bound_mps2)
        # Reversing: a box turned by half a turn is the same box, and drives along its heading.
        boxes[..., 2] += np.where(speeds < 0.0, np.pi, 0.0)
        speeds = np.abs(speeds)
        names = np.asarray(here, dtype=np.int64)
        if sampled > _MOST_SAMPLES:
            raise LogError(f"the log has more than {_MOST_SAMPLES} pair samples; audit it in parts")
        rows.append(_chunk_pairs(boxes[: own.size], speeds[: own.size], bounds, own, names, audit))
        sampled += rows[-1]["first"].size
        left.append(_chunk_encroachments(boxes, chunk, own[-1], names, audit))
    return _pairs(rows), _encroachments(left)


def pairs_table(pairs: Pairs, names: list[str]) -> pl.DataFrame:
    """The table of PAIR_SAMPLES_SCHEMA."""
    # The last entry is what -1 stands for.
    labels, kinds = (np.asarray([*known, None], dtype=object) for known in (names, CONFLICT_TYPES))
    follower = pairs["follower"].astype(np.int64)
    table = pl.DataFrame(
        {
            "first": _strings(labels[pairs.first]),
            "second": _strings(labels[pairs.second]),
            "time_ns": pairs.time_ns,
            "follower": _strings(labels[follower]),
            "conflict_type": _strings(kinds[pairs["conflict_type"].astype(np.int64)]),
            **{
                name: pairs[name]
                for name in PAIR_SAMPLES_SCHEMA
                if name in pairs.values and name not in ("follower", "conflict_type")
            },
        }
    )
    return conform(table.with_columns(pl.col(pl.Float64).fill_nan(None)), PAIR_SAMPLES_SCHEMA)


def _strings(values: NDArray[np.object_]) -> pl.Series:
    return pl.Series(values.tolist(), dtype=pl.String)


@dataclass(frozen=True, slots=True, eq=False)
class _Near:
    """Pairs that are near each other, or to contact: (n,) rows of boxes `i` and `j`, and what was measured.

    `thw_s` is the headway of whoever follows, and `first_thw_s` that of the first.
    """

    i: IntArray
    j: IntArray
    gap_m: FloatArray
    ttc_s: FloatArray
    drac_mps2: FloatArray
    margin_m: FloatArray
    first_thw_s: FloatArray
    thw_s: FloatArray


def _near(
    flat: FloatArray, speed: FloatArray, velocity: FloatArray, group: IntArray, audit: AuditConfig
) -> _Near:
    """Of boxes (n, 5), one `group` (n,) an instant, the pairs of an instant that are looked at."""
    rss = rss_parameters(audit)
    least = safe_distance_same(speed, np.zeros_like(speed), rss)
    low, high = reach_hulls(flat, velocity, audit.horizon_s, least, audit.near_m)
    i, j = overlapping_pairs(low, high, group)
    a, b = flat[i], flat[j]
    gap, ttc, drac = pair_measures(a, b, velocity[j] - velocity[i])
    limits = (audit.rear_end_rad, audit.head_on_rad)
    margin = rss_margin(a, b, (speed[i], speed[j]), rss, limits)
    _, one = headway(a, b, speed[i], moving_mps=audit.moving_mps, same_path_rad=audit.rear_end_rad)
    _, two = headway(b, a, speed[j], moving_mps=audit.moving_mps, same_path_rad=audit.rear_end_rad)
    thw = np.fmin(one, two)
    keep = np.flatnonzero(
        (gap <= audit.near_m) | (ttc <= audit.horizon_s) | (thw <= audit.horizon_s) | (margin < 0.0)
    )
    return _Near(i[keep], j[keep], *(x[keep] for x in (gap, ttc, drac, margin, one, thw)))


def _chunk_pairs(
    boxes: FloatArray,
    speeds: FloatArray,
    bounds: FloatArray,
    times_ns: IntArray,
    names: IntArray,
    audit: AuditConfig,
) -> dict[str, NDArray[np.generic]]:
    count = names.size
    flat, speed, bound = boxes.reshape(-1, 5), speeds.ravel(), bounds.ravel()
    velocity = np.stack([np.cos(flat[:, 2]), np.sin(flat[:, 2])], axis=-1) * speed[:, None]
    near = _near(flat, speed, velocity, np.repeat(np.arange(times_ns.size), count), audit)
    i, j, gap, ttc = near.i, near.j, near.gap_m, near.ttc_s
    a, b, relative = flat[i], flat[j], velocity[j] - velocity[i]
    lead = np.where(np.isnan(near.thw_s), -1, np.where(near.thw_s == near.first_thw_s, i, j))  # who follows
    follower = np.where(lead < 0, -1, names[lead % count])
    angle = conflict_angle(a[:, 2], b[:, 2])
    changes = delta_v(a, b, relative)
    return {
        "first": names[i % count],
        "second": names[j % count],
        "time_ns": times_ns[i // count],
        "gap_m": gap,
        "gap_bound_m": bound[i] + bound[j],
        "relative_speed_mps": np.hypot(relative[:, 0], relative[:, 1]),
        "ttc_s": ttc,
        "silhouette_m": silhouette_overlap(a, b, relative),
        "drac_mps2": np.minimum(near.drac_mps2, HARDEST_BRAKING_MPS2),
        "required_first_mps2": _required(a, b, velocity[i], velocity[j], gap, ttc, audit),
        "required_second_mps2": _required(b, a, velocity[j], velocity[i], gap, ttc, audit),
        "follower": follower.astype(np.float64),
        "follower_mps": np.where(lead < 0, np.nan, speed[lead]),
        "thw_s": near.thw_s,
        "rss_margin_m": near.margin_m,
        "angle_rad": angle,
        "conflict_type": conflict_type(
            angle, (audit.rear_end_rad, audit.crossing_rad, audit.head_on_rad)
        ).astype(np.float64),
        "delta_v_first_mps": changes[0],
        "delta_v_second_mps": changes[1],
        "fastest_mps": np.fmax(speed[i], speed[j]),
        "x_m": (a[:, 0] + b[:, 0]) / 2.0,
        "y_m": (a[:, 1] + b[:, 1]) / 2.0,
    }


def _required(
    a: FloatArray,
    b: FloatArray,
    own: FloatArray,
    other: FloatArray,
    gap: FloatArray,
    ttc: FloatArray,
    audit: AuditConfig,
) -> FloatArray:
    """Required braking where contact is ahead within the horizon; 0 where not, inf where none avoids it."""
    needed = np.where(np.isnan(ttc), np.nan, np.where(gap <= 0.0, np.inf, 0.0))
    ahead = np.flatnonzero((ttc <= audit.horizon_s) & (gap > 0.0))
    needed[ahead] = required_deceleration(a[ahead], b[ahead], own[ahead], other[ahead])
    return np.where(np.isfinite(needed), np.minimum(needed, HARDEST_BRAKING_MPS2), needed)


def _chunk_encroachments(
    boxes: FloatArray, times_ns: IntArray, last_ns: int, names: IntArray, audit: AuditConfig
) -> dict[str, NDArray[np.generic]]:
    times_s = (times_ns - times_ns[0]) / NS_PER_S
    earlier, later, first, second = encroachments(
        boxes, times_s, longest_s=audit.pet_minor_s, least_angle_rad=audit.rear_end_rad
    )
    own = times_ns[earlier] <= last_ns
    earlier, later, first, second = (x[own] for x in (earlier, later, first, second))
    place = (boxes[earlier, first, :2] + boxes[later, second, :2]) / 2.0
    return {
        "first": names[first],
        "second": names[second],
        "earlier_ns": times_ns[earlier],
        "later_ns": times_ns[later],
        "angle_rad": conflict_angle(boxes[earlier, first, 2], boxes[later, second, 2]),
        "x_m": place[:, 0],
        "y_m": place[:, 1],
    }


def _pairs(chunks: list[dict[str, NDArray[np.generic]]]) -> Pairs:
    columns = _joined(chunks, ("first", "second", "time_ns"), _PAIR_COLUMNS)
    keys = {name: columns.pop(name).astype(np.int64) for name in ("first", "second", "time_ns")}
    return Pairs(**keys, values={name: values.astype(np.float64) for name, values in columns.items()})


def _encroachments(chunks: list[dict[str, NDArray[np.generic]]]) -> Encroachments:
    order = ("first", "second", "earlier_ns", "later_ns")
    columns = _joined(chunks, order, (*order, "angle_rad", "x_m", "y_m"))
    whole = [columns[name].astype(np.int64) for name in order]
    rest = [columns[name].astype(np.float64) for name in ("angle_rad", "x_m", "y_m")]
    return Encroachments(whole[0], whole[1], whole[2], whole[3], rest[0], rest[1], rest[2])


def _joined(
    chunks: list[dict[str, NDArray[np.generic]]], order: tuple[str, ...], names: tuple[str, ...]
) -> dict[str, NDArray[np.generic]]:
    if not chunks:
        return {name: np.empty(0) for name in names}
    columns = {name: np.concatenate([chunk[name] for chunk in chunks]) for name in names}
    sorting = np.lexsort([columns[name] for name in reversed(order)])
    return {name: values[sorting] for name, values in columns.items()}


_PAIR_COLUMNS = (
    "first",
    "second",
    "time_ns",
    "gap_m",
    "gap_bound_m",
    "relative_speed_mps",
    "ttc_s",
    "silhouette_m",
    "drac_mps2",
    "required_first_mps2",
    "required_second_mps2",
    "follower",
    "follower_mps",
    "thw_s",
    "rss_margin_m",
    "angle_rad",
    "conflict_type",
    "delta_v_first_mps",
    "delta_v_second_mps",
    "fastest_mps",
    "x_m",
    "y_m",
)
