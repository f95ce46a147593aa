"""Finding one finding in what an audit wrote."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from istc_replay.errors import LogError, UsageError
from istc_replay.ingest.parquet import ParquetTable
from istc_replay.ingest.result import load_result_folder

#: The files of an audit that list findings, best first.
_FILES = ("audit.json", "findings.parquet")


@dataclass(frozen=True, slots=True)
class FoundSpan:
    """When a finding was [ns, the states' times] and whose it is; `sha256` of its log, if told."""

    vehicles: tuple[str, ...]
    start_ns: int
    end_ns: int
    sha256: str = ""


def read_finding(path: Path, finding_id: str) -> FoundSpan:
    """Read a finding by its id.

    Parameters
    ----------
    path : Path
        What `istc-replay audit -o` wrote (the folder, its audit.json, or its findings.parquet), or a
        result of `istc-replay run`, whose findings are its log's.
    finding_id : str
        Its id.

    Raises
    ------
    LogError
        If the file is none of these.
    UsageError
        If it lists no such finding.
    """
    file = next((path / name for name in _FILES if (path / name).is_file()), path)
    sha256 = ""
    try:
        if file.is_dir() or file.suffix == ".mcap":
            result = load_result_folder(file)
            rows: Iterable[Mapping[str, Any]] = result.findings.to_dicts()
            sha256 = str(result.summary["input"]["sha256"])
        elif file.suffix == ".parquet":
            rows = (row for piece in ParquetTable(file).pieces(None, 10_000) for row in piece.to_dicts())
        else:
            audit = json.loads(file.read_bytes())
            rows, sha256 = audit["findings"], str(audit["input"]["sha256"])
        return found_in(rows, finding_id, str(file), sha256)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        reason = " ".join((getattr(error, "strerror", None) or str(error)).split())[:200]
        raise LogError(
            f"{path}: is no audit that can be read ({reason}); give the folder, audit.json or "
            "findings.parquet that `istc-replay audit -o` wrote, or a result"
        ) from None


def found_in(rows: Iterable[Mapping[str, Any]], finding_id: str, where: str, sha256: str = "") -> FoundSpan:
    """Pick a finding out of the rows of an audit's findings."""
    listed = []
    for row in rows:
        if row["finding_id"] == finding_id:
            vehicles = tuple(map(str, row["vehicles"]))
            return FoundSpan(vehicles, int(row["start_ns"]), int(row["end_ns"]), sha256)
        listed.append(str(row["finding_id"]))
    known = (
        f"it lists {', '.join(listed[:5])}{' ...' if len(listed) > 5 else ''}" if listed else "it has none"
    )
    raise UsageError(f"no finding {finding_id!r} in {where}; {known}")
