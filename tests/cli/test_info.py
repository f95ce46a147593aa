"""`istc-replay info` as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ..support.commands import TURN_FIRST, Command


def test_info_tells_what_a_log_holds(call: Command) -> None:
    facts = json.loads(call("info", TURN_FIRST, "--json").stdout)
    assert set(facts) == {
        "path", "complete", "messages", "attachments", "metadata", "chunks", "start_ns", "end_ns",
        "time_source", "channels", "vehicles", "road", "problems",
    }  # fmt: skip
    assert [v["id"] for v in facts["vehicles"]] == ["1", "2", "3"]
    assert {v["states"] for v in facts["vehicles"]} == {101}
    assert {(v["rate_hz"], v["gaps"], v["role"]) for v in facts["vehicles"]} == {(10.0, 0, "vehicle")}
    assert {c["rate_hz"] for c in facts["channels"] if c["messages"] > 1} == {10.0}
    text = call("info", TURN_FIRST).stdout
    assert "istc.v1.VehicleState" in text
    assert "10.0" in text


def test_info_tells_gaps_and_what_is_derived(call: Command, tmp_path: Path) -> None:
    table, log = tmp_path / "t.csv", tmp_path / "t.mcap"
    times = [k / 10 for k in range(40) if not 20 <= k < 25]
    rows = "".join(f"a,{time},{time * 5},0,0\n" for time in times)
    table.write_text("vehicle_id,time_s,x_m,y_m,heading_rad\n" + rows)
    assert call("convert", table, log).returncode == 0
    (vehicle,) = json.loads(call("info", log, "--json").stdout)["vehicles"]
    assert (vehicle["states"], vehicle["gaps"]) == (35, 1)
    assert vehicle["longest_step_s"] == pytest.approx(0.6)
    assert vehicle["rate_hz"] == pytest.approx(10.0)
    assert vehicle["derived"] == ["speed", "acceleration"]
    assert vehicle["topics"] == ["/vehicles/a/state"]
    lines = call("info", log).stdout.splitlines()
    row = next(line for line in lines if line.startswith("  a "))
    assert row.split()[:9] == ["a", "vehicle", "35", "0.000", "3.900", "10.0", "1", "0.600", "-"]
    assert "speed, acceleration" in row


def test_nasty_names_are_shown_not_obeyed(call: Command, tmp_path: Path) -> None:
    name = "a\x1b[31m\nb.mcap"
    (tmp_path / name).write_bytes(b"")
    done = call("info", tmp_path / name)
    assert done.returncode == 3
    assert "\x1b" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
