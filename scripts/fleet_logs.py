"""Logs for trials of fleets: intersections that differ from one another, and logs with faults.

python scripts/fleet_logs.py FOLDER COUNT [FIRST_SEED]
"""

from __future__ import annotations

import struct
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import zstandard

from istc_replay.config import GuidanceConfig
from istc_replay.export.sample_log import sample_bytes
from istc_replay.samples.scenes import find_sample

MAGIC = b"\x89MCAP0\r\n"


def varied_log(seed: int) -> bytes:
    """The bytes of an intersection whose vehicles start elsewhere by up to a metre."""
    scene = find_sample("intersection_turn_first").recorded(GuidanceConfig())
    random = np.random.default_rng(seed)
    moved = {vehicle: random.uniform(-0.5, 0.5, 2) for vehicle in scene.states["vehicle_id"].unique().sort()}
    for axis, column in enumerate(("x_m", "y_m")):
        shift = pl.col("vehicle_id").replace_strict(
            {vehicle: float(by[axis]) for vehicle, by in moved.items()}, return_dtype=pl.Float64
        )
        scene = replace(scene, states=scene.states.with_columns((pl.col(column) + shift).round(6)))
    return sample_bytes(scene)


def write_logs(folder: Path, count: int, first: int = 0) -> list[Path]:
    """Write so many logs, each of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"log_{seed:05d}.mcap" for seed in range(first, first + count)]
    for seed, file in enumerate(files, start=first):
        file.write_bytes(varied_log(seed))
    return files


def truncated_log(seed: int) -> bytes:
    """A log of which half is there."""
    data = varied_log(seed)
    return data[: len(data) // 2]


def bomb_log() -> bytes:
    """A log whose one chunk says that a gigabyte of zeros is in it."""
    packed = zstandard.ZstdCompressor(level=3).compress(bytes(1 << 24))
    name = b"zstd"
    chunk = struct.pack("<QQQI", 0, 1, 1 << 30, 0) + struct.pack("<I", len(name)) + name
    chunk += struct.pack("<Q", len(packed)) + packed
    return _log((0x06, chunk))


def empty_log() -> bytes:
    """A log without any vehicle."""
    return _log()


def _log(*records: tuple[int, bytes]) -> bytes:
    """A log of a header, the given records (opcode, content), and an end without a summary."""
    header, data_end, footer = bytes(8), bytes(4), bytes(20)
    parts = [(0x01, header), *records, (0x0F, data_end), (0x02, footer)]
    return MAGIC + b"".join(bytes([op]) + struct.pack("<Q", len(body)) + body for op, body in parts) + MAGIC


if __name__ == "__main__":
    write_logs(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 0)
