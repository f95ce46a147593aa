"""`istc-replay bench` as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from istc_replay.bench import scaling_names

from ..support.commands import Command

NAMES = ["intersection_turn_first", "intersection_straight_first"]


@pytest.fixture(scope="module")
def table_iii(call: Command, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path]:
    """Table III measured once, fast, with its files."""
    folder = tmp_path_factory.mktemp("bench") / "out"
    done = call("bench", "--table", "iii", "--runs", "1", "--fast", "--json", "-o", folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), folder


def test_bench_measures_a_table_beside_its_peers(table_iii: tuple[Any, Path]) -> None:
    found, _ = table_iii
    assert [row["name"] for row in found["rows"]] == NAMES
    for row in found["rows"]:
        assert row["certified"]
        assert row["arrived"]
        assert row["bound"] <= row["objective"]
        assert min(row["layer1_s"], row["layer2_s"], row["length_m"], row["min_separation_m"]) > 0.0
        assert {"conflict tree", "cube sizes", "joint polish", "relaxation"} <= set(row["stages_s"])
        assert sum(row["stages_s"].values()) <= row["layer1_s"] + 1e-3
    assert found["others"]["paper"]["dense_8"]["layer1_s"] == 3.954


def test_bench_writes_its_rows_and_pictures(table_iii: tuple[Any, Path]) -> None:
    found, folder = table_iii
    assert json.loads((folder / "bench.json").read_text()) == found
    pictures = {f"{name}_{kind}.png" for name in NAMES for kind in ("top_down", "corridors")}
    assert {file.name for file in folder.iterdir()} == pictures | {"times.png", "lengths.png", "bench.json"}
    assert all((folder / name).read_bytes().startswith(b"\x89PNG") for name in pictures)


def test_bench_prints_a_table_for_people(call: Command) -> None:
    done = call("bench", "--scene", NAMES[0], "--runs", "1", "--fast")
    assert done.returncode == 0, done.stderr
    assert NAMES[0] in done.stdout
    assert "CL-CBS" in done.stdout


def test_bench_replays_perturbed_copies_of_a_scene(call: Command) -> None:
    done = call("bench", "--scene", "dense_4", "--perturb", "2", "--json")
    found = json.loads(done.stdout)["perturbed"][0]
    assert found["perturbed"] == 2
    assert found["certified_and_arrived"] + len(found["misses"]) == 2
    assert done.returncode == (0 if not found["misses"] else 4)


def test_a_scene_that_is_no_sample_is_refused_by_name(call: Command) -> None:
    done = call("bench", "--scene", "nowhere")
    assert done.returncode == 2
    assert "nowhere" in done.stderr


def test_scaling_goes_from_few_vehicles_to_many() -> None:
    names = scaling_names()
    counts = [int(name.removeprefix("dense_")) for name in names]
    assert counts == sorted(counts)
    assert {4, 6, 8} <= set(counts)


@pytest.mark.slow
def test_scaling_draws_cost_against_size(call: Command, tmp_path: Path) -> None:
    done = call("bench", "--scaling", "--runs", "1", "--fast", "-o", tmp_path, "--format", "svg")
    assert "dense_8" in done.stdout
    assert "Cost against size" in (tmp_path / "scaling.svg").read_text()


def test_bench_plans_a_scene_in_steps_beside_one_window(call: Command) -> None:
    done = call("bench", "--scene", "dense_4", "--fast", "--steps", "8/4", "--json")
    assert done.returncode == 0, done.stderr
    whole, steps = json.loads(done.stdout)["steps"]
    assert (whole["windows"], whole["horizon_s"], whole["arrived"]) == (1, None, 4)
    assert (steps["horizon_s"], steps["stride_s"], steps["arrived"]) == (8.0, 4.0, 4)
    assert steps["sound"] == steps["windows"] > 1
    assert abs(steps["length_m"] - whole["length_m"]) < 0.05 * whole["length_m"]


@pytest.mark.parametrize("step", ["8", "nan/1"])
def test_a_step_that_cannot_be_meant_is_one_line(call: Command, step: str) -> None:
    done = call("bench", "--steps", step)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "no HORIZON/STRIDE" in done.stderr
