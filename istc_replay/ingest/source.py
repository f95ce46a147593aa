"""The bytes of a file, mapped and not read."""

from __future__ import annotations

import mmap
from pathlib import Path

from istc_replay.errors import LogError
from istc_replay.ingest.records import MAGIC, Buffer

#: How files begin that are taken for logs, what they are, and what to do.
_OTHERS = (
    (b"version https://git-lfs", "it is a git-lfs pointer", "fetch the log with `git lfs pull`"),
    (b"#ROSBAG V2.0", "it is a ROS 1 bag", "convert it to MCAP with `mcap convert`"),
    (
        b"SQLite format 3",
        "it is an SQLite database, such as a ROS 2 bag",
        "convert it with `ros2 bag convert`",
    ),
    (b"\x28\xb5\x2f\xfd", "it is compressed as a whole by zstd", "unpack it with `zstd -d`"),
    (b"\x04\x22\x4d\x18", "it is compressed as a whole by lz4", "unpack it with `lz4 -d`"),
    (b"\x1f\x8b", "it is compressed as a whole by gzip", "unpack it with `gunzip`"),
    (b"PK\x03\x04", "it is a zip archive", "unpack it"),
    (b"PAR1", "it is a Parquet table", "make a log of it with `istc-replay convert`"),
    (b"<", "it is XML", "make a log of it with `istc-replay convert`"),
    (b"RRF", "it is a Rerun recording", "open it with `rerun`, or give the log it was made from"),
    (b"\x89HDF", "it is an HDF5 file", "write its states as CSV and use `istc-replay convert`"),
)


def other_format(head: bytes) -> str:
    """Tell what a file is that does not begin as MCAP does, and what to do about it."""
    if not head:
        return "it is empty; give an MCAP file"
    for start, what, remedy in _OTHERS:
        if head.startswith(start):
            return f"{what}; {remedy}"
    return f"it begins with {head[: len(MAGIC)]!r}, not {MAGIC!r}; give an MCAP file"


def map_file(path: Path) -> Buffer:
    """Map a file.

    Raises
    ------
    LogError
        If there is no such file, it is not a regular one, or it cannot be read.
    """
    try:
        if not path.exists():
            raise LogError(f"{path}: no such file; give the path of an MCAP log")
        if not path.is_file():
            # Pipes and devices may never end.
            raise LogError(f"{path}: not a regular file; give the path of an MCAP log")
        with path.open("rb") as file:
            if path.stat().st_size == 0:
                return b""
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise LogError(f"{path}: cannot be read: {reason}") from None
