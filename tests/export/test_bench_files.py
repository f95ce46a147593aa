"""The bench's pictures and files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from istc_replay.export.bench_files import draw_lengths, draw_scaling, draw_times, write_bench


def row(name: str, vehicles: int, **changes: Any) -> dict[str, Any]:
    """What was measured of a scene."""
    values = {
        "name": name,
        "vehicles": vehicles,
        "guidance_s": 0.05,
        "layer1_s": 0.1 * vehicles,
        "layer2_s": 0.02 * vehicles,
        "total_s": 0.2 * vehicles,
        "length_m": 40.0 * vehicles,
        "guidance_m": 39.0 * vehicles,
        "certified": True,
        "arrived": True,
    }
    return values | changes


ROWS = [row("dense_4", 4), row("dense_6", 6), row("dense_12", 12, arrived=False)]
OTHERS: dict[str, Any] = {
    "paper": {"dense_4": {"layer1_s": 0.4, "layer2_s": 0.1}},
    "cl_cbs": {
        "dense_4": {"seconds": 0.3, "length_m": 165.5},
        "dense_6": {"seconds": 2.0, "length_m": 248.1},
    },
}


def test_cost_is_drawn_over_the_number_of_vehicles_with_the_peers_where_they_are_known() -> None:
    (axes,) = draw_scaling(ROWS, OTHERS).axes
    lines = {line.get_label(): list(zip(*line.get_data(), strict=True)) for line in axes.lines}
    assert lines == {
        "layer 1": [(row["vehicles"], row["layer1_s"]) for row in ROWS],
        "layer 2": [(row["vehicles"], row["layer2_s"]) for row in ROWS],
        "layer 1, paper": [(4, 0.4)],
        "CL-CBS, all": [(4, 0.3), (6, 2.0)],
    }
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_yscale()) == ("vehicles", "seconds", "log")


def test_a_scene_that_was_not_solved_whole_is_marked_in_every_picture() -> None:
    for draw in (draw_times, draw_lengths):
        figure = draw(ROWS, OTHERS)
        words = [label.get_text() for label in figure.axes[0].get_yticklabels()]
        assert words == ["dense_4", "dense_6", "dense_12 *"]
        notes = [note.get_text() for note in figure.axes[0].texts]
        assert "* not certified, or not all arrived" in notes


def test_what_was_measured_is_written_beside_the_pictures(tmp_path: Path) -> None:
    files = write_bench(tmp_path / "out", ROWS, OTHERS, {}, "svg", scaling=True)
    assert set(files) == set((tmp_path / "out").iterdir())
    assert {file.name for file in files} == {"bench.json", "times.svg", "lengths.svg", "scaling.svg"}
    told = json.loads((tmp_path / "out" / "bench.json").read_text())
    assert told == {"rows": ROWS, "others": OTHERS}
