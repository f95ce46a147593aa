"""The commands as a user calls them: what they print, what they write, how they fail."""

from __future__ import annotations

import json
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest

from istc_replay.cli import cli
from istc_replay.export.sample_log import sample_bytes
from istc_replay.samples.scenes import find_sample

Command = Callable[..., "subprocess.CompletedProcess[str]"]

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = sorted((ROOT / "sample_logs").glob("*.mcap"))
TURN_FIRST = ROOT / "sample_logs" / "intersection_turn_first.mcap"

#: Fast mode: the proof has its own tests.
FAST = '[corridors]\nmode = "fast"\n'


@pytest.fixture(scope="module")
def replayed(
    call: Command, tmp_path_factory: pytest.TempPathFactory
) -> tuple[subprocess.CompletedProcess[str], Path]:
    """Every sample log run in one call, and the folder of the results."""
    output = tmp_path_factory.mktemp("results")
    return call("run", *SAMPLES, "-o", output), output


def test_help_names_every_command_with_an_example(call: Command) -> None:
    for name, command in cli.commands.items():
        done = call(name, "--help")
        assert done.returncode == 0
        assert f"istc-replay {name}" in done.stdout.split("Example:")[1]
        assert command.help


def test_help_imports_nothing_heavy() -> None:
    script = (
        "import sys\nfrom istc_replay.cli import cli\ncli.main(['--help'], standalone_mode=False)\n"
        "heavy = {'numpy', 'polars', 'casadi', 'pyomo', 'rerun', 'matplotlib', 'pydantic'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")


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
    replayed: tuple[subprocess.CompletedProcess[str], Path],
) -> None:
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    with (replayed[1] / TURN_FIRST.stem / "result.mcap").open("rb") as file:
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


def test_export_writes_the_tables_of_a_log_and_of_a_result(
    call: Command, replayed: tuple[subprocess.CompletedProcess[str], Path], tmp_path: Path
) -> None:
    done = call("export", replayed[1] / TURN_FIRST.stem, "-o", tmp_path / "result", "--format", "parquet,csv")
    assert done.returncode == 0, done.stderr
    states = pl.read_parquet(tmp_path / "result" / "states.parquet")
    assert set(states["source"].unique()) == {"recorded", "planned", "guidance"}
    assert pl.read_parquet(tmp_path / "result" / "solves.parquet")["wall_s"].null_count() == 0
    assert (tmp_path / "result" / "corridors.csv").is_file()
    assert call("export", TURN_FIRST, "-o", tmp_path / "log").returncode == 0
    recorded = pl.read_parquet(tmp_path / "log" / "states.parquet")
    assert recorded.height == 303


def test_sample_writes_a_log_that_replays(call: Command, tmp_path: Path) -> None:
    out = tmp_path / "again.mcap"
    assert call("sample", "intersection_turn_first", out).returncode == 0
    assert out.read_bytes() == TURN_FIRST.read_bytes()


def test_the_explained_configuration_is_a_configuration(call: Command, tmp_path: Path) -> None:
    file = tmp_path / "my.toml"
    file.write_text(call("config").stdout)
    done = call("config", file)
    assert done.returncode == 0
    assert done.stdout == file.read_text()
    assert json.loads(call("config", "--schema").stdout) == json.loads(
        (ROOT / "schemas" / "config.schema.json").read_text()
    )


def test_view_saves_the_view_of_a_result(
    call: Command, replayed: tuple[subprocess.CompletedProcess[str], Path], tmp_path: Path
) -> None:
    out = tmp_path / "again.rrd"
    assert call("view", replayed[1] / TURN_FIRST.stem / "result.mcap", "--save", out).returncode == 0
    assert out.stat().st_size > 10_000


def test_view_without_a_screen_says_what_to_do(
    call: Command, replayed: tuple[subprocess.CompletedProcess[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    done = call("view", replayed[1] / TURN_FIRST.stem)
    assert done.returncode == 2
    assert "--save" in done.stderr


# --- bad input -------------------------------------------------------------------------------


def expect_failure(done: subprocess.CompletedProcess[str], code: int, *words: str) -> None:
    """One line on stderr that says so, the right exit code, and no traceback."""
    assert done.returncode == code, (done.stdout, done.stderr)
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    for word in words:
        assert word in lines[0]


def test_a_missing_log_is_one_line(call: Command, tmp_path: Path) -> None:
    expect_failure(call("run", tmp_path / "none.mcap", "-o", tmp_path), 3, "none.mcap", "no such file")


def test_a_file_that_is_no_mcap_is_one_line(call: Command, tmp_path: Path) -> None:
    text = tmp_path / "text.mcap"
    text.write_text("hello\n")
    expect_failure(call("run", text, "-o", tmp_path / "out"), 3, "text.mcap", "not an MCAP")


def test_an_unknown_config_key_names_the_known_ones(call: Command, tmp_path: Path) -> None:
    config = tmp_path / "c.toml"
    config.write_text("[corridors]\narea_wait = 1\n")
    done = call("run", TURN_FIRST, "-c", config, "-o", tmp_path)
    expect_failure(done, 2, "corridors.area_wait", "area_weight")
    config.write_text('[corridors]\narea_weight = "much"\n')
    expect_failure(call("config", config), 2, "corridors.area_weight", "'much'")


def test_a_folder_that_cannot_be_written_is_one_line(call: Command, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    expect_failure(call("run", TURN_FIRST, "-o", tmp_path / "file" / "out"), 2, "cannot be written")


def test_two_logs_for_one_folder_are_refused(call: Command, tmp_path: Path) -> None:
    copy = tmp_path / TURN_FIRST.name
    copy.write_bytes(TURN_FIRST.read_bytes())
    expect_failure(call("run", TURN_FIRST, copy, "-o", tmp_path), 2, "another log writes to")


def test_an_unknown_sample_names_the_known_ones(call: Command, tmp_path: Path) -> None:
    expect_failure(call("sample", "nowhere", tmp_path / "x.mcap"), 2, "nowhere", "intersection_turn_first")
    expect_failure(call("sample", str(tmp_path / "none.json"), tmp_path / "x.mcap"), 3, "none.json")


def test_an_unknown_table_format_is_refused(call: Command, tmp_path: Path) -> None:
    expect_failure(call("export", TURN_FIRST, "-o", tmp_path, "--format", "xls"), 2, "xls", "parquet")


def test_a_log_is_no_result(call: Command, tmp_path: Path) -> None:
    expect_failure(call("view", TURN_FIRST, "--save", tmp_path / "v.rrd"), 3, "not a result")


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


def test_a_full_disk_leaves_nothing_half_written(call: Command, tmp_path: Path) -> None:
    config = tmp_path / "c.toml"
    config.write_text(FAST)

    def limited() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    done = call("run", TURN_FIRST, "-c", config, "-o", tmp_path / "out", preexec_fn=limited)
    assert done.returncode in (2, 4), (done.stdout, done.stderr)
    assert len(done.stderr.strip().splitlines()) == 1
    assert list((tmp_path / "out" / TURN_FIRST.stem).iterdir()) == []


def test_nasty_names_are_shown_not_obeyed(call: Command, tmp_path: Path) -> None:
    name = "a\x1b[31m\nb.mcap"
    (tmp_path / name).write_bytes(b"")
    done = call("info", tmp_path / name)
    assert done.returncode == 3
    assert "\x1b" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_figures_draws_every_picture_of_a_result(
    call: Command, replayed: tuple[subprocess.CompletedProcess[str], Path], tmp_path: Path
) -> None:
    done = call("figures", replayed[1] / TURN_FIRST.stem, "-o", tmp_path, "--format", "svg,png")
    assert done.returncode == 0, done.stderr
    names = {file.name for file in tmp_path.iterdir()}
    assert {"window_0_corridors.svg", "window_0_top_down.png", "window_0_speed_acceleration.svg"} <= names
    assert (tmp_path / "window_0_top_down.png").read_bytes().startswith(b"\x89PNG")


def altered(tmp_path: Path, change: Callable[[pl.DataFrame], pl.DataFrame]) -> Path:
    """The intersection as a log whose recorded states were changed."""
    recorded = find_sample("intersection_turn_first").record()
    path = tmp_path / "altered.mcap"
    path.write_bytes(sample_bytes(replace(recorded, states=change(recorded.states))))
    (tmp_path / "fast.toml").write_text(FAST)
    return path


def run_fast(call: Command, log: Path) -> subprocess.CompletedProcess[str]:
    """Run a log in fast mode, results beside it."""
    return call("run", log, "-c", log.parent / "fast.toml", "-o", log.parent / "out")


def test_a_log_without_vehicles_names_its_schemas(call: Command, tmp_path: Path) -> None:
    from mcap.writer import Writer

    log = tmp_path / "other.mcap"
    with log.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"float64 x")
        channel = writer.register_channel("/imu", "cdr", schema)
        writer.add_message(channel, 0, b"\x00\x01\x00\x00" + b"\x00" * 8, 0)
        writer.finish()
    expect_failure(call("run", log, "-o", tmp_path / "out"), 3, "no vehicle states", "sensor_msgs/msg/Imu")


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


def test_audit_of_a_log_finds_the_collision_and_writes_it(call: Command, tmp_path: Path) -> None:
    done = call("audit", TURN_FIRST, "-o", tmp_path, "--format", "parquet,json,md,junit")
    assert done.returncode == 1, done.stderr
    assert "critical" in done.stdout
    assert {"findings.parquet", "audit.json", "audit.md", "audit.junit.xml"} <= {
        f.name for f in tmp_path.iterdir()
    }
    findings = pl.read_parquet(tmp_path / "findings.parquet")
    assert "critical" in findings["severity"].to_list()
    told = call("audit", TURN_FIRST, "--json")
    assert told.returncode == 1
    assert (
        json.loads(told.stdout)["findings"] == json.loads((tmp_path / "audit.json").read_text())["findings"]
    )


def test_audit_of_a_log_with_nothing_wrong_finds_nothing(call: Command, tmp_path: Path) -> None:
    log = altered(tmp_path, lambda states: states.filter(pl.col("vehicle_id") == "1"))
    done = call("audit", log)
    assert done.returncode == 0, done.stdout


def test_audit_of_a_result_judges_its_recording_and_certifies_its_plans_anew(
    call: Command, replayed: tuple[subprocess.CompletedProcess[str], Path], tmp_path: Path
) -> None:
    done = call("audit", replayed[1] / TURN_FIRST.stem, "-o", tmp_path, "--format", "json,parquet")
    assert done.returncode == 1, done.stderr  # its vehicles collide as recorded
    assert "cubes_disjoint" in done.stdout
    told = json.loads((tmp_path / "audit.json").read_text())
    assert {row["verdict"] for row in told["certificates"]} == {"pass", "not_applicable"}
    assert {row["estimate"] for row in told["against_plan"]} == {"counterfactual estimate"}
    of_log = call("audit", TURN_FIRST, "-o", tmp_path / "log", "--format", "json")
    assert of_log.returncode == 1, of_log.stderr
    behaviour = [row for row in told["findings"] if row["rule"] != "off_corridor"]
    also = json.loads((tmp_path / "log" / "audit.json").read_text())["findings"]
    assert [row["finding_id"] for row in behaviour] == [row["finding_id"] for row in also]
