"""Progress: counts, rate and remaining time, in the driver and from the manifest."""

from __future__ import annotations

from pathlib import Path

import pytest

from istc_replay.fleet.manifest import SCHEMA, Manifest
from istc_replay.fleet.progress import Progress, duration
from istc_replay.fleet.status import fleet_status, status_lines


def test_the_rate_is_that_of_late_and_tells_the_remaining_time() -> None:
    now = [0.0]
    progress = Progress(1000, 100, clock=lambda: now[0])
    assert progress.line() == "100 of 1000 logs (100 from before)"
    for _ in range(300):
        now[0] += 0.5
        progress.ended("done")
    now[0] += 0.5
    progress.ended("failed")
    assert progress.left == 599
    assert progress.rate_per_s == pytest.approx(2.0)
    assert progress.line() == (
        "401 of 1000 logs (300 done, 1 failed, 100 from before), 2.00/s, 5 min 0 s left"
    )


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.4, "0 s"), (59.6, "1 min 0 s"), (3725.0, "1 h 2 min"), (190_000.0, "2 d 4 h")],
)
def test_a_duration_has_two_units(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_the_status_tells_what_runs_while_it_runs(tmp_path: Path) -> None:
    manifest = Manifest(tmp_path)
    logs = [f"/logs/{name}.mcap" for name in "abcd"]
    manifest.append({"event": "fleet", "schema": SCHEMA, "logs": 5, "whole": 1})
    manifest.append(*({"event": "queued", "log": log, "folder": log[6]} for log in logs))
    manifest.append(*({"event": "begun", "log": log, "try": 1} for log in logs[:3]))
    manifest.append({"event": "done", "log": logs[0], "folder": "a"})
    manifest.append({"event": "failed", "log": logs[1], "folder": "b", "error": "no vehicle\x1b[31m"})
    manifest.append(
        {"event": "again", "log": logs[2], "error": "died"}, {"event": "begun", "log": logs[2], "try": 2}
    )
    facts = fleet_status(tmp_path)
    assert (facts["state"], facts["left"], facts["whole"]) == ("running", 2, 1)
    assert [(entry["log"], entry["try"]) for entry in facts["running"]] == [(logs[2], 2)]
    first, running, failed = status_lines(facts)
    assert first.startswith("running: 3 of 5 logs (1 done, 1 failed, 1 from before), ")
    assert first.endswith(" left")
    assert running.startswith(f"  running: {logs[2]} (0 s, try 2)")
    assert failed == f"  failed: {logs[1]}: no vehicle\x1b[31m"
    manifest.append({"event": "stopped", "reason": "interrupted"})
    manifest.close()
    facts = fleet_status(tmp_path)
    assert (facts["state"], facts["running"]) == ("stopped", [])
