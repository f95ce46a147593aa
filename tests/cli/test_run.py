"""`istc-replay run` on sample logs, on a road and on odd logs: what it writes and tells."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import polars as pl

from istc_replay.ingest.result import read_result

from ..support.commands import FAST, SAMPLES, TURN_FIRST, Command, altered, run_fast


def test_every_sample_log_is_certified_in_full(
    replayed: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    done, output = replayed
    assert done.returncode == 0, done.stderr
    assert len(SAMPLES) >= 5
    for log in SAMPLES:
        folder = output / log.stem
        assert {file.name for file in folder.iterdir()} == {
            "result.mcap",
            "view.rrd",
            "report.html",
            "summary.json",
        }
        summary = json.loads((folder / "summary.json").read_text())
        totals = summary["totals"]
        assert totals["vehicles_certified"] == totals["vehicles_plannable"] == totals["vehicles_present"] >= 3
        assert [w["certificate"]["verdict"] for w in summary["windows"]] == ["pass"]
        # Eight vehicles at once are planned and certified, but not proven to be the optimum.
        assert log.stem.startswith("dense_8") or summary["windows"][0]["corridors"]["gap"] <= 1e-3
        assert {"imports", "ingest", "corridors", "trajectories", "certificate", "view_rrd"} <= set(
            summary["stages"]
        )
        assert f"{log.name}: {totals['vehicles_certified']} of" in done.stdout


def test_the_plan_is_safe_where_the_recording_collides(
    replayed: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    for log in SAMPLES:
        if not log.stem.startswith("intersection"):
            continue
        window = json.loads((replayed[1] / log.stem / "summary.json").read_text())["windows"][0]
        assert window["recorded"]["min_separation_m"] < 0.0
        checks = {c["check"]: c for c in window["certificate"]["checks"]}
        assert checks["separation"]["margin"] > 0.0


def test_a_second_run_writes_the_same_result_byte_for_byte(
    call: Command, replayed: tuple[subprocess.CompletedProcess[str], Path], tmp_path: Path
) -> None:
    assert call("run", TURN_FIRST, "-o", tmp_path).returncode == 0
    first, second = (folder / TURN_FIRST.stem / "result.mcap" for folder in (replayed[1], tmp_path))
    assert first.read_bytes() == second.read_bytes()


def test_the_view_verifies_with_reruns_own_tool(
    replayed: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    for log in SAMPLES:
        done = subprocess.run(
            [sys.executable, "-m", "rerun_cli", "rrd", "verify", str(replayed[1] / log.stem / "view.rrd")],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr


def test_the_result_reads_with_the_reference_reader(
    result: Path,
) -> None:
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    with (result / "result.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        topics = {channel.topic for _, channel, _, _ in reader.iter_decoded_messages()}
    assert {
        f"/istc/{kind}/{vehicle}" for kind in ("recorded", "planned", "guidance", "path") for vehicle in "123"
    } <= topics
    assert {
        "/istc/corridors",
        "/istc/obstacles",
        "/istc/solves",
        "/istc/certificates",
        "/istc/log",
        "/istc/scene",
        "/tf",
    } <= topics


def test_one_vehicle_is_planned_alone(call: Command, tmp_path: Path) -> None:
    done = run_fast(call, altered(tmp_path, lambda states: states.filter(pl.col("vehicle_id") == "1")))
    assert done.returncode == 0, done.stderr
    assert "1 of 1 plannable vehicles certified" in done.stdout


def test_vehicles_that_overlap_at_the_start_are_named_with_exit_code_4(call: Command, tmp_path: Path) -> None:
    def beside(states: pl.DataFrame) -> pl.DataFrame:
        twin = states.filter(pl.col("vehicle_id") == "1").with_columns(
            vehicle_id=pl.lit("4"), y_m=pl.col("y_m") + 1.0
        )
        return pl.concat([states, twin])

    done = run_fast(call, altered(tmp_path, beside))
    assert done.returncode == 4
    assert "1 and 4 cannot be separated in time unit 0" in done.stdout
    assert (tmp_path / "out" / "altered" / "report.html").is_file()


def test_states_that_are_not_numbers_are_told_and_left_out(call: Command, tmp_path: Path) -> None:
    def holed(states: pl.DataFrame) -> pl.DataFrame:
        ill = (pl.col("vehicle_id") == "2") & (pl.int_range(pl.len()).over("vehicle_id") % 7 == 3)
        return states.with_columns(x_m=pl.when(ill).then(float("nan")).otherwise(pl.col("x_m")))

    done = run_fast(call, altered(tmp_path, holed))
    assert done.returncode == 0, done.stderr
    assert "3 of 3 plannable vehicles certified" in done.stdout
    assert "not_finite" in done.stdout


def test_a_vehicle_without_heading_is_named_and_the_rest_planned(call: Command, tmp_path: Path) -> None:
    def blind(states: pl.DataFrame) -> pl.DataFrame:
        # Far apart in time, its positions tell no heading either.
        unknown = pl.col("vehicle_id") == "2"
        sparse = states.filter(~unknown | (pl.int_range(pl.len()).over("vehicle_id") % 15 == 0))
        return sparse.with_columns(heading_rad=pl.when(unknown).then(None).otherwise(pl.col("heading_rad")))

    done = run_fast(call, altered(tmp_path, blind))
    assert done.returncode == 0, done.stderr
    assert "2 of 2 plannable vehicles certified (3 present)" in done.stdout
    assert "left out: 2: no state has heading_rad" in done.stdout


def test_a_truncated_log_is_replayed_as_far_as_it_goes(call: Command, tmp_path: Path) -> None:
    # Unchunked, so that a cut in the middle leaves the first half of every vehicle.
    from mcap.reader import make_reader
    from mcap.writer import Writer

    cut = tmp_path / "cut.mcap"
    with TURN_FIRST.open("rb") as source, cut.open("wb") as target:
        writer = Writer(target, use_chunking=False)
        writer.start()
        ids: dict[int, int] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.id not in ids:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            writer.add_message(ids[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size * 6 // 10])
    config = tmp_path / "c.toml"
    config.write_text(FAST)
    done = call("run", cut, "-c", config, "-o", tmp_path)
    assert done.returncode == 3, done.stderr
    summary = json.loads((tmp_path / "cut" / "summary.json").read_text())
    assert not summary["input"]["complete"]
    assert any("truncated" in p["code"] for p in summary["input"]["problems"])
    assert summary["totals"]["vehicles_certified"] == 3
    assert 4 <= summary["windows"][0]["units"] <= 7


LANE = {
    "type": "Feature",
    "id": "main",
    "properties": {"kind": "lane", "width_m": 3.5},
    "geometry": {"type": "LineString", "coordinates": [[-60, -2.5], [60, -2.5]]},
}


def test_a_road_file_is_of_the_result(call: Command, tmp_path: Path) -> None:
    road, config = tmp_path / "road.geojson", tmp_path / "fast.toml"
    road.write_text(json.dumps({"type": "FeatureCollection", "features": [LANE]}))
    config.write_text('corridors.mode = "fast"\n')
    done = call("run", TURN_FIRST, "-c", config, "--road", road, "-o", tmp_path / "out")
    assert done.returncode == 0
    result = read_result(tmp_path / "out" / TURN_FIRST.stem / "result.mcap")
    (line,) = (each for each in result.scene.lane_lines if each.lane_id == "main")
    assert line.left_m is not None
    assert line.left_m[:, 1].tolist() == [-0.75, -0.75]
    assert len(result.scene.lane_lines) == 4
    assert f'road_file = "{road}"' in result.config_toml


def test_a_road_file_that_cannot_be_used_is_one_line(call: Command, tmp_path: Path) -> None:
    road = tmp_path / "road.geojson"
    road.write_text('{"type": "Feature", "geometry": {"type": "Point", "coordinates": [0, 0]}}')
    done = call("run", TURN_FIRST, "--road", road, "-o", tmp_path / "out")
    assert done.returncode == 3
    assert done.stderr.startswith("istc-replay: ")
    assert "road.geojson: feature 0: its geometry is 'Point'" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list((tmp_path / "out").rglob("*.mcap"))
