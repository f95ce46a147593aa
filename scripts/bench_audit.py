"""Time the audit: its kernel beside shapely and a published formula, and whole logs of growing length.

The published formula is the two-dimensional time to collision by rays: from the corners of either
box along the relative velocity to the edges of the other.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from collections.abc import Callable

import numpy as np
import polars as pl
import shapely
from numpy.typing import NDArray

from istc_replay.config import Config
from istc_replay.datatypes import Log, StaticScene
from istc_replay.geometry import box_corners
from istc_replay.safety.boxes import box_gap
from istc_replay.safety.log_audit import audit_log
from istc_replay.safety.swept import pair_measures
from istc_replay.states import STATES_SCHEMA, conform

Array = NDArray[np.float64]
NS = 1_000_000_000


def random_pairs(count: int) -> tuple[Array, Array, Array]:
    """Boxes of vehicles in a square of 40 m, and their relative velocities."""
    rng = np.random.default_rng(0)
    a, b = (
        np.column_stack(
            [
                rng.uniform(-20, 20, (count, 2)),
                rng.uniform(-np.pi, np.pi, count),
                rng.uniform(3.5, 6.0, count),
                rng.uniform(1.6, 2.2, count),
            ]
        )
        for _ in range(2)
    )
    return a, b, rng.normal(0.0, 8.0, (count, 2))


def rate(work: Callable[[], object], count: int, repeats: int = 3) -> float:
    """Pairs a second, the best of a few runs."""
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return count / best


def ray_times(a: Array, b: Array, velocity: Array) -> Array:
    """Time to collision by rays from corners to edges; it knows no overlap."""
    corners = [box_corners(*boxes.T) for boxes in (a, b)]
    times = np.full(a.shape[0], np.inf)
    for own, other, ray in ((corners[0], corners[1], -velocity), (corners[1], corners[0], velocity)):
        for corner in range(4):
            for edge in range(4):
                start, chord = own[:, corner], other[:, edge - 1] - other[:, edge]
                offset = other[:, edge] - start
                # The other box stands still and the corner moves against the relative velocity.
                cross = ray[:, 1] * chord[:, 0] - ray[:, 0] * chord[:, 1]
                with np.errstate(divide="ignore", invalid="ignore"):
                    t = (offset[:, 1] * chord[:, 0] - offset[:, 0] * chord[:, 1]) / cross
                    u = (offset[:, 1] * ray[:, 0] - offset[:, 0] * ray[:, 1]) / cross
                times = np.where((t >= 0.0) & (u >= 0.0) & (u <= 1.0) & (t < times), t, times)
    return times


def kernels(count: int) -> dict[str, object]:
    """Rates of the kernel and of its peers on the same pairs, and where they disagree."""
    a, b, velocity = random_pairs(count)
    few = slice(0, count // 10)

    def by_shapely() -> Array:
        one, two = (shapely.polygons(box_corners(*boxes[few].T)) for boxes in (a, b))
        return np.asarray(shapely.distance(one, two))

    gap, ttc, _ = pair_measures(a, b, velocity)
    rays, apart = ray_times(a, b, velocity), gap > 0.0
    same = np.isclose(rays, ttc, rtol=1e-6, atol=1e-6)
    return {
        "pairs": count,
        "gap_ttc_drac_pairs_per_s": round(rate(lambda: pair_measures(a, b, velocity), count)),
        "gap_pairs_per_s": round(rate(lambda: box_gap(a, b), count)),
        "shapely_distance_pairs_per_s": round(rate(by_shapely, len(a[few]))),
        "rays_ttc_pairs_per_s": round(rate(lambda: ray_times(a, b, velocity), count)),
        "largest_difference_from_shapely_m": float(np.abs(np.maximum(gap[few], 0.0) - by_shapely()).max()),
        "collisions": int((np.isfinite(ttc) & apart).sum()),
        "rays_differ_apart": int((~same & apart).sum()),
        "overlaps": int((~apart).sum()),
        "rays_differ_overlapping": int((~same & ~apart).sum()),
    }


def traffic(vehicles: int, seconds: float) -> Log:
    """Vehicles on closed paths that cross, at 10 Hz and about 10 m/s, in a town of half a kilometre."""
    rng = np.random.default_rng(1)
    times = np.arange(0.0, seconds, 0.1)
    stamps = np.round(times * NS).astype(np.int64)
    parts = []
    for k in range(vehicles):
        wide, high = rng.uniform(80.0, 250.0, 2)
        rate_x, rate_y = rng.uniform(8.0, 12.0) / wide, rng.uniform(4.0, 8.0) / high
        phase_x, phase_y = rng.uniform(0.0, 2 * np.pi, 2)
        dx = wide * rate_x * np.cos(rate_x * times + phase_x)
        dy = high * rate_y * np.cos(rate_y * times + phase_y)
        columns = {
            "vehicle_id": np.repeat(f"v{k:03d}", times.size),
            "time_ns": stamps,
            "log_time_ns": stamps,
            "x_m": wide * np.sin(rate_x * times + phase_x),
            "y_m": high * np.sin(rate_y * times + phase_y),
            "heading_rad": np.arctan2(dy, dx),
            "speed_mps": np.hypot(dx, dy),
            "message_index": np.arange(times.size),
        }
        sizes = [pl.lit(4.6).alias("length_m"), pl.lit(1.9).alias("width_m"), pl.lit("vehicle").alias("role")]
        parts.append(
            conform(pl.DataFrame(columns).with_columns(*sizes, topic=pl.lit(f"/v{k}")), STATES_SCHEMA)
        )
    states = pl.concat(parts)
    return Log(
        path="made", sha256="", complete=True, messages=states.height, attachments=0, metadata=0, chunks=0,
        start_ns=0, end_ns=int(stamps[-1]), channels=(), states=states, scene=StaticScene(), problems=(),
    )  # fmt: skip


def whole(vehicles: int, seconds: float) -> dict[str, object]:
    """Time of one audit."""
    log = traffic(vehicles, seconds)
    # Seconds of the processor: other work on the machine does not count.
    start = time.process_time()
    audit = audit_log(log, Config())
    return {
        "vehicles": vehicles,
        "log_s": seconds,
        "states": log.states.height,
        "audit_cpu_s": round(time.process_time() - start, 2),
        "pair_samples": audit.pair_samples.height,
        "findings": audit.findings.height,
        "peak_memory_gb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2, 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=400_000)
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--seconds", type=float, nargs="*", default=[60.0, 120.0, 240.0])
    arguments = parser.parse_args()
    figures = {
        "kernels": kernels(arguments.pairs),
        "logs": [whole(arguments.vehicles, seconds) for seconds in arguments.seconds],
    }
    json.dump(figures, sys.stdout, indent=2)
    print()


if __name__ == "__main__":
    main()
