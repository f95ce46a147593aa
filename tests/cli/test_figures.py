"""`istc-replay figures` as a user calls it."""

from __future__ import annotations

from pathlib import Path

from ..support.commands import Command


def test_figures_draws_every_picture_of_a_result(call: Command, result: Path, tmp_path: Path) -> None:
    done = call("figures", result, "-o", tmp_path, "--format", "svg,png")
    assert done.returncode == 0, done.stderr
    names = {file.name for file in tmp_path.iterdir()}
    assert {"window_0_corridors.svg", "window_0_top_down.png", "window_0_speed_acceleration.svg"} <= names
    assert (tmp_path / "window_0_top_down.png").read_bytes().startswith(b"\x89PNG")
