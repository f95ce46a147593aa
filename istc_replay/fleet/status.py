"""The state of a fleet, read from its manifest while it runs or after."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from istc_replay.fleet.manifest import ENDINGS, is_held, read_manifest
from istc_replay.fleet.progress import duration, progress_line

#: The rate is that of the last so many logs.
_RECENT = 200
_LISTED = 20


def fleet_status(folder: Path) -> dict[str, Any]:
    """Read how far the fleet of a folder is.

    Returns
    -------
    dict
        `state` (running, finished, stopped, killed), `logs`, `whole` (from before), `counts` by
        status, `left`, `rate_per_s`, `remaining_s`, `running` (log, seconds, try), `failed` and
        `inconclusive` (log, error), `torn_lines`.

    Raises
    ------
    LogError
        If there is no manifest.
    """
    held = is_held(folder)
    books = read_manifest(folder)
    now = time.time()
    total, whole = int(books.call["logs"]), int(books.call["whole"])
    counts = {status: sum(e["event"] == status for e in books.ended_now) for status in ENDINGS}
    left = total - whole - sum(counts.values())
    recent = [e["at"] for e in books.ended_now[-_RECENT - 1 :]]
    began = books.call["at"] if len(books.ended_now) <= _RECENT else recent[0]
    until = now if held else (recent[-1] if recent else now)
    many = min(len(books.ended_now), _RECENT)
    rate = many / (until - began) if many and until > began else None
    reason = "" if books.end is None else str(books.end.get("reason", ""))
    if held:
        state = "running"
    elif books.end is None:
        state = "killed"
    else:
        state = "stopped" if reason else "finished"
    return {
        "state": state,
        "reason": reason,
        "logs": total,
        "whole": whole,
        "counts": counts,
        "left": left,
        "rate_per_s": rate,
        "remaining_s": left / rate if rate and held else None,
        "running": [
            {"log": e["log"], "seconds": round(now - e["at"], 1), "try": e.get("try", 1)}
            for e in (books.running.values() if held else ())
        ],
        **{
            status: [
                {"log": e["log"], "error": e.get("error", "")}
                for e in books.ends.values()
                if e["event"] == status and e["log"] not in books.queued
            ]
            for status in ("failed", "inconclusive")
        },
        "torn_lines": books.torn,
    }


def status_lines(facts: dict[str, Any]) -> Iterator[str]:
    """Tell it in lines."""
    line = progress_line(
        facts["logs"], facts["whole"], facts["counts"], facts["rate_per_s"], facts["remaining_s"]
    )
    reason = f": {facts['reason']}" if facts["reason"] else ""
    call_again = "; call the fleet again to go on" if facts["state"] == "killed" else ""
    yield f"{facts['state']}{reason}{call_again}: {line}"
    for entry in facts["running"]:
        again = f", try {entry['try']}" if entry["try"] > 1 else ""
        yield f"  running: {entry['log']} ({duration(entry['seconds'])}{again})"
    for status in ("failed", "inconclusive"):
        for entry in facts[status][:_LISTED]:
            yield f"  {status}: {entry['log']}: {entry['error']}"
        if len(facts[status]) > _LISTED:
            yield f"  {len(facts[status]) - _LISTED} more {status}"
    if facts["torn_lines"]:
        yield f"  {facts['torn_lines']} torn lines of the manifest, left by a kill; their logs are done again"
